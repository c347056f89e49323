# SPDX-License-Identifier: Apache-2.0
"""Effects of the ball plate: it creeps, slips, tilts, grows, warps."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import (
    LEAST_KNOWN,
    Bracket,
    Effect,
    Factors,
    Motion,
    Quantity,
    Searched,
    Setting,
    grid,
    per_axis,
)
from rosette_ros.core.effects.factored_effect import Drift, FactoredEffect, LaggedTemperature, Step, WarmUp
from rosette_ros.core.effects.run_functions import plate_axes, seconds
from rosette_ros.core.geometry import rotate_z
from rosette_ros.core.records import Floats, Run

STANDING = 'standing'
TRAVELLING = {'against': -1, 'with': 1}
"""Senses in which a load turns in the frame of the plate, beside the table's."""


class PlateShift(FactoredEffect):
    """The plate slides on the table along its x and y."""

    source = 'physics of clamping'
    acts = 0, 1

    def directions(self, run: Run) -> Floats:
        return np.moveaxis(plate_axes(run)[..., :2], -1, 0)

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        return Motion(shift=self.course(run, setting).T * [*amplitudes, 0])


class PlateSlip(FactoredEffect):
    name = 'plate_slip'
    plain = 'slip of the plate'
    meaning = 'At one moment the whole plate slipped on the table.'
    look = 'Clamps; a collision with the plate; acceleration of the table.'
    formula = '(R_z(phi) d + gamma R e_t) H(t - t0)'
    source = 'physics of clamping'
    repeatable = True
    quantities = (*per_axis('xy', Quantity('d', 'm', "shift along the plate's")),
                  Quantity('gamma', 'rad', 'turn about z'))
    function = Step('slip')
    acts = 0, 1, 2

    def directions(self, run: Run) -> Floats:
        """Return shifts along the plate's x and y and a turn about z, (3, N, 3)."""
        turn = run.radius * on.tangential(run.alpha)[None]
        return np.concatenate([np.moveaxis(plate_axes(run)[..., :2], -1, 0), turn])

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        since = self.course(run, setting).T
        return Motion(since * [0, 0, amplitudes[2]], shift=since * [*amplitudes[:2], 0])


class PlateExpansion(Effect):
    name = 'plate_expansion'
    plain = 'expansion of the plate'
    meaning = 'The plate grows or shrinks.'
    look = 'Temperature of the plate: handling, lamps, soaking time, warm table top.'
    formula = 'epsilon R e_r (t or T - T0)'
    source = 'ISO 1 and ISO 10360 (thermal expansion)'
    depends_on = ('time',)
    carries = 'all'
    searched = (Searched('driver', '', 'what it grows with'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try time and, where it was recorded and changes, temperature."""
        changes = np.mean(np.isfinite(run.temperature)) >= LEAST_KNOWN and np.any(on.temperature_change(run))
        return grid(driver=('time', 'temperature') if changes else ('time',))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        unit = {'time': '1/s', 'temperature': '1/K'}[setting.word('driver')]
        return (Quantity('epsilon', unit, 'relative growth'),)

    def _driver(self, run: Run, setting: Setting) -> Floats:
        return {'time': seconds, 'temperature': on.temperature_change}[setting.word('driver')](run)

    def columns(self, run: Run, setting: Setting) -> Floats:
        return (run.radius * self._driver(run, setting)[:, None] * on.radial(run.alpha))[..., None]

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        return Motion(growth=amplitudes[0] * self._driver(run, setting))


class PlateGrowth(FactoredEffect):
    """The plate grows by functions of the readings with a time constant."""

    def directions(self, run: Run) -> Floats:
        return run.radius * on.radial(run.alpha)[None]

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        return Motion(growth=amplitudes @ self.course(run, setting))


HIGHEST = 0.3
"""Greatest height of the balls above the supports or clamps of the plate that is tried, or below them, m."""


class PlateOnSupports(FactoredEffect):
    """A support of the plate gives way: the plate turns about a horizontal line in the plane of its supports.

    That is a tilt theta, a lean h theta x e_z of the balls, which are h above the supports, and a shift along z.
    """

    source = 'kinematics of a plate on three supports'
    quantities = (Quantity('d_z', 'm', 'shift along z'),
                  *per_axis('xy', Quantity('theta', 'rad', "tilt about the plate's")))
    choices = grid(height=(0.0, 0.1, -0.1))
    chosen = (Searched('height', 'm', 'h, height of the balls above the supports, negative below', 'phase'),)
    simpler = 10  # a shift along axes is, and little else in the time of a table position

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {**super().brackets(run, setting), 'height': (-HIGHEST, HIGHEST)}

    def directions(self, run: Run) -> Floats:
        """Return the shift along z, what tilts about the plate's x and y do along z, and lean per height, (5, N, 3)."""
        up = on.unit(2, run.size)
        tilts = run.radius * np.stack([np.sin(run.beta), -np.cos(run.beta)])[..., None] * up
        x, y, _ = np.moveaxis(plate_axes(run), -1, 0)
        return np.stack([up, *tilts, -y, x])

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        """Return the Factors, with directions of each height."""
        heights = list(dict.fromkeys(setting.number('height') for setting in settings))
        made, = super().factors(run, settings)
        up, *tilts, x, y = made.directions
        directions = [up, *(tilt + height * lean for height in heights for tilt, lean in zip(tilts, (x, y)))]
        first = {height: 1 + 2 * place for place, height in enumerate(heights)}
        return [replace(made, directions=np.stack(directions), of_setting=tuple(
            (wave, (0, place, place + 1)) for (wave, _), place in zip(
                made.of_setting, (first[setting.number('height')] for setting in settings))))]

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        course, height, (d_z, x, y) = self.course(run, setting).T, setting.number('height'), amplitudes
        # the balls turn about the supports, not about their own centre: h (e_z - R' e_z), to second order
        return Motion(rotate_z(run.phi, course * [x, y, 0]), shift=course * [height * y, -height * x, d_z],
                      beyond=course**2 * [0, 0, 0.5 * height * (x**2 + y**2)])


class PlateWarp(Effect):
    name = 'plate_warp'
    plain = 'warping of the plate'
    meaning = 'The plate warps into a saddle with time.'
    look = 'Uneven temperature of the plate, over-tight clamps, stress in the material.'
    formula = '(a cos(m beta) + b sin(m beta)) t along z'
    source = 'physics of plates'
    depends_on = ('time',)
    quantities = (Quantity('a', 'm/s', 'cosine rate'), Quantity('b', 'm/s', 'sine rate'))
    carries = 'all'
    searched = (Searched('order', '1', 'waves around the plate'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try saddles of two and three waves."""
        return grid(order=(2, 3))

    def columns(self, run: Run, setting: Setting) -> Floats:
        angle = setting.number('order') * run.beta
        out = np.zeros((run.size, 3, 2))
        out[:, 2, 0], out[:, 2, 1] = seconds(run) * np.cos(angle), seconds(run) * np.sin(angle)
        return out


class PlateSupport(Effect):
    name = 'plate_support'
    plain = 'bending of the plate on its supports'
    meaning = 'The plate bends on its supports as it turns: in waves of the table angle times waves of the ball.'
    look = 'Feet and clamps of the plate, flatness of the table top, an axis that is not vertical.'
    formula = '(cos, sin)(p phi) (cos, sin)(m beta), or (cos, sin)(m beta +- p phi), along z, radially or tangentially'
    source = 'physics of plates on supports'
    searched = (Searched('part', '', 'along z, radial or tangential'),
                Searched('p', '1', 'waves per turn of the table'), Searched('m', '1', 'waves around the plate'),
                Searched('wave', '', 'standing on the plate, or travelling as a load that turns against or with it'))
    carries = 'all'
    repeatable = True

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try up to three waves per turn of the table with up to six around the plate."""
        top = (run.n - 1) // 2
        p, m = range(1, min(3, top) + 1), range(min(6, top) + 1)
        every = (*grid(part=('z',), p=p, m=m[2:]), *grid(part=('radial', 'tangential'), p=p, m=m))
        return tuple(Setting({**one, 'wave': wave}) for one in every for wave in (STANDING, *TRAVELLING)
                     if wave == STANDING or one['m'])

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        standing = setting.whole('m') and setting.word('wave', STANDING) == STANDING
        names = ('cc', 'sc', 'cs', 'ss') if standing else ('c', 's')
        return tuple(Quantity(name, 'm', 'amplitude, c cosine and s sine, of the table angle first') for name in names)

    def columns(self, run: Run, setting: Setting) -> Floats:
        along = {'z': on.unit(2, run.size), 'radial': on.radial(run.alpha), 'tangential': on.tangential(run.alpha)}
        turns, around = setting.number('p') * run.phi, setting.number('m') * run.beta
        if setting.word('wave', STANDING) == STANDING:
            waves = [wave * other for other in (np.cos(around), np.sin(around))
                     for wave in (np.cos(turns), np.sin(turns))][:self.width(run, setting)]
        else:
            angle = around + TRAVELLING[setting.word('wave')] * turns
            waves = [np.cos(angle), np.sin(angle)]
        return np.asarray(along[setting.word('part')][:, :, None] * np.stack(waves, axis=-1)[:, None])


PLATE_EFFECTS: tuple[Effect, ...] = (
    PlateShift('plate_creep', Drift(), *per_axis('xy', Quantity('d', 'm/s', "creep rate along the plate's")),
        plain='creep of the plate',
        meaning='The plate slides slowly on the table.',
        look='Clamps, wax or magnets that hold the plate; forces of cables on the plate.',
        formula='R_z(phi) d t'),
    PlateShift('plate_creep_settling', WarmUp(), *per_axis('xy', Quantity('d', 'm', "final shift along the plate's")),
        plain='creep of the plate that comes to rest',
        meaning='The plate slides on the table ever more slowly, until it rests.',
        look='Wax, glue or magnets that hold the plate; let the plate rest after clamping.',
        formula='R_z(phi) d (1 - exp(-t/tau))'),
    PlateSlip(),
    PlateOnSupports('plate_tilt_step', Step('tilt'),
        plain='sudden tilt of the plate',
        meaning='At one moment the plate tilted on the table, and stayed so.',
        look='Feet, shims and clamps of the plate: one that was not seated, a chip that broke, a clamp that let go.',
        formula='R_z(phi) (d_z e_z + theta x (b + h e_z)) H(t - t0), theta in x and y',
        repeatable=True),
    PlateOnSupports('plate_tilt_settling', WarmUp(),
        plain='settling of the plate on its supports',
        meaning='The plate tilts on the table ever more slowly, until it rests.',
        look='Feet on soft or warm ground, wax, pads, shims; clamp the plate and let it rest before measuring.',
        formula='R_z(phi) (d_z e_z + theta x (b + h e_z)) (1 - exp(-t/tau)), theta in x and y'),
    PlateExpansion(),
    PlateGrowth('plate_expansion_lag', LaggedTemperature('m/m'), Quantity('epsilon', '1/K', 'relative growth'),
        plain='expansion of the plate behind the temperature',
        meaning='The plate grows and shrinks with the measured temperature, but later.',
        look='A thick plate, or a sensor that is not on the plate: measure the temperature of the plate itself.',
        formula="epsilon R e_r T', where tau dT'/dt = T - T0 - T'",
        source='ISO 1 and ISO 10360 (thermal expansion)',
        simpler=10),  # to follow at once is, and looks alike where an order hides much
    PlateGrowth('plate_soaking', WarmUp(), Quantity('epsilon', 'm/m', 'final relative growth'),
        plain='expansion of the plate until it has soaked',
        meaning='The plate grows or shrinks towards a size as it takes the temperature of the cell.',
        look='A plate from a store, a washer or warm hands; let it soak before measuring.',
        formula='epsilon R e_r (1 - exp(-t/tau))',
        source='ISO 1 and ISO 10360 (thermal expansion)'),
    PlateWarp(), PlateSupport())
"""In the order of tables and pages."""
