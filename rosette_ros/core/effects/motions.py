# SPDX-License-Identifier: Apache-2.0
"""Motions: which body moves along what. Any of them goes with any course."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import Bracket, Motion, Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.effects.run_functions import BodyMotion
from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.records import Floats, Run

BALL = Searched('ball', '1', 'number of the ball, 0 for all balls, each by its own amount')
UNKNOWN = 'unknown'
FIRST_SENSES = {UNKNOWN: (0, 0), '++': (1, 1), '+-': (1, -1), '-+': (-1, 1), '--': (-1, -1)}
"""Senses of the two axes of the CMM before they have moved, by the word for them."""
FIRST_MOVES = np.linspace(-np.pi, np.pi, 8, endpoint=False)
"""Directions that are tried for a move that is not recorded, rad."""
AXIS_MOTIONS = {'radial': 'xy', 'axial': 'z', 'tilt': 'ab', 'all': 'xyzab'}
"""Axes of a motion of the table axis by its word, a and b for tilts about x and y."""
SCALES = {'both': (0, 1), 'first': (0,), 'second': (1,)}
"""Axes of the CMM whose scales change, by the word for them."""
HIGHEST = 0.3
"""Greatest height of the balls above the supports or clamps of the plate that is tried, or below them, m."""
HARMONICS = (2, 3, 4, 5)
"""Waves per turn of the form of a ball."""


class FrameAxes(Motion):
    """The machine frame moves along one of its axes or all three; the probe moves relative to the table."""

    body, stated = 'frame', 'machine'
    searched = (Searched('axes', '', 'which axes move: all three together or one alone'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(axes=('xyz', 'x', 'y', 'z'))

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return setting.word('axes')

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        return per_axis(setting.word('axes'), one)

    def direction(self, run: Run, part: Any) -> Floats:
        return np.asarray(on.along_machine(run)['xyz'.index(part)])


class TableTurn(Motion):
    """The table turns about its axis beside what its encoder shows: R e_t."""

    body, stated = 'table axis', 'table_zero'
    like = ('table or plate turning',)

    def direction(self, run: Run, part: Any) -> Floats:
        return run.radius * on.tangential(run.alpha)

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion:
        return BodyMotion(moved[0][:, None] * on.unit(2, run.size))


class AxisTilt(Motion):
    """The table axis tilts in the machine about x and about y: z at the ball per unit tilt."""

    body, stated = 'table axis', 'table_tilt'
    like = ('table axis tilting',)
    axes = 'xy'

    def direction(self, run: Run, part: Any) -> Floats:
        return on.axial_tilts(run)[..., part]

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion:
        return BodyMotion(np.stack([*moved, np.zeros(run.size)], axis=1))


class AxisShiftAndTilt(Motion):
    """The table axis moves radially, axially, by a tilt, or by all of them."""

    body, stated = 'table axis', 'bearing'
    searched = (Searched('motion', '', 'radial, axial, tilt, or all of them'),)

    def moved(self, setting: Setting) -> frozenset[str]:
        """Return what moves; across and along its axis the table moves relative to the probe as the frame does."""
        tilt, shift = frozenset(['table axis tilting']), frozenset(['frame'])
        return {'tilt': tilt, 'all': tilt | shift}.get(setting.word('motion'), shift)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(motion=AXIS_MOTIONS)

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return AXIS_MOTIONS[setting.word('motion')]

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        names = [{'a': 'rx', 'b': 'ry'}.get(part, part) for part in AXIS_MOTIONS[setting.word('motion')]]
        return tuple(Quantity(f'{one.name}_{name}', 'rad' if name[0] == 'r' else one.unit, f'{one.meaning} {name}')
                     for name in names)

    def direction(self, run: Run, part: Any) -> Floats:
        axis = 'xyzab'.index(part)
        return on.unit(axis, run.size) if axis < 3 else on.axial_tilts(run)[..., axis - 3]

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion | None:
        if setting.word('motion') not in ('tilt', 'all'):
            return None
        return BodyMotion(np.stack([*moved[-2:], np.zeros(run.size)], axis=1))


class TableAxial(Motion):
    """The table grows along its axis: z."""

    body, stated = 'table axis', 'bearing'
    like = ('frame',)

    def direction(self, run: Run, part: Any) -> Floats:
        return on.unit(2, run.size)


class PlateSlide(Motion):
    """The plate slides on the table along its x and y."""

    body, stated = 'plate', 'plate'
    axes = 'xy'

    def direction(self, run: Run, part: Any) -> Floats:
        return on.plate_axes(run)[..., part]

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion:
        return BodyMotion(shift=np.stack([*moved, np.zeros(run.size)], axis=1))


class PlateSlideAndTurn(PlateSlide):
    """The plate slides along its x and y and turns about z."""

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return (0, 1, 2)

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        return (*super().amplitudes(run, setting, one), Quantity('gamma', 'rad', 'turn about z'))

    def direction(self, run: Run, part: Any) -> Floats:
        return super().direction(run, part) if part < 2 else run.radius * on.tangential(run.alpha)

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion:
        return super().of_body(run, setting, moved[:2]) + BodyMotion(moved[2][:, None] * on.unit(2, run.size))


class PlateGrowth(Motion):
    """The plate grows: R e_r."""

    body, stated = 'plate', 'plate'
    like = ('plate growing',)

    def direction(self, run: Run, part: Any) -> Floats:
        return run.radius * on.radial(run.alpha)

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion:
        return BodyMotion(growth=moved[0])


class PlateOval(Motion):
    """The plate becomes oval: longer along one of its diameters and as much shorter across it, by R/2 a and R/2 b."""

    body, stated = 'plate', 'plate'
    like = ('plate distorting',)

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return (0, 1)

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        return tuple(Quantity(f'{one.name}_{name}', one.unit, f'{one.meaning} {words}')
                     for name, words in (('0', 'along its x'), ('45', 'along its diagonal')))

    def direction(self, run: Run, part: Any) -> Floats:
        return np.asarray(run.radius * on.oval(run)[part])


class PlateTilt(Motion):
    """The plate tilts on the table about its x and about its y: z at the ball per unit tilt."""

    body, stated = 'plate', 'plate'
    like = ('plate tilting',)
    axes = 'xy'

    def direction(self, run: Run, part: Any) -> Floats:
        lever = np.sin(run.beta) if part == 0 else -np.cos(run.beta)
        return np.asarray(run.radius * lever[:, None] * on.unit(2, run.size))

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion:
        return BodyMotion(rotate_z(run.phi, np.stack([*moved, np.zeros(run.size)], axis=1)))


class PlateOnSupports(Motion):
    """A support of the plate gives way: the plate turns about a horizontal line in the plane of its supports.

    That is a tilt theta, a lean h theta x e_z of the balls, which are h above the supports, and a shift along z.
    """

    body, stated = 'plate', 'plate'
    like = ('plate tilting',)
    searched = (Searched('height', 'm', 'h, height of the balls above the supports, negative below', 'phase'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(height=(0.0, 0.1, -0.1))

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {'height': (-HIGHEST, HIGHEST)}

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        height = setting.number('height')
        return ('z', ('x', height), ('y', height))

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        return (Quantity('d_z', 'm', 'shift along z'), *per_axis('xy', one))

    def direction(self, run: Run, part: Any) -> Floats:
        """Return the shift along z, or what a tilt about the plate's x or y does along z and by leaning."""
        up = on.unit(2, run.size)
        if not isinstance(part, tuple):
            return up
        axis, height = part
        x, y, _ = np.moveaxis(on.plate_axes(run), -1, 0)
        lever, lean = (np.sin(run.beta), -y) if axis == 'x' else (-np.cos(run.beta), x)
        return np.asarray(run.radius * lever[:, None] * up + height * lean)

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion:
        (d_z, x, y), height, none = moved, setting.number('height'), np.zeros(run.size)
        # the balls turn about the supports, not about their own centre: h (e_z - R' e_z), to second order
        return BodyMotion(rotate_z(run.phi, np.stack([x, y, none], axis=1)),
                          shift=np.stack([height * y, -height * x, d_z], axis=1),
                          beyond=np.stack([none, none, 0.5 * height * (x**2 + y**2)], axis=1))


class PlateSaddle(Motion):
    """The plate warps in waves around it: cos(m beta) and sin(m beta) along z."""

    body, variables = 'plate', ('ball',)
    stated = 'plate'
    searched = (Searched('order', '1', 'waves around the plate'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(order=(2, 3))

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        order = setting.number('order')
        return ((np.cos, order), (np.sin, order))

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        return tuple(Quantity('_'.join(filter(None, (one.name, name))), one.unit,
                              f'{one.meaning}, {wave} around the plate')
                     for name, wave in (('a', 'cosine'), ('b', 'sine')))

    def direction(self, run: Run, part: Any) -> Floats:
        wave, order = part
        return np.asarray(wave(order * run.beta)[:, None] * on.unit(2, run.size))


class PlateBending(Motion):
    """The plate bends along z, radially or tangentially."""

    body, stated = 'plate', 'plate'
    searched = (Searched('part', '', 'along z, radial or tangential'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(part=('z', 'radial', 'tangential'))

    def goes_with(self, setting: Setting) -> bool:
        """Along z less than two waves around the plate tilt or lift it: the base model does."""
        return setting.word('part') != 'z' or setting.whole('m') >= 2

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return (setting.word('part'),)

    def direction(self, run: Run, part: Any) -> Floats:
        return {'z': on.unit(2, run.size), 'radial': on.radial(run.alpha), 'tangential': on.tangential(run.alpha)}[
            part]


class BallInPlate(Motion):
    """A ball moves along the axes of the plate, with which it turns."""

    body, stated = 'ball', 'plate'
    axes = 'xyz'

    def direction(self, run: Run, part: Any) -> Floats:
        return on.plate_axes(run)[..., part]


@dataclass(frozen=True)
class AlongTableFrame(Motion):
    """A ball or a reading moves along axes of the table frame."""

    stated: str
    body: str
    axes: str

    def direction(self, run: Run, part: Any) -> Floats:
        return on.unit(part, run.size)


class BallForm(Motion):
    """The centre of a ball moves with the place where it is touched, in waves of the table angle, in x, y and z."""

    body, stated = 'ball', 'plate'
    searched = (Searched('ball', '1', 'number of the ball, 0 for all balls'),
                Searched('harmonic', '1', 'm, waves per turn, 0 for m = 2 to 5 together'),
                Searched('part', '', 'which part: in the plane (xy), along z, or both'))
    variables = ('table angle',)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try each ball with each harmonic and with all, then all balls with each harmonic."""
        harmonics = _harmonics(run)
        return (*grid(ball=run.balls, harmonic=[*harmonics, 0], part=('both',)),
                *grid(ball=(0,), harmonic=harmonics, part=('both', 'xy', 'z')))

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        """Return harmonic and name of each part: cosine and sine in the plane, and along z."""
        names = {'both': ('a', 'b', 'az', 'bz'), 'xy': ('a', 'b'), 'z': ('az', 'bz')}[setting.word('part', 'both')]
        harmonic = setting.whole('harmonic')
        return tuple((m, name) for m in ([harmonic] if harmonic else _harmonics(run)) for name in names)

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        words = {'a': 'cosine in the plane', 'b': 'sine in the plane', 'az': 'cosine along z', 'bz': 'sine along z'}
        return tuple(Quantity(f'{name}{one.name}_{m}', one.unit, f'{words[name]}{one.meaning}, m = {m}')
                     for m, name in self.parts(run, setting))

    def direction(self, run: Run, part: Any) -> Floats:
        m, name = part
        c, s, none = np.cos(m * run.phi), np.sin(m * run.phi), np.zeros(run.size)
        return np.stack({'a': (c, -s, none), 'b': (-s, -c, none), 'az': (none, none, c), 'bz': (none, none, s)}[name],
                        axis=-1)


def _harmonics(run: Run) -> list[int]:
    return [m for m in HARMONICS if m < run.n]


class CmmScales(Motion):
    """The scales of the two axes of the CMM across the table axis grow, or that of one."""

    body, stated = 'CMM', 'machine'
    searched = (Searched('scales', '', 'which of the two axes across the table axis: both, the first, the second'),)

    def moved(self, setting: Setting) -> frozenset[str]:
        which = setting.word('scales', 'both')
        return frozenset(['scales and squareness of the CMM' if which == 'both' else f'{which} scale of the CMM'])

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(scales=tuple(SCALES))

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return SCALES[setting.word('scales', 'both')]

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        letters = on.cmm_axes_names(run)
        return per_axis(''.join(letters[axis] for axis in self.parts(run, setting)), one)

    def direction(self, run: Run, part: Any) -> Floats:
        along = on.cmm_axes(run)[part]
        return np.asarray(run.radius * (on.radial(run.alpha) @ along)[:, None] * along)


class CmmSquareness(Motion):
    """The angle between these two axes changes as one turns: along the first by the place along the second, or the
    other way round."""

    body, stated = 'CMM', 'machine'
    like = ('scales and squareness of the CMM', 'squareness of the CMM')
    searched = (Searched('axis', '', 'the axis along which the CMM is off: the first or the second across the table '
                         'axis'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(axis=('first', 'second'))

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return (SCALES[setting.word('axis', 'first')][0],)

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        first, second = tuple(on.cmm_axes_names(run))
        return (Quantity(one.name, one.unit, f'{one.meaning} {second} to {first}'),)

    def direction(self, run: Run, part: Any) -> Floats:
        along, by = on.cmm_axes(run)[part], on.cmm_axes(run)[1 - part]
        return np.asarray((run.radius * on.radial(run.alpha) @ by)[:, None] * along)


class CmmDeformation(Motion):
    """The CMM deforms: its measurement error at the probing positions changes in one and two waves around them.

    One wave is its scales, squareness and tilt, two are the straightness of its guideways."""

    body, variables, stated = 'CMM', ('CMM position',), 'machine'
    like = ('frame',)
    searched = (Searched('axes', '', 'which axes: all three together, or z alone'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(axes=('xyz', 'z'))

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return tuple((axis, order, wave)
                     for axis in setting.word('axes') for order in (1, 2) for wave in (np.cos, np.sin))

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        words = {np.cos: ('a', 'cosine'), np.sin: ('b', 'sine')}
        return tuple(Quantity(f'{one.name}_{words[wave][0]}{order}_{axis}', one.unit,
                              f'{one.meaning} {axis}, {words[wave][1]} of order {order} around the CMM positions')
                     for axis, order, wave in self.parts(run, setting))

    def direction(self, run: Run, part: Any) -> Floats:
        axis, order, wave = part
        return np.asarray(wave(order * run.alpha)[:, None] * on.along_machine(run)['xyz'.index(axis)])


class CmmReversal(Motion):
    """Half the sense of the last move along each of the two axes of the CMM that go to and fro.

    The third comes down to every ball. Before an axis has moved, its sense is not in the records: it is searched,
    unknown counts zero.
    """

    body, stated = 'CMM', 'machine'
    like = ('frame',)
    searched = (Searched('first', '', 'sense of the two axes before they first moved in the run'),)
    variables: ClassVar[tuple[str, ...]] = ('cmm sense',)
    depends_on = ('cmm_sense',)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try both senses of each axis, and none, for the readings before it first moves."""
        known = np.all(on.cmm_senses(run) != 0)
        return grid(first=(UNKNOWN,) if known else FIRST_SENSES)

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return tuple(enumerate(FIRST_SENSES[setting.word('first', UNKNOWN)]))

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        return per_axis(on.cmm_axes_names(run), one)

    def direction(self, run: Run, part: Any) -> Floats:
        axis, first = part
        sense = on.cmm_senses(run)[axis]
        return np.asarray(0.5 * np.where(sense == 0, first, sense)[:, None] * on.cmm_axes(run)[axis])


class CmmReversalByPosition(CmmReversal):
    """That times the place along the axis, x/R."""

    variables = ('cmm sense', 'CMM position')

    def direction(self, run: Run, part: Any) -> Floats:
        return np.asarray(super().direction(run, part) * (on.radial(run.alpha) @ on.cmm_axes(run)[part[0]])[:, None])


class ProbeDeflection(Motion):
    """The ball centre moves along the last move of the CMM, across it, or along z."""

    body, stated = 'CMM', 'machine'
    like = ('frame',)
    searched = (Searched('lobes', '1', 'm, lobes of the probe around its axis'),
                Searched('part', '', 'along the move, across it, or along z'),
                Searched('theta0', 'rad', 'direction of the move to the first ball, which is not recorded', 'phase'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        first = FIRST_MOVES.tolist()
        return (*grid(lobes=(0, 2, 3, 4), part=('along', 'across'), theta0=first),
                *grid(lobes=(1, 2, 3, 4), part=('z',), theta0=first))

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        """Refine the direction of the first move as far as the next one that is tried, to either side."""
        theta, step = setting.number('theta0'), FIRST_MOVES[1] - FIRST_MOVES[0]
        return {'theta0': (theta - step, theta + step)}

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        return ((setting.word('part'), setting.get('theta0')),)

    def direction(self, run: Run, part: Any) -> Floats:
        """Return the unit vectors, which are 0 before the first move where theta0 is not given."""
        along, theta0 = part
        theta, known = last_moves(run, theta0)
        return np.asarray(known * {'along': on.radial(theta), 'across': on.tangential(theta),
                                   'z': on.unit(2, run.size)}[along])


@lru_cache(maxsize=32)
def last_moves(run: Run, theta0: float | None) -> tuple[Floats, Floats]:
    """Return the azimuth of the last move, (N,), rad, by a first one, and 1 where it is known, (N, 1)."""
    theta, known = on.last_move(run)
    if theta0 is None:
        return theta, known.astype(float)
    return np.where(known[:, 0], theta, theta0), np.ones((run.size, 1))
