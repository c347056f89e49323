# SPDX-License-Identifier: Apache-2.0
"""What a plan determines and shows, what to measure next, and a simulated machine that measures a plan."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from rosette_ros.analysis import advise as advise_order
from rosette_ros.analysis import advise_run
from rosette_ros.api.measurement import Measurement, read, stated_inputs
from rosette_ros.api.result import DrawnResult, Result, plots
from rosette_ros.core.effects.composed import effect
from rosette_ros.core.planning.advice import Advice
from rosette_ros.core.planning.plan_comparison import Outlook, outlook
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import ErrorMotions, remove_gauge
from rosette_ros.core.run.scheme import Scheme, order_name, places_in_use
from rosette_ros.core.run.scheme import plan as scheme_of
from rosette_ros.core.uncertainty.stated_environment import Environment
from rosette_ros.io.plan_file import MeasuringPlan, format_plan, read_plan
from rosette_ros.io.text_file import write_text
from rosette_ros.presentation import plan_results, tables
from rosette_ros.presentation.json_output import advice_json
from rosette_ros.presentation.table_format import Table
from rosette_ros.simulation import Machine, MachineConfig, load_machine
from rosette_ros.simulation.machine import machine_config
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.plan_words import better_words

USUAL_RADIUS_MM = 182.5
"""Radius of the plate of the paper."""


class Plan(DrawnResult):
    """An order of measurement on a plate, and what it determines; scheme, radius (m): as the core has them."""

    def __init__(self, name: str, scheme: Scheme, radius: float, sigma: float = 1e-7,
                 environment: Environment | None = None) -> None:
        self.name, self.scheme, self.radius, self._sigma, self._environment = name, scheme, radius, sigma, environment

    @cached_property
    def outlook(self) -> Outlook:
        """What it determines and shows."""
        return outlook(self.name, self.scheme, self.radius, self._sigma, environment=self._environment)

    def to_mapping(self) -> dict[str, Any]:
        return plan_results.plan_json(self.outlook)

    def sentences(self) -> tuple[str, ...]:
        expected = self.outlook.expectation
        return (f'{self.name}: {self.scheme.ball.size} readings in {expected.duration / 3600:.2f} h; the curves with '
                f'{expected.penalty:.2f} times the uncertainty of a complete run',)

    def tables(self) -> tuple[Table, ...]:
        seen = plan_results.effects(self.outlook)
        return (plan_results.targets(self.scheme, 1e3 * self.radius), plan_results.uncertainties(self.outlook),
                *([seen] if seen else []))

    def draw(self) -> Any:
        return plots('plan_plots').pairs_in_order(self.scheme, self.name)

    def write(self, path: str | Path, force: bool = False) -> Path:
        """Write a plan file (CSV) for `rosette calibrate --plan`, and return the path.

        Raises InvalidData where one exists, unless `force`."""
        write_text(path, format_plan(MeasuringPlan(self.scheme, self.radius)), force)
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


def plan(*orders: str | Path, balls: int | None = None, radius_mm: float = USUAL_RADIUS_MM, turning: str = 'forward',
         seed: int = 0, sigma_um: float = 0.1, inputs: Mapping[str, Any] | str | Path | None = None,
         environment: str | None = None) -> Any:
    """Return the Plan of an order or of a plan file, or several side by side (PlansCompared).

    orders: such as 'row' or 'there_and_back:8' (at 8 CMM positions); balls: on the plate = table positions; sigma_um:
    standard deviation of a coordinate; environment: as of `evaluate`: U contains what the order hides."""
    if not orders:
        raise InvalidPlan('plan: expected an order or a plan file, found none')
    stated = stated_inputs(inputs, environment)
    made = [_plan(order, balls, radius_mm, turning, seed, sigma_um, stated.environment if stated else None)
            for order in orders]
    return made[0] if len(made) == 1 else PlansCompared(made)


def _plan(order: str | Path, balls: int | None, radius_mm: float, turning: str, seed: int, sigma_um: float,
          environment: Environment | None) -> Plan:
    if Path(order).is_file():
        read_one = read_plan(order)
        return Plan(Path(order).name, read_one.scheme, read_one.radius, 1e-6 * sigma_um, environment)
    name, _, places = str(order).partition(':')
    if balls is None:
        raise InvalidPlan('plan: expected balls with an order, or a plan file')
    scheme = scheme_of(balls, order_name(name), seed, turning, places_in_use(places, balls, 'CMM positions'))
    return Plan(':'.join([order_name(name), *([places] if places else [])]), scheme, 1e-3 * radius_mm, 1e-6 * sigma_um,
                environment)


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
           inputs: Mapping[str, Any] | str | Path | None = None, environment: str | None = None) -> Advised:
    """Return what a run, or an order of so many balls, can show, and which order to measure next.

    show: effects that the next run must show; environment: as of `evaluate`."""
    stated = stated_inputs(inputs, environment)
    within, wanted = stated.environment if stated else None, tuple(effect(name).name for name in show)
    if run is not None:
        measured = read(run).run
        return Advised(advise_run(measured, wanted, seed, within), measured.n, measured.radius, measured.run_id)
    if balls is None or order is None:
        raise InvalidPlan('advise: expected either a run or both balls and order')
    radius = 1e-3 * radius_mm
    return Advised(advise_order(balls, order, radius, wanted=wanted, turning=turning, seed=seed, environment=within),
                   balls, radius)


def simulate(machine: Any = None, plan: Any = 'interleaved', run_id: str = '') -> Measurement:
    """Return what a simulated machine measures; its `truth` has the true curves.

    machine: a MachineConfig, its file (docs/machine.md), or what differs from the default machine, such as {'seed': 3,
    'plate': {'balls': 8}, 'hidden': [{'kind': 'frame_drift', 'rate_um_per_h': [6, 0, 4]}]}; plan: a Plan or an order.
    The same machine and plan give the same readings. Raises InvalidConfig, InvalidPlan."""
    config = machine if isinstance(machine, MachineConfig) else (
        MachineConfig() if machine is None else load_machine(machine) if isinstance(machine, str | Path) else
        machine_config(dict(machine), 'machine'))
    scheme = plan.scheme if isinstance(plan, Plan) else scheme_of(config.plate.balls, str(plan), config.seed)
    made = Machine(config)
    run, alignment, _ = made.calibrate(scheme, run_id=run_id)
    run = run.replace(source=run_id or 'simulated machine')
    angle = nominal_angles(run.n) + run.table_offset
    truth = remove_gauge(made.table_truth(angle, alignment.frame))
    return Measurement(run, truth=ErrorMotions(angle, truth, 0.0 * truth, run.rotation))
