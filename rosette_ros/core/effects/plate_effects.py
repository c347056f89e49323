# SPDX-License-Identifier: Apache-2.0
"""Effects of the ball plate: it creeps, slips, grows, warps; its balls move or are not round."""


import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import LEAST_KNOWN, Effect, Motion, Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.effects.factored_effect import FactoredEffect, Step
from rosette_ros.core.effects.run_functions import plate_axes, seconds
from rosette_ros.core.records import Floats, Run

STANDING = 'standing'
TRAVELLING = {'against': -1, 'with': 1}
"""Senses in which a load turns in the frame of the plate, beside the table's."""


class PlateCreep(Effect):
    name = 'plate_creep'
    plain = 'creep of the plate'
    meaning = 'The plate slides slowly on the table.'
    look = 'Clamps, wax or magnets that hold the plate; forces of cables on the plate.'
    formula = 'R_z(phi) d t'
    source = 'physics of clamping'
    depends_on = ('time',)
    quantities = per_axis('xy', Quantity('d', 'm/s', "creep rate along the plate's"))
    carries = 'all'

    def columns(self, run: Run, setting: Setting) -> Floats:
        return seconds(run)[:, None, None] * plate_axes(run)[..., :2]

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        return Motion(shift=seconds(run)[:, None] * [*amplitudes, 0])


class PlateSlip(FactoredEffect):
    name = 'plate_slip'
    plain = 'slip of the plate'
    meaning = 'At one moment the whole plate slipped on the table.'
    look = 'Clamps; a collision with the plate; acceleration of the table.'
    formula = '(R_z(phi) d + gamma R e_t) H(t - t0)'
    source = 'physics of clamping'
    depends_on = ('time',)
    quantities = (*per_axis('xy', Quantity('d', 'm', "shift along the plate's")),
                  Quantity('gamma', 'rad', 'turn about z'))
    carries = 'nothing'
    searched = (Searched('t0', 's', 'moment of the slip, since the first reading', 'instant'),)
    function = Step()
    acts = 0, 1, 2

    def directions(self, run: Run) -> Floats:
        """Return shifts along the plate's x and y and a turn about z, (3, N, 3)."""
        turn = run.radius * on.tangential(run.alpha)[None]
        return np.concatenate([np.moveaxis(plate_axes(run)[..., :2], -1, 0), turn])

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        since = 1.0 * (seconds(run) > setting.number('t0'))[:, None]
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
