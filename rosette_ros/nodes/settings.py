# SPDX-License-Identifier: Apache-2.0
"""What a calibration is asked to do: the configured settings and what a goal changes. No ROS."""

import dataclasses
import difflib
import itertools
import math
from dataclasses import dataclass

import numpy as np
import yaml

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.core.geometry import Frame, rotation_matrix
from rosette_ros.core.scheme import ORDERS, TURNINGS, plan
from rosette_ros.data.plain_yaml import load_plain
from rosette_ros.nodes.programme import make_programme
from rosette_ros.nodes.sequence import Limits

MAX_OPTIONS = 10_000
"""Longest YAML text taken from a goal, characters."""
_MOST = 1e300  # whole numbers beyond are no float


@dataclass(frozen=True)
class Wanted:
    """One setting: what is allowed and what it means.

    The type is that of `default`; a tuple is a list of that many numbers. low, high: inclusive;
    choices: allowed words; read_only: fixed once the node runs.
    """

    name: str
    default: object
    text: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False

    def check(self, value, where):
        """Return `value` in the right type, or raise InvalidConfig in words."""
        converted = self._convert(value)
        if converted is None:
            raise InvalidConfig(f'{where}: {self.name}: wanted {self.wanted()} ({self.text}), '
                                f'got {value!r:.80}')
        return converted

    def wanted(self):
        """Say what is allowed."""
        if self.choices:
            return f'one of {", ".join(self.choices)}'
        kind = self.default
        if isinstance(kind, tuple):
            return f'a list of {len(kind)} numbers{self._range()}'
        words = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}
        return words[type(kind)] + self._range()

    def _range(self):
        return '' if self.low is None else f' in {self.low:g} .. {self.high:g}'

    def _convert(self, value):
        """Return the value in the type of the default, None where that cannot be."""
        if isinstance(self.default, tuple):
            return self._convert_list(value)
        if isinstance(self.default, (bool, str)):
            fits = type(value) is type(self.default)
            return value if fits and (not self.choices or value in self.choices) else None
        return self._convert_number(value)

    def _convert_number(self, value):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > _MOST:
            return None
        if isinstance(self.default, int) and value != int(value if math.isfinite(value) else 0):
            return None
        fits = math.isfinite(value) and (self.low is None or self.low <= value <= self.high)
        return type(self.default)(value) if fits else None

    def _convert_list(self, value):
        if not isinstance(value, (list, tuple)):
            return None
        numbers = tuple(self._convert_element(element) for element in value)
        return numbers if len(numbers) == len(self.default) and None not in numbers else None

    def _convert_element(self, value):
        element = dataclasses.replace(self, default=self.default[0])
        return element._convert_number(value)


PLATE = (
    Wanted('plate.balls', 12, 'number of balls on the plate and of table positions', 3, 1000),
    Wanted('plate.radius_m', 0.1825, 'nominal radius of the circle of ball centres, m', 1e-3,
           10.0),
)
TABLE = (
    Wanted('table.origin_m', (0.35, 0.26, -0.3), 'where the centre of the plate roughly is, '
           'x y z in machine coordinates, m', -100.0, 100.0),
    Wanted('table.azimuth_deg', 0.0, 'where ball 1 roughly is at table angle 0, counted '
           'counter-clockwise from the machine x axis, degrees', -360.0, 360.0),
)
RUN = (
    Wanted('order', 'diagonal', 'order of measurement', choices=tuple(ORDERS)),
    Wanted('seed', 0, 'draws the order "random"', 0, 2**53),
    Wanted('turning', 'forward', 'sense in which the table turns', choices=TURNINGS),
    Wanted('repeats', 10, 'readings of the repeatability check, 0: none', 0, 10_000),
    Wanted('drift_check', True, 'whether the first ball is measured again after the run'),
)
LIMITS = (
    Wanted('limits.answer_timeout_s', 120.0, 'wall time after which a target is asked again, s',
           0.01, 1e5),
    Wanted('limits.attempts', 3, 'how often one target is asked before it is given up', 1, 1000),
    Wanted('limits.skips', 3, 'how many balls of the run may be left out after that, never two in a '
           'row; 0: the run fails', 0, 1000),
    Wanted('limits.evaluation_timeout_s', 120.0, 'wall time for the evaluation, s', 0.01, 1e5),
    Wanted('limits.return_timeout_s', 60.0, 'wall time that a run waits for a CMM or recorder that has '
           'gone, before it fails (it can be resumed), s', 0.0, 1e5),
    Wanted('limits.search_m', 0.02, 'how far a ball may lie from where it is expected before the '
           'alignment, m', 1e-6, 1.0),
    Wanted('limits.distance_m', 0.005, 'the same after the alignment, m', 1e-6, 1.0),
    Wanted('limits.angle_rad', 0.01, 'how far the table may stand from the commanded angle, rad',
           1e-9, 0.5),
)
RESUME = Wanted('resume', '', 'the log to go on from: the name of its folder, or its path')
OPTIONS = RUN[2:] + LIMITS[:5] + (RESUME,)
"""What the options of a goal may change for one calibration."""
PLANNED = PLATE + TABLE + RUN
"""What decides which targets a calibration has."""


def parse_options(text):
    """Return the settings that the options text of a goal changes, name to value.

    text: a YAML mapping of names from OPTIONS, or empty. Raises InvalidConfig in words.
    """
    if len(text) > MAX_OPTIONS:
        raise InvalidConfig(f'options: wanted at most {MAX_OPTIONS} characters, got {len(text)}')
    try:
        given = load_plain(text)
    except yaml.YAMLError as error:
        first = ' '.join(str(error).split())
        raise InvalidConfig(f'options: wanted a YAML mapping, got text that is none: {first}') \
            from None
    if given is None:
        return {}
    if not isinstance(given, dict):
        raise InvalidConfig(f'options: wanted a YAML mapping such as "repeats: 5", got {text!r:.80}')
    known = {wanted.name: wanted for wanted in OPTIONS}
    changes = {}
    for name, value in given.items():
        if name not in known:
            raise InvalidConfig(unknown_name('options', str(name)[:80], known))
        changes[name] = known[name].check(value, 'options')
    return changes


def programme_of(values):
    """Return the Programme for settings (name to value, all of PLATE, TABLE and RUN)."""
    scheme = plan(values['plate.balls'], values['order'], values['seed'], values['turning'])
    azimuth = np.deg2rad(values['table.azimuth_deg'])
    taught = Frame(rotation_matrix(np.array([0.0, 0.0, azimuth])),
                   np.array(values['table.origin_m']))
    return make_programme(scheme, values['plate.radius_m'], taught, values['repeats'],
                          values['drift_check'])


def limits_of(values):
    """Return the Limits for settings (name to value, all of LIMITS)."""
    return Limits(
        answer_timeout=values['limits.answer_timeout_s'], attempts=values['limits.attempts'],
        skips=values['limits.skips'],
        evaluation_timeout=values['limits.evaluation_timeout_s'],
        return_timeout=values['limits.return_timeout_s'],
        search=values['limits.search_m'], distance=values['limits.distance_m'],
        angle=values['limits.angle_rad'])


def wanted_changes(order, seed, options):
    """Return what a goal changes, name to value, `resume` included; raises InvalidConfig in words."""
    known = {wanted.name: wanted for wanted in RUN}
    changes = {}
    if order:
        changes['order'] = known['order'].check(order, 'goal')
    if order or seed:
        changes['seed'] = known['seed'].check(seed, 'goal')
    return {**changes, **parse_options(options)}


def format_settings(values):
    """Return the settings that decide the targets of a calibration as YAML; values: name to value."""
    plain = {wanted.name: values[wanted.name] for wanted in PLANNED}
    return yaml.safe_dump({name: list(value) if isinstance(value, tuple) else value
                           for name, value in plain.items()}, sort_keys=False)


def parse_settings(text, where):
    """Return the settings that format_settings wrote, name to value; raises InvalidConfig in words."""
    try:
        given = load_plain(text) if len(text) <= MAX_OPTIONS else None
    except yaml.YAMLError:
        given = None
    if not isinstance(given, dict):
        raise InvalidConfig(f'{where}: wanted the settings of the run as a YAML mapping, got {text[:80]!r}')
    return {wanted.name: wanted.check(given.get(wanted.name), where) for wanted in PLANNED}


def run_name(when, order, taken):
    """Return a run_id such as `rosette_20260412_083000_diagonal` that is not in `taken`."""
    name = f'rosette_{when:%Y%m%d_%H%M%S}_{order}'
    more = (f'{name}_{count}' for count in itertools.count(2))
    return name if name not in taken else next(one for one in more if one not in taken)


def unknown_name(where, name, known):
    """Return the words for a name that does not exist, with the likely and all known ones."""
    near = difflib.get_close_matches(name, known, 1)
    hint = f'; did you mean {near[0]}?' if near else ''
    return f'{where}: unknown name {name!r}{hint} Known: {", ".join(known)}'
