# SPDX-License-Identifier: Apache-2.0
"""What an order of measurement hides of every effect, the time it takes, and the cost of both for its design.

An effect is a function f of the run (a ramp in time, cycles, the sense of the last move, ...) times a shape known from
the geometry. Its power that the base model takes up is the power spectrum of f on the grid of table and CMM positions,
|F(p, q)|^2, summed over the lines of the base model shifted by the shape (see base_entries.line_shares): one FFT per
function judges all effects. Parts that no order can show (the mean of a creep is a plate deviation) do not count.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from rosette_ros.core.run.geometry import TWO_PI, nominal_angles
from rosette_ros.core.run.scheme import travel_sense

SETTLING = np.array([0.1, 0.2, 0.5])
"""Time constants of warming up, in durations of the run."""
STEPS = np.array([0.1, 0.25, 0.5, 0.75, 0.9])
"""Moments of steps and slips, in durations of the run."""
SLOW_CYCLES = 12.5
CYCLES_PER_TURN = np.array([0.23, 0.37, 0.4, 0.43, 0.47, 0.61, 1.43, 1.6, 2.4])
"""Orders of asynchronous motion; those above half the number of table positions are left out."""
HARDNESS = 10
"""Power mean over the effects: the larger, the more the worst one counts."""
PER_SECOND = 0.02
"""What a second of motion per reading may cost, in hidden share of power."""
PER_ALIKE = 0.3
"""What a cosine of one between two effects may cost, on top of UNLIKE, which costs nothing."""
UNLIKE = 0.4

EFFECT_SHAPES = (
    ('frame_drift', 'ramp', ('axial', 'frame')),
    ('frame_warmup', 'settling', ('axial', 'frame')),
    ('frame_temperature', 'temperature', ('axial', 'frame')),
    ('frame_cycle', 'slow_cycle', ('axial', 'frame')),
    ('frame_cycle, fast', 'fast_cycle', ('axial', 'frame')),
    ('frame_step', 'step', ('axial', 'frame')),
    ('table_zero_drift', 'ramp', ('turn',)),
    ('axis_tilt_drift', 'ramp', ('tilt',)),
    ('table_backlash', 'sense', ('turn',)),
    ('asynchronous_motion', 'bearing', ('plane', 'axial')),
    ('asynchronous_motion, tilt', 'bearing', ('tilt',)),
    ('table_warmup', 'turning', ('axial',)),
    ('plate_creep', 'ramp', ('carried',)),
    ('plate_slip', 'step', ('slip',)),
    ('plate_expansion', 'ramp', ('radial',)),
    ('plate_expansion, temperature', 'temperature', ('radial',)),
    ('plate_warp', 'ramp', ('saddle_2', 'saddle_3')),
    ('cmm_reversal', 'cmm_sense', ('plane',)),
)
"""Effects with the function that drives them and the shapes in which they move the balls."""
MEAN_COUNTS = ('table_backlash', 'asynchronous_motion, tilt')
"""Effects whose function times a lever has a mean that is hidden and is the order's own fault; the
mean of the others is gauge, or hidden in any order."""


@dataclass(frozen=True)
class Pace:
    """How fast the cell moves: rad/s, s, m/s, s, s for a ball, and the radius in m."""

    table_speed: float = float(np.deg2rad(10.0))
    table_settle: float = 2.0
    cmm_speed: float = 0.06
    cmm_settle: float = 1.0
    probing: float = 24.0
    radius: float = 0.1825


@dataclass(frozen=True, eq=False)
class Order:
    """An order of measurement: zero-based table position and ball, sense of the last table move."""

    n: int
    position: np.ndarray
    ball: np.ndarray
    approach: np.ndarray

    @property
    def cmm_position(self):
        """(N,) zero-based CMM position."""
        return (self.position + self.ball) % self.n


@dataclass(frozen=True, eq=False)
class Journey:
    """Motion of one order: time (N,), s; travel (N,) of the table, unwrapped, rad; motion: s."""

    time: np.ndarray
    travel: np.ndarray
    motion: float


def journey(order, pace):
    """Return the Journey of an order: table and CMM move at once, then the ball is probed."""
    n = order.n
    forward = np.diff(order.position) % n
    move = np.where((order.approach[1:] < 0) & (forward > 0), forward - n, forward)
    angle = np.abs(move) * (TWO_PI / n)
    table = angle / pace.table_speed + pace.table_settle * (move != 0)
    half = np.pi / n * np.diff(order.cmm_position)
    way = 2 * pace.radius * np.abs(np.sin(half))
    cmm = way / pace.cmm_speed + pace.cmm_settle * (way > 1e-9)
    motion = np.maximum(table, cmm)
    time = np.concatenate([[0.0], np.cumsum(motion + pace.probing)])
    travel = np.concatenate([[0.0], np.cumsum(move) * (TWO_PI / n)])
    return Journey(time, travel, float(motion.sum()))


def hiding(n):
    """Return for each shape the share in which the base model hides each (p, q) of f, (n, n).

    x and y, and the two directions of a tilt, of a creep or of a saddle, count as one pair.
    """
    p, q = np.meshgrid(np.arange(n), np.arange(n), indexing='ij')
    axial = (p == 0) | (q == 0) | (q == 1) | (q == n - 1) | ((p + q) % n == 0)
    plane = (p == 0) | (q == 0) | ((p + q) % n == 1)
    # Of the line q = 1 crz takes a real motion along e_t whole, along e_r not at all, x or y half.
    along = {share: np.where((q == 1) & ~plane, share, plane) for share in (0.0, 0.5, 1.0)}
    shapes = {
        'axial': axial * 1.0,
        'plane': along[0.5],
        'turn': _shifted(along[1.0], 0, 1),
        'radial': _shifted(along[0.0], 0, 1),
        'carried': _shifted(along[0.5], 1, 0),
        'tilt': _pair(axial, 0, 1),
        'saddle_2': _pair(axial, -2, 2),
        'saddle_3': _pair(axial, -3, 3),
    }
    shapes['frame'] = (shapes['axial'] + 2 * shapes['plane']) / 3
    shapes['slip'] = (2 * shapes['carried'] + shapes['turn']) / 3
    mirror = np.ix_(-np.arange(n) % n, -np.arange(n) % n)
    # A complex wave stands for its cosine and its sine.
    return {name: 0.5 * (weight + weight[mirror]) for name, weight in shapes.items()}


def _shifted(weight, a, b):
    """Return the weight on f of what hides f exp(i (a phi + b alpha))."""
    return np.roll(weight, (-a, -b), axis=(0, 1)) * 1.0


def _pair(weight, a, b):
    return 0.5 * (_shifted(weight, a, b) + _shifted(weight, -a, -b))


@dataclass(frozen=True, eq=False)
class Assessment:
    """What an order hides and costs.

    hidden: by effect, hidden share of the power that any order could show, (settings,); motion:
    seconds of motion per reading; alike: largest cosine between each of four asynchronous motions
    and a cycle in time, then that of backlash and CMM reversal, as functions of the readings.
    """

    hidden: dict[str, np.ndarray]
    motion: float
    alike: np.ndarray

    @property
    def shares(self):
        """Visible share of each effect at its worst setting, of what any order could show."""
        return {name: float(np.sqrt(max(0.0, 1 - np.max(hidden)))) for name, hidden in self.hidden.items()}

    def cost(self):
        """Return what a design makes small: the worst effect, then the mean, then the time."""
        worst = np.array([hidden.max() for hidden in self.hidden.values()])
        mean = np.mean([hidden.mean() for hidden in self.hidden.values()])
        alike = np.maximum(self.alike - UNLIKE, 0.0)
        return float(2 * np.mean(worst**HARDNESS)**(1 / HARDNESS) + mean
                     + PER_SECOND * self.motion + PER_ALIKE * (alike[:-1].mean() + alike[-1]))


class Judge:
    """Judges orders of n balls at one pace."""

    def __init__(self, n, pace=None):
        """Lay out the functions and the weights for n balls."""
        self.n, self.pace = n, pace or Pace()
        weights = hiding(n)
        self._shapes = list(weights)
        self._weights = np.stack([weight.ravel() for weight in weights.values()], axis=1)
        most = n * n / 4
        self._slow = np.arange(1.0, min(SLOW_CYCLES, most) + 0.25, 0.5)
        self._fast = np.geomspace(13.0, most, 12) if most > 13 else np.array([most])
        self._orders = CYCLES_PER_TURN[CYCLES_PER_TURN < n / 2]

    def __call__(self, order):
        """Return the Assessment of an Order."""
        way = journey(order, self.pace)
        functions = self._functions(order, way)
        ends = np.cumsum([len(part) for part in functions.values()])
        rows = {name: slice(end - len(functions[name]), end) for name, end in zip(functions, ends, strict=True)}
        share, share_with_mean = self._shares(order, np.concatenate(list(functions.values())))
        hidden = {
            effect: (share_with_mean if effect in MEAN_COUNTS else share)[
                rows[name], [self._shapes.index(shape) for shape in shapes]].ravel()
            for effect, name, shapes in EFFECT_SHAPES}
        alike = np.append(self._alike_cycles(functions['bearing']),
                          self._alike_reversals(order, functions['cmm_sense']))
        return Assessment(hidden, way.motion / self.n**2, alike)

    def _shares(self, order, functions):
        """Return the hidden shares of functions (m, N) in each shape, (m, shapes), mean off or on."""
        n = self.n
        reading = np.argsort(order.position * n + order.cmm_position)
        spectrum = scipy.fft.fft2(functions[:, reading].reshape(-1, n, n), workers=1)
        power = (spectrum.real**2 + spectrum.imag**2).reshape(len(functions), n * n)
        mean = power[:, :1].copy()
        power[:, 0] = 0.0
        hidden, whole = power @ self._weights, power.sum(axis=1, keepdims=True)
        return (hidden / np.maximum(whole, 1e-12), (hidden + mean * self._weights[0]) / np.maximum(whole + mean, 1e-12))

    def _functions(self, order, way):
        """Return the functions that drive effects, by name, each (m, N)."""
        t = (way.time / way.time[-1])[None]
        turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(way.travel)))])[None]
        reading = np.arange(t.size) / t.size
        alpha = nominal_angles(self.n)[order.cmm_position]
        half_cycle = np.repeat(np.exp(1j * np.pi * t), self._slow.size + 1, axis=0)
        return {
            'ramp': t,
            'settling': np.exp(-t / SETTLING[:, None]),
            'temperature': np.cos(np.pi * t) + 0.5 * np.cos(TWO_PI * t + 1.0),
            'slow_cycle': np.cumprod(half_cycle, axis=0)[1:],
            'fast_cycle': np.exp(1j * TWO_PI * self._fast[:, None] * t),
            'step': (reading >= STEPS[:, None]) * 1.0,
            'turning': np.exp(-turned / turned[0, -1] / SETTLING[:, None]),
            'sense': order.approach[None] * 1.0,
            'bearing': np.exp(1j * self._orders[:, None] * way.travel),
            'cmm_sense': np.stack([travel_sense(np.cos(alpha), 1e-6),
                                   travel_sense(np.sin(alpha), 1e-6)]),
        }

    def _alike_cycles(self, bearing):
        """Return the largest cosine of each of four bearing waves with a cycle of 2 to N/4 cycles."""
        size = bearing.shape[1]
        waves = bearing[1:5] - bearing[1:5].mean(axis=1, keepdims=True)
        wave = np.abs(scipy.fft.fft(waves, 4 * size, workers=1)) / size
        both = wave + np.roll(wave[:, ::-1], 1, axis=1)
        return both[:, 8:size].max(axis=1)

    def _alike_reversals(self, order, cmm_sense):
        """Return the cosine of backlash, approach e_t, with the reversals of x and y."""
        alpha = nominal_angles(self.n)[order.cmm_position]
        backlash = order.approach * np.stack([-np.sin(alpha), np.cos(alpha)])
        along = np.sum(backlash * cmm_sense, axis=1)**2 / np.sum(cmm_sense**2, axis=1)
        return np.sqrt(np.sum(along) / np.sum(backlash**2))
