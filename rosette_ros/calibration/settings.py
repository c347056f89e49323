# SPDX-License-Identifier: Apache-2.0
"""What a calibration is asked to do: the configured settings and what a goal changes. No ROS."""

import itertools
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
import yaml

from rosette_ros.calibration.calibration_plan import BLOCK, CalibrationPlan, block_of, plan_calibration
from rosette_ros.calibration.commands import Limits, Until
from rosette_ros.core.joint.readings import Plate
from rosette_ros.core.run.axes import taught_frame
from rosette_ros.core.run.errors import InvalidConfig, InvalidPlan, unknown
from rosette_ros.core.run.number_limits import LARGEST
from rosette_ros.core.run.scheme import ORDERS, TURNINGS, Scheme, chosen_places, order_name, places_in_use, plan
from rosette_ros.io.identity_file import format_identity, parse_identity, read_identity
from rosette_ros.io.plan_file import MOST_BYTES, MeasuringPlan, format_plan, parse_plan, read_plan
from rosette_ros.io.plate_file import format_plate, parse_plate, read_plate
from rosette_ros.io.safe_yaml import parse_mapping

MAX_OPTIONS = 10_000  # longest YAML text taken from a goal, characters
MOST_SETTINGS = 2 * MOST_BYTES  # longest settings taken from a log, characters: there may be a plan in them

Value = bool | int | float | str | tuple[float, ...]


@dataclass(frozen=True)
class Wanted:
    """One setting: what is allowed, low and high included, and what it means."""

    name: str
    default: Value  # of the type that is wanted; a tuple: a list of that many numbers
    text: str
    low: float = -LARGEST
    high: float = LARGEST
    choices: tuple[str, ...] = ()
    read_only: bool = False  # fixed once the node runs
    is_direction: bool = False  # a list of numbers that are not all 0

    @property
    def is_bounded(self) -> bool:
        """Whether a number has to lie in low .. high."""
        return self.high < LARGEST

    def check(self, value: Any, where: str) -> Value:
        """Return `value` in the right type, an order by its name of today, or raise InvalidConfig in words."""
        if self.choices is ORDERS and isinstance(value, str):
            value = order_name(value)
        if isinstance(self.default, tuple):
            is_list = isinstance(value, (list, tuple)) and len(value) == len(self.default)
            if is_list and all(self._fits(one, float) for one in value) and (any(value) or not self.is_direction):
                return tuple(map(float, value))
        elif self._fits(value, type(self.default)):
            return type(self.default)(value)
        raise InvalidConfig(f'{where}: {self.name}: expected {self.wanted()} ({self.text}), found {value!r:.80}')

    def wanted(self) -> str:
        """Return in words what is allowed."""
        if self.choices:
            return f'one of {", ".join(self.choices)}'
        bounds = f' in {self.low:g} .. {self.high:g}' if self.is_bounded else ''
        if isinstance(self.default, tuple):
            return f'a list of {len(self.default)} numbers{bounds}{", not all 0" * self.is_direction}'
        words = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}
        return words[type(self.default)] + bounds

    def _fits(self, value: Any, kind: type) -> bool:
        """Whether one value is allowed where a `kind` is wanted; a number without fraction is a whole one."""
        if kind in (bool, str):
            return isinstance(value, kind) and (not self.choices or value in self.choices)
        return (isinstance(value, (int, float)) and not isinstance(value, bool) and self.low <= value <= self.high
                and (kind is float or value == int(value)))


PLATE = (
    Wanted('plate.balls', 12, 'number of balls on the plate and of table positions', 3, 1000),
    Wanted('plate.radius_m', 0.1825, 'nominal radius of the circle of ball centres, m', 1e-3, 10.0))
TABLE = (
    Wanted('table.origin_m', (0.35, 0.26, -0.3), 'where the centre of the plate roughly is, x y z in machine '
           'coordinates, m', -100.0, 100.0),
    Wanted('table.axis', (0.0, 0.0, 1.0), 'direction of the table axis in machine coordinates, about which table and '
           'balls count counter-clockwise', -1e6, 1e6, is_direction=True),
    Wanted('table.azimuth_deg', 0.0, 'where ball 1 roughly is at table angle 0, counted counter-clockwise about '
           'table.axis from the machine x axis (axis along z), y (along x) or z (along y), degrees', -360.0, 360.0))
RUN = (
    Wanted('order', 'interleaved', 'order of measurement', choices=ORDERS),
    Wanted('seed', 0, 'draws the order "random"', 0, 2**53),
    Wanted('turning', 'forward', 'sense in which the table turns', choices=TURNINGS),
    Wanted('cmm_positions', '', 'CMM positions in use: how many ("6", the best ones), a share ("50 %"), '
           '"fewest", as few as determine the curves, or which ("1, 5, 7, 10"); "": all, half of them in order '
           'there_and_back'),
    Wanted('balls_in_use', '', 'balls in use, likewise; not together with cmm_positions'),
    Wanted('table_offset_deg', 0.0, 'table angle of table position 1, degrees, below one step of the table: half of it '
           'for a run at half pitches', 0.0, 360.0),
    Wanted('touches', 0, 'touches of each ball, 0: as the CMM usually does', 0, 1000),
    Wanted('repeats', 10, 'readings of the repeatability check, 0: none', 0, 10_000),
    Wanted('drift_check', True, 'whether the first ball is measured again after the run'))
UNTIL = (
    Wanted('until.probability', 0.0, 'probability from which on what the model lacks is settled: until then readings '
           'are added to the plan; above 0.5 and below 1, 0: none are', 0.0, 1.0),
    Wanted('until.uncertainty_m', 0.0, 'likewise the largest expanded uncertainty (k = 2) of the curves, m, rotations '
           'at the radius of the balls; 0: any', 0.0, 1.0),
    Wanted('until.most_readings', 0, 'most readings that are added; 0: as many as the plan has', 0, 1_000_000))
ADDED = Wanted('added', '', 'readings that were added to the plan: table position, ball, sense of the table and wait '
               '(s) of each, separated by commas')
# A path is read with the rights of the sequencer: no other node of the graph may name one.
PLAN = Wanted('plan', '', 'plan file to run instead of an order: its path, or its text (rosette-plan/1)',
              read_only=True)
PLATE_FILE = Wanted('plate.file', '', 'plate file of balls at other places than an equal pitch (rosette-plate/1): '
                    'its path, or its text; plate.balls is then the number of table positions', read_only=True)
LIMITS = (
    Wanted('limits.answer_timeout_s', Limits.answer_timeout, 'wall time after which a target is asked again, s', 0.01,
           1e5),
    Wanted('limits.attempts', Limits.attempts, 'how often one target is asked before it is given up', 1, 1000),
    Wanted('limits.skips', Limits.skips, 'how many balls of the run may be left out after that, never two in a row; 0: '
           'the run fails', 0, 1000),
    Wanted('limits.evaluation_timeout_s', Limits.evaluation_timeout, 'wall time for the evaluation, s', 0.01, 1e5),
    Wanted('limits.return_timeout_s', Limits.return_timeout, 'wall time that a run waits for a disconnected CMM or '
           'recorder, before it fails (it can be resumed), s', 0.0, 1e5),
    Wanted('limits.search_m', Limits.search, 'how far a ball may lie from where it is expected before the alignment, m',
           1e-6, 1.0),
    Wanted('limits.distance_m', Limits.distance, 'the same after the alignment, m', 1e-6, 1.0),
    Wanted('limits.angle_rad', Limits.angle, 'how far the table may stand from the commanded angle, rad', 1e-9, 0.5))
PLACES = ('cmm_positions', 'balls_in_use')
IDENTITY = Wanted('identity', '', 'identity file (rosette-identity/1), kept in the log of a run: its path, or its text',
                  read_only=True)
EXPERIENCE = Wanted('experience', '', 'what earlier runs of the cell have taught (YAML, rosette-experience/1); empty: '
                    'nothing', read_only=True)
RESUME = Wanted('resume', '', 'the log to continue: the name of its folder, or its path')
OPTIONS = RUN[2:] + LIMITS[:5] + (RESUME,)  # what the options of a goal may change for one calibration
PLANNED = PLATE + TABLE + RUN + UNTIL + (PLAN, PLATE_FILE)  # what decides which targets a calibration has
FIELDS = {'order': 'order', 'balls': 'plate.balls', 'radius': 'plate.radius_m', 'turning': 'turning',
          'cmm_positions': 'cmm_positions', 'balls_in_use': 'balls_in_use', 'touches': 'touches', 'repeats': 'repeats',
          'drift_check': 'drift_check', 'attempts': 'limits.attempts', 'skips': 'limits.skips',
          'until_probability': 'until.probability', 'until_uncertainty': 'until.uncertainty_m',
          'most_readings': 'until.most_readings', 'resume': 'resume', 'plan': 'plan', 'plate': 'plate.file',
          'table_offset': 'table_offset_deg'}
"""Fields of a goal by the setting that each changes."""
NONE: dict[str, dict[int, Value]] = {'repeats': {-1: 0}, 'skips': {-1: 0}, 'drift_check': {-1: False, 1: True}}
"""What the constants of Calibrate.action stand for."""
BY_PLAN = ('plate.balls', 'plate.radius_m', 'order', 'seed', 'turning', *PLACES, 'plate.file', 'table_offset_deg')
"""What a plan file decides."""
BY_PLATE = ('plate.radius_m', 'balls_in_use')
"""What a plate file decides."""


def goal_changes(goal: Mapping[str, Any]) -> dict[str, Value]:
    """Return what the fields of a goal that are set, by name, change, name to value; raises InvalidConfig."""
    known = {wanted.name: wanted for wanted in (*PLATE, *RUN, *UNTIL, *LIMITS, PLAN, PLATE_FILE, RESUME)}
    changes = {}
    for field, value in goal.items():
        if field in FIELDS:
            given = round(float(np.rad2deg(value)), 12) if field == 'table_offset' else (
                NONE.get(field, {}).get(value, value))
            changes[FIELDS[field]] = known[FIELDS[field]].check(given, 'goal')
    if 'order' in goal or 'seed' in goal:
        changes['seed'] = known['seed'].check(goal.get('seed', 0), 'goal')
    options = parse_options(goal.get('options', ''))
    for name in options:
        if name in changes:
            raise InvalidConfig(f'options: {name}: expected it once, found it in the fields of the goal too; leave it '
                                'out')
    changes |= options
    for name in ('plan', 'plate.file'):
        if changes.get(name) and '\n' not in str(changes[name]):
            raise InvalidConfig(f'goal: {name}: expected the lines of a file, found {changes[name]!r:.60}; only the '
                                f'parameter {name} of the sequencer may be a path')
    decided = [name for name in BY_PLAN if name in changes]
    if decided and changes.get('plan'):
        raise InvalidConfig(f'goal: {decided[0]}: the plan decides it; leave out one of the two')
    return changes


def changed_settings(configured: Mapping[str, Value], changes: Mapping[str, Value]) -> dict[str, Value]:
    """Return settings as a goal changes them, a plan file as its text, with the plate that it is for.

    What a goal says of an order or a plate takes the place of a configured plan. Raises InvalidPlan.
    """
    replaces_plan = 'plan' not in changes and any(name in changes for name in BY_PLAN)
    values = {**configured, **changes, **({'plan': ''} if replaces_plan else {})}
    if 'plate.file' not in changes and any(name in changes for name in BY_PLATE):
        values['plate.file'] = ''
    if values['plan']:
        values['plate.file'] = ''
    elif plate := _plate(values):
        values |= _on_places(values, plate)
    given = str(values['plan'])
    return _of_plan(values, read_plan(given) if given and '\n' not in given else None)


def _of_plan(values: dict[str, Value], made: MeasuringPlan | None = None, where: str = 'plan') -> dict[str, Value]:
    """Return settings with the plate that their plan, or its text in them, is for."""
    text = str(values['plan'])
    made = made or (parse_plan(text.encode(errors='replace'), where) if text else None)
    if made is None:
        return values
    return {**values, 'plan': format_plan(made), 'plate.balls': made.scheme.n, 'plate.radius_m': made.radius}


def _plate(values: Mapping[str, Any]) -> Plate | None:
    """Return the plate of the file, or of its text, in settings; None for equal pitch."""
    given = str(values['plate.file'])
    if not given:
        return None
    return parse_plate(given.encode(errors='replace')) if '\n' in given else read_plate(given)


def _on_places(values: Mapping[str, Value], plate: Plate) -> dict[str, Value]:
    """Return what a plate file decides: the places of its balls on a circle of as many steps as the table has."""
    places = ', '.join(map(str, sorted(plate.places(int(str(values['plate.balls']))))))
    for name in PLACES:
        if values[name] not in ('', places):
            raise InvalidConfig(f'{name}: expected none beside a plate file, whose balls are all in use, found '
                                f'{values[name]!r:.80}; leave out one')
    return {'plate.file': format_plate(plate), 'plate.radius_m': plate.circle, 'balls_in_use': places}


def parse_options(text: str) -> dict[str, Value]:
    """Return what a YAML mapping of names from OPTIONS, or no text, changes, name to value; raises InvalidConfig."""
    known, changes = {wanted.name: wanted for wanted in OPTIONS}, {}
    for name, value in parse_mapping(text, 'options', MAX_OPTIONS, 'repeats: 5', InvalidConfig).items():
        if name not in known:
            raise InvalidConfig(f'options: {unknown(str(name)[:80], known)}')
        changes[name] = known[name].check(value, 'options')
    return changes


def with_identity(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return settings with the identity file as its text; raises InvalidData where it is none."""
    given = str(values.get(IDENTITY.name, ''))
    if not given:
        return {**values}
    found = parse_identity(given.encode(errors='replace')) if '\n' in given else read_identity(given)
    return {**values, IDENTITY.name: format_identity(found)}


def plan_of(values: Mapping[str, Any]) -> CalibrationPlan:
    """Return the CalibrationPlan for settings (name to value, all of PLANNED)."""
    scheme = scheme_of_settings(values)
    taught = taught_frame(values['table.origin_m'], values['table.axis'], np.deg2rad(values['table.azimuth_deg']))
    plate = _plate(values)
    made = plan_calibration(scheme, values['plate.radius_m'], taught, values['repeats'], values['drift_check'],
                            values['touches'], plate.places(scheme.n) if plate else ())
    return made.followed_by(_parse_added(str(values.get(ADDED.name, '')), scheme))


def format_added(plan: CalibrationPlan) -> str:
    """Return the line that settings have besides where readings were added to their plan, '' where none were."""
    rows = zip(*(getattr(plan.added, name).tolist() for name in BLOCK))
    text = ', '.join(' '.join(map(str, row)) for row in rows)
    return f'{ADDED.name}: "{text}"\n' if text else ''


def _parse_added(text: str, scheme: Scheme) -> Scheme:
    """Return the readings that a setting names, none where it is empty; raises InvalidConfig."""
    try:
        columns = list(zip(*(row.split() for row in text.split(',') if row.strip()), strict=True)) or [()] * len(BLOCK)
        kinds = (int, int, int, float)
        return block_of(scheme.n, {name: list(map(kind, column))
                                   for name, kind, column in zip(BLOCK, kinds, columns, strict=True)})
    except (InvalidPlan, ValueError, OverflowError) as error:
        raise InvalidConfig(f'{ADDED.name}: expected {ADDED.text}, found {text!r:.80}') from error


def until_of(values: Mapping[str, Any]) -> Until | None:
    """Return until when readings are added, None where none are; values: name to value, all of UNTIL."""
    probability, uncertainty, most = (values[one.name] for one in UNTIL)
    if probability and not 0.5 < probability < 1:
        raise InvalidConfig(f'{UNTIL[0].name}: expected a number above 0.5 and below 1, or 0 for none, found '
                            f'{probability:g}')
    return Until(probability, uncertainty, most) if probability or uncertainty else None


def scheme_of_settings(values: Mapping[str, Any]) -> Scheme:
    """Return the Scheme for settings (name to value, all of PLATE and RUN, a plan as its text)."""
    if values['plan']:
        return parse_plan(values['plan'].encode(), 'plan').scheme
    made = plan(values['plate.balls'], values['order'], values['seed'], values['turning'], *_places(values))
    return made.shifted(values['table_offset_deg'])


def _places(values: Mapping[str, Any]) -> tuple[tuple[int, ...], ...]:
    """Return the CMM positions and the balls that settings put in use, as `chosen_places`."""
    balls = values['plate.balls']
    return chosen_places(balls, values['order'], *(places_in_use(values[name], balls) for name in PLACES))


def limits_of(values: Mapping[str, Any]) -> Limits:
    """Return the Limits for settings (name to value, all of LIMITS): fields are names without prefix and unit."""
    return Limits(**{re.sub(r'limits\.|_(s|m|rad)$', '', wanted.name): values[wanted.name] for wanted in LIMITS})


def format_settings(values: Mapping[str, Value]) -> str:
    """Return the settings that decide the targets of a calibration as YAML; values: name to value.

    The CMM positions and balls in use stand as numbers, so that no later choice of the best ones changes the plan.
    """
    decided = (*BY_PLAN[2:],) if values['plan'] else ('plan', *['plate.file'] * (not values['plate.file']))
    plain = {one.name: values[one.name] for one in PLANNED if one.name not in decided}
    for name, places in zip(PLACES, _places(values)) if not values['plan'] else ():
        plain[name] = ', '.join(map(str, places))
    lists = {name: list(value) for name, value in plain.items() if isinstance(value, tuple)}
    if values.get(IDENTITY.name):
        plain[IDENTITY.name] = values[IDENTITY.name]
    return yaml.dump({**plain, **lists}, sort_keys=False, Dumper=getattr(yaml, 'CSafeDumper', yaml.SafeDumper))


def parse_settings(text: str, where: str) -> dict[str, Value]:
    """Return the settings that format_settings wrote, name to value; raises InvalidConfig in words."""
    given = parse_mapping(text, where, MOST_SETTINGS, 'order: row', InvalidConfig)
    # those that the first logs lack, or that are left out
    later = ('table.axis', 'touches', 'table_offset_deg', *PLACES, 'plate.file', *(one.name for one in UNTIL),
             *(BY_PLAN[2:] if 'plan' in given else ('plan',)))
    known = (*PLANNED, *(one for one in (IDENTITY, ADDED) if one.name in given))
    return _of_plan({wanted.name: wanted.check(given.get(wanted.name, wanted.default if wanted.name in later else None),
                                               where) for wanted in known}, where=f'{where}: plan')


def run_name(when: datetime, order: str, taken: Collection[str]) -> str:
    """Return a run_id such as `rosette_20260412_083000_diagonal` that is not in `taken`."""
    return first_free(f'rosette_{when:%Y%m%d_%H%M%S}_{order}', taken.__contains__)


def first_free(name: str, is_taken: Callable[[str], bool]) -> str:
    """Return a name, or the first of `<name>_2`, `<name>_3` and so on, that is not taken."""
    more = (f'{name}_{number}' for number in itertools.count(2))
    return next(one for one in itertools.chain([name], more) if not is_taken(one))
