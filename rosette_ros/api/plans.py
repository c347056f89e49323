# SPDX-License-Identifier: Apache-2.0
"""What a plan determines and shows, and what to measure next."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.analysis import advise as advise_order
from rosette_ros.analysis import advise_run
from rosette_ros.analysis import next_readings as next_block
from rosette_ros.api.measurement import experience_of, model_of, read, stated_inputs
from rosette_ros.api.result import DrawnResult, Result, plots
from rosette_ros.core.effects.composed import effect
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.joint.cell_diagnosis import LIKELY
from rosette_ros.core.model.experience import Experience
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.advice import Advice
from rosette_ros.core.planning.block_ways import with_block
from rosette_ros.core.planning.next_readings import BLOCK, UNTIL, NextReadings
from rosette_ros.core.planning.plan_comparison import Outlook, outlook
from rosette_ros.core.run.axes import axis_rotation
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import ORDERS, order_name, places_in_use
from rosette_ros.core.run.scheme import plan as scheme_of
from rosette_ros.core.run.touches import Pace
from rosette_ros.core.run.typed_words import as_typed
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.io.plan_file import MeasuringPlan, format_plan, read_plan
from rosette_ros.io.plate_file import read_plate
from rosette_ros.io.text_file import write_text
from rosette_ros.presentation import plan_results, tables
from rosette_ros.presentation.json_output import advice_json
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.effect_words import exact
from rosette_ros.words.plan_words import better_words
from rosette_ros.words.settling_words import next_words

USUAL_RADIUS_MM = 182.5
"""Radius of the plate of the paper, where a question is answered without a plate."""
MOST_PLANS = 12
"""Plans side by side."""


class Plan(DrawnResult):
    """An order of measurement on a plate, and what it determines; scheme, radius (m): as the core has them.

    judged: what `outlook` takes besides; is_stated: whether the radius is that of a plate, or only assumed."""

    def __init__(self, name: str, measuring: MeasuringPlan, is_stated: bool = True, **judged: Any) -> None:
        self.name, self.scheme, self.radius, self.is_stated = name, measuring.scheme, measuring.radius, is_stated
        self._judged = judged

    @cached_property
    def outlook(self) -> Outlook:
        """What it determines and shows."""
        return outlook(self.name, self.scheme, self.radius, **self._judged)

    @property
    def measuring(self) -> MeasuringPlan:
        """The plan as it is measured; raises InvalidPlan where nobody stated the radius of the circle of balls."""
        if not self.is_stated:
            option = as_typed('--radius-mm', 'radius_mm=')
            raise InvalidPlan(f'{self.name}: expected {option}, the radius of the circle of ball centres, with targets '
                              'for a CMM, found none')
        return MeasuringPlan(self.scheme, self.radius)

    def to_mapping(self) -> dict[str, Any]:
        return plan_results.plan_json(self.outlook)

    def sentences(self) -> tuple[str, ...]:
        expected, assumed = self.outlook.expectation, '' if self.is_stated else ' (assumed)'
        return (f'{self.name}: {self.scheme.ball.size} readings on R = {exact(1e3 * self.radius, 6)} mm{assumed} in '
                f'{expected.duration / 3600:.2f} h; the curves with {expected.penalty:.2f} times the uncertainty of a '
                'complete run',)

    def tables(self) -> tuple[Table, ...]:
        seen = plan_results.effects(self.outlook)
        return (plan_results.targets(self.scheme, 1e3 * self.radius), plan_results.uncertainties(self.outlook),
                *([seen] if seen else []))

    def draw(self) -> Any:
        return plots('plan_plots').pairs_in_order(self.scheme, self.name)

    def write(self, path: str | Path, force: bool = False) -> Path:
        """Write a plan file (CSV) for `rosette calibrate --plan`, and return the path.

        Raises InvalidData where one exists, unless `force`, and InvalidPlan where the radius is only assumed."""
        write_text(path, format_plan(self.measuring), force)
        return Path(path)


class PlansCompared(Result):
    """Plans side by side."""

    def __init__(self, plans: Sequence[Plan]) -> None:
        self.plans = tuple(plans)

    def to_mapping(self) -> dict[str, Any]:
        return plan_results.comparison_json([one.outlook for one in self.plans])

    def sentences(self) -> tuple[str, ...]:
        return better_words([one.outlook for one in self.plans])

    def tables(self) -> tuple[Table, ...]:
        every = [one.outlook for one in self.plans]
        shown = plan_results.shares(every)
        return (plan_results.comparison(every), *([shown] if shown else []))


def plan(*orders: str | Path, balls: int | None = None, radius_mm: float | None = None, turning: str = 'forward',
         seed: int = 0, cmm_positions: str = '', balls_in_use: str = '', plate: str | Path | None = None,
         table_offset_deg: float = 0.0, touches: int = 0, sigma_um: float = 0.1, touch_s: float = Pace.touch,
         table_move_s: float | None = None, axis: Sequence[float] | None = None,
         inputs: Mapping[str, Any] | str | Path | None = None, environment: str | None = None,
         experience: Experience | str | Path | None = None) -> Any:
    """Return the Plan of an order or of a plan file, or several side by side (PlansCompared).

    orders: such as 'row' or 'there_and_back:8' (at 8 CMM positions); balls: on the plate = table positions; radius_mm:
    of the circle of their centres, without it that of the first plan file, else 182.5 is assumed; cmm_positions,
    balls_in_use: '6' (the best six), '50 %', 'fewest' or '1,5,7,10', '' all; plate: a plate file in place of radius_mm
    and balls_in_use; touches: of each ball, 0 as the CMM usually does; sigma_um: standard deviation of a coordinate
    from 20 touches; touch_s, table_move_s: times of a touch and of a move of the table; axis: direction of the table
    axis in the machine; environment, experience: as of `evaluate`: U contains what the order hides, by the rates and
    sizes of this cell. Raises InvalidPlan, InvalidData."""
    if not orders:
        raise InvalidPlan('plan: expected an order or a plan file, found none')
    if len(orders) > MOST_PLANS:
        raise InvalidPlan(f'plan: expected at most {MOST_PLANS} plans, found {len(orders)}')
    if plate is not None:
        radius_mm, balls_in_use = _on_plate(plate, balls, {
            'radius_mm': radius_mm, 'cmm_positions': cmm_positions, 'balls_in_use': balls_in_use})
    files = {order: read_plan(order) for order in orders if Path(order).is_file()}
    first = next(iter(files.values()), None)
    n: int | None = balls or (first.scheme.n if first else None)
    radius: float | None = 1e-3 * radius_mm if radius_mm else first.radius if first else None
    stated = _stated(inputs, environment, experience)
    judged: dict[str, Any] = {
        'sigma': 1e-6 * sigma_um, 'pace': Pace(touch_s, table_move_s),
        'rotation': None if axis is None else axis_rotation(axis),
        'environment': stated.environment if stated else None}
    made = list[Plan]()
    for order in orders:
        name, *places = str(order).split(':', 1)
        if order in files:
            made.append(Plan(Path(order).name, files[order], **judged))
        elif order_name(name) not in ORDERS and re.search(r'[./\\]', str(order)):
            raise InvalidPlan(f'{order}: expected a plan file, or one of {", ".join(ORDERS)}, found neither; check the '
                              'path')
        elif n is None:
            raise InvalidPlan(f'plan: expected {as_typed("--balls and --radius-mm", "balls= and radius_mm=")} with an '
                              'order, or a plan file')
        else:
            scheme = scheme_of(n, order_name(name), seed, turning,
                               places_in_use(places[0] if places else cmm_positions, n, 'CMM positions'),
                               places_in_use(balls_in_use, n, 'balls')).shifted(np.deg2rad(table_offset_deg))
            scheme = replace(scheme, touches=np.full(scheme.ball.size, touches))
            made.append(Plan(':'.join([order_name(name), *places]), MeasuringPlan(
                scheme, 1e-3 * USUAL_RADIUS_MM if radius is None else radius), radius is not None, **judged))
    return made[0] if len(made) == 1 else PlansCompared(made)


def _stated(inputs: Mapping[str, Any] | str | Path | None, environment: str | None,
            experience: Experience | str | Path | None) -> BudgetInputs | None:
    """Return what is stated, with what earlier runs have taught; raises InvalidPlan for these without an environment.
    """
    known = None if experience is None else experience_of(experience)
    stated = stated_inputs(inputs, environment, known)
    if known and not (stated and stated.environment):
        raise InvalidPlan(as_typed('--experience', 'experience=') + ': expected an environment beside it, of which it '
                          'knows rates and sizes in this cell, found none; state one with '
                          + as_typed('--environment or --inputs', 'environment= or inputs='))
    return stated


def _on_plate(path: str | Path, balls: int | None, beside: Mapping[str, object]) -> tuple[float, str]:
    """Return the radius, mm, and the balls in use of a plate file; beside: what does not go with one."""
    option = as_typed('--plate', 'plate=')
    if given := [name for name, value in beside.items() if value]:
        raise InvalidPlan(f'{option}: expected it without {given[0].replace("_", " ")}, found both; leave out one')
    if balls is None:
        raise InvalidPlan(f'{option}: expected {as_typed("--balls", "balls=")}, the number of table positions, too')
    plate = read_plate(path)
    return 1e3 * plate.circle, ', '.join(map(str, plate.places(balls)))


class Advised(Result):
    """What an order of measurement can show, and a better one; n, radius: of the plate, m; run_id: of a run."""

    def __init__(self, advice: Advice, n: int, radius: float, run_id: str = '') -> None:
        self.advice, self.n, self.radius, self.run_id = advice, n, radius, run_id

    def to_mapping(self) -> dict[str, Any]:
        return advice_json(self.advice, self.n, self.radius, self.run_id)

    def sentences(self) -> tuple[str, ...]:
        return (advice_words(self.advice),)

    def tables(self) -> tuple[Table, ...]:
        best = self.advice.best
        return tables.visibility(self.advice.present.visibilities, best.visibilities), tables.orders(self.advice)


def advise(run: Any = None, *, balls: int | None = None, order: str | None = None, radius_mm: float = USUAL_RADIUS_MM,
           turning: str = 'forward', seed: int = 0, show: Sequence[str] = (),
           inputs: Mapping[str, Any] | str | Path | None = None, environment: str | None = None,
           experience: Experience | str | Path | None = None) -> Advised:
    """Return what a run, or an order of so many balls, can show, and which order to measure next.

    show: effects that the next run must show, those that come again in the cell where none is named; environment,
    experience: as of `plan`."""
    known = None if experience is None else experience_of(experience)
    stated = stated_inputs(inputs, environment, known)
    comes_again = tuple(one.name for one in (known.causes if known else ()) if one.again > LIKELY and
                        one.name in EFFECTS)
    within, wanted = stated.environment if stated else None, tuple(effect(name).name for name in show) or comes_again
    if run is not None and balls is None and order is None:
        measured = read(run).run
        return Advised(advise_run(measured, wanted, seed, within), measured.n, measured.radius, measured.run_id)
    if run is not None or balls is None or order is None:
        raise InvalidPlan('advise: expected either '
                          + as_typed('RUN or both --balls and --order', 'a run or both balls= and order='))
    radius = 1e-3 * radius_mm
    return Advised(advise_order(balls, order, radius, wanted=wanted, turning=turning, seed=seed, environment=within),
                   balls, radius)


class NextSteps(Result):
    """The next readings of a run, by which the explanations that are in doubt part most; found: as the core has them.
    """

    def __init__(self, found: NextReadings, run: Run) -> None:
        self.found, self.run = found, run

    @property
    def plan(self) -> Plan | None:
        """What was measured and then these readings, None where nothing settles what is in doubt."""
        if self.found.targets is None:
            return None
        return Plan('next readings', MeasuringPlan(with_block(self.run, self.found.targets), self.run.radius))

    def to_mapping(self) -> dict[str, Any]:
        return plan_results.next_json(self.found, self.run)

    def sentences(self) -> tuple[str, ...]:
        return tuple(next_words(self.found))

    def tables(self) -> tuple[Table, ...]:
        return (plan_results.targets(self.found.targets, 1e3 * self.run.radius),) if self.found.targets else ()


def next_readings(run: Any, model: Model | str | Path | None = None, number: int = BLOCK,
                  until: float = UNTIL) -> NextSteps:
    """Return the next readings of a run, after which it says more of its cause.

    number: of readings at most; until: probability from which on a cause is settled."""
    measured = read(run).run
    return NextSteps(next_block(measured, model_of(model), number, until=until), measured)
