# SPDX-License-Identifier: Apache-2.0
"""The grammar of laws: every motion of a body with every course, those of the library and those that it lacks.

A law of the library has an origin in the field; the others are composed: name, words and formula of a motion and of a
course, put together.
"""

from collections import ChainMap
from collections.abc import Callable, Collection
from dataclasses import dataclass

from rosette_ros.core.effects import courses as of
from rosette_ros.core.effects import motions as move
from rosette_ros.core.effects.effect import Course, Effect, Motion, PhysicalEffect, Quantity
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.run.errors import InvalidModel, unknown_name
from rosette_ros.core.run.records import Run


@dataclass(frozen=True)
class Moving:
    """A motion as a part of composed laws.

    name: beginning of their names; unit: of its amplitude; noun: what it is; does: the sentence without its end; along:
    what the meaning of an amplitude ends in; look: where to look in the cell; formula: of a unit of the course f.
    """

    name: str
    motion: Motion
    unit: str
    noun: str
    does: str
    along: str
    look: str
    formula: str


@dataclass(frozen=True)
class Going:
    """A course as a part of composed laws.

    name: end of their names; course: for an amplitude of a unit; amplitudes: names and words of those of its functions,
    per: what their unit is divided by; words: of the law, the noun in braces; how: end of the sentence; look: what to
    look for; formula: f.
    """

    name: str
    course: Callable[[str], Course]
    amplitudes: dict[str, str]
    per: str
    words: str
    how: str
    look: str
    formula: str


RATES = {'m/m/s': '1/s', 'm/m/K': '1/K'}
SIZE, WAVES = {'d': 'amplitude'}, {'a': 'cosine', 'b': 'sine'}
OVERTONES = {f'{name}{k}': f'{words} {k}' for name, words in WAVES.items() for k in range(1, of.OVERTONES + 1)}
MOVING = (
    Moving('frame', move.FrameAxes(), 'm', 'shift of the probe', 'The probe moves relative to the table', ' along',
           'Column, quill and probe', 'f'),
    Moving('table_zero', move.TableTurn(), 'rad', 'turn of the table',
           'The table turns relative to its encoder', '', 'Encoder mount, coupling and drive of the table', 'R e_t f'),
    Moving('axis_tilt', move.AxisTilt(), 'rad', 'tilt of the table axis', 'The table axis tilts in the machine',
           ' about', 'Foundation, levelling feet and bed of the machine',
           'R (theta_x sin alpha - theta_y cos alpha) f'),
    Moving('plate_tilt', move.PlateTilt(), 'rad', 'tilt of the plate', 'The plate tilts on the table',
           " about the plate's", 'Feet, shims and clamps of the plate', 'R_z(phi) theta x b f'),
    Moving('plate_slide', move.PlateSlide(), 'm', 'slide of the plate', 'The plate slides on the table',
           " along the plate's", 'Clamps, wax or magnets of the plate', 'R_z(phi) f'),
    Moving('plate_growth', move.PlateGrowth(), 'm/m', 'growth of the plate', 'The plate grows or shrinks', '',
           'Temperature of the plate', 'R e_r f'),
    Moving('plate_oval', move.PlateOval(), 'm/m', 'ovalling of the plate', 'The plate becomes oval', '',
           'Clamps that pull to one side, one-sided heat on the plate', 'R_z(phi) (a x + b y, b x - a y) f'),
    Moving('plate_warp', move.PlateSaddle(), 'm', 'warping of the plate', 'The plate warps in waves around it', '',
           'Uneven temperature of the plate, over-tight clamps', '(a cos(m beta) + b sin(m beta)) f along z'),
    Moving('cmm_scale', move.CmmScales(), 'm/m', 'change of the CMM scales', 'The scales of the CMM change', ' of',
           'Scales of the CMM and their temperature', 'x f along x, y f along y'),
    Moving('cmm_squareness', move.CmmSquareness(), 'rad', 'change of the CMM squareness',
           "The angle between the CMM's axes changes", ' of', 'Guideways and portal of the CMM',
           'y f along x, or x f along y'),
    Moving('cmm_deformation', move.CmmDeformation(), 'm', 'deformation of the CMM', 'The CMM deforms', ' along',
           'Guideways, portal and bed of the CMM', '(cos(m alpha), sin(m alpha), m = 1 and 2) f'))
GOING = (
    Going('drift', lambda unit: of.Drift(), SIZE, '/s', 'steady {}', 'steadily',
          'what has warmed or settled since switching on', 't'),
    Going('warmup', lambda unit: of.WarmUp(), SIZE, '', 'settling {}', 'ever more slowly, until it rests',
          'what has warmed or settled since switching on', '1 - exp(-t/tau)'),
    Going('onset', lambda unit: of.Onset(), SIZE, '/s', '{} with an onset', 'steadily from one moment on',
          'what was switched on, opened or loaded at that moment', 'max(0, t - t0)'),
    Going('temperature', of.Temperature, SIZE, '/K', '{} proportional to air temperature',
          'with the measured temperature', 'air conditioning, sunlight, doors', 'T - T0'),
    Going('lag', of.LaggedTemperature, SIZE, '/K', 'thermally lagged {}', 'with the measured temperature, but later',
          'parts with a large heat capacity', "T', where tau dT'/dt = T - T0 - T'"),
    Going('cycle', lambda unit: of.Cycle(), WAVES, '', 'periodic {}', 'with a fixed period in time',
          'what is switched on and off: air conditioning, cooling units, compressors', 'cos and sin of 2 pi t/P'),
    Going('periodic', lambda unit: of.Periodic(), OVERTONES, '', 'periodic {} of any shape',
          'with a fixed period in time, by any shape',
          'what is switched on and off: air conditioning, cooling units, compressors',
          'a_k cos + b_k sin of 2 pi k t/P, k = 1 to 3'),
    Going('step', lambda unit: of.Step('step'), SIZE, '', 'sudden {}', 'at one moment, and for good',
          'a collision, a load, a clamp that let go at that moment', 'H(t - t0)'),
    Going('pulse', lambda unit: of.Pulse(), SIZE, '', 'temporary {}', 'for some time, and back',
          'a door, a load, a person or vehicle that was there for that time', 'H(t - t0) - H(t - t1)'),
    Going('recovery', lambda unit: of.Recovery(), SIZE, '', 'decaying {}',
          'at one moment, and back ever more slowly',
          'a knock, a load or warm air that was there for a moment', 'H(t - t0) exp(-(t - t0)/tau)'),
    Going('asynchronous', lambda unit: of.TableOrder(), WAVES, '', 'asynchronous {}',
          'at no integer multiple of the rotation frequency of the table',
          'belt, worm and gear of the drive; cage and rolling elements of the bearing', 'cos and sin of nu Psi'),
    Going('play', lambda unit: of.Play(), SIZE, '', '{} within its play',
          'with each turn of the table until its play is used up',
          'play, and friction or inertia that uses it up; cables and hoses that pull', '(Psi - c)/w, a play operator'))


def _composed(one: Moving, how: Going) -> PhysicalEffect:
    """Return the law of a motion and a course."""
    return PhysicalEffect(
        f'{one.name}_{how.name}', one.motion, how.course(one.unit),
        *(Quantity(name, RATES.get(one.unit + how.per, one.unit + how.per), f'{words} of the {one.noun}{one.along}')
          for name, words in how.amplitudes.items()),
        plain=how.words.format(one.noun), meaning=f'{one.does} {how.how}.', look=f'{one.look}; {how.look}.',
        formula=one.formula.replace('f', f'({how.formula})') if one.formula != 'f' else how.formula,
        source='a motion and a course of this library, put together', repeatable=how.name in ('cycle', 'step', 'pulse'))


def _kind(effect: PhysicalEffect) -> tuple[type, type]:
    return type(effect.motion), type(effect.course)


WIDER = {(move.PlateTilt, of.Step): 'plate_tilt_step', (move.PlateTilt, of.WarmUp): 'plate_tilt_settling',
         (move.PlateSlide, of.Step): 'plate_slip', (move.PlateGrowth, of.Drift): 'plate_expansion',
         (move.PlateGrowth, of.Temperature): 'plate_expansion', (move.AxisTilt, of.TableOrder): 'asynchronous_motion'}
"""Laws of the library that are a motion with a course, and more."""


def _goes_with(one: Moving, how: Going) -> bool:
    """Return whether the library lacks the law of a motion and a course.

    What turns moves the table alone, its play the plate, too; a period of any shape, which has many columns, is looked
    for in the probe; what depends on the CMM position has a law of cycles, as free courses of time and place are none.
    """
    law = _composed(one, how)
    return (_kind(law) not in {*map(_kind, EFFECTS.values()), *WIDER}
            and ('travel' not in law.variables or law.body == 'table axis')
            and ('table memory' not in law.variables or law.body in ('table axis', 'plate'))
            and (how.name != 'periodic' or law.body == 'frame')
            and (how.name == 'cycle' or 'CMM position' not in law.variables))


COMPOSED: dict[str, PhysicalEffect] = {
    law.name: law for one in MOVING for how in GOING if _goes_with(one, how) for law in [_composed(one, how)]}
"""What the library lacks, by name."""
LAWS = ChainMap(EFFECTS, COMPOSED)
"""Every law by its name, those that a laboratory has added to the library included."""


def laws_of(run: Run) -> dict[str, Effect]:
    """Return the laws that the cell of a run can have, by name."""
    return {name: one for name, one in (EFFECTS | COMPOSED).items() if one.can_be_in(run)}


def effect(name: str, others: Collection[str] = ()) -> Effect:
    """Return the effect or free course of a name; raise InvalidModel, with the nearest one or other, if there is none.

    others: names of what is no effect and would have done, too."""
    if name not in LAWS and name != FREE.name:
        raise InvalidModel(unknown_name('effect', name, (*LAWS, *others), 'rosette effects'))
    return LAWS.get(name) or FREE
