# SPDX-License-Identifier: Apache-2.0
"""A CMM with rotary table behind an I++ DME server that measures balls: turn, move, touch, fit, read the thermometer.

Everything is checked before a move is sent, and nothing moves once it was halted or a person has to look.
"""

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.axes import words
from rosette_ros.core.run.errors import CellError, RosetteError
from rosette_ros.core.run.geometry import TWO_PI, Floats
from rosette_ros.core.run.touches import fit_spheres
from rosette_ros.dme.dme_plan import PlannedBall, refuse_target
from rosette_ros.dme.dme_session import CLAMPED, DmeSession, DmeStopped, SentCommand, ToolNotInUse
from rosette_ros.dme.dme_settings import DmeSettings
from rosette_ros.dme.probe_path import PathStep, ball_path, lift, lifted, obstacles, refuse_to_turn, refuse_unsafe
from rosette_ros.dme.rotary_table import TableState, read_table, turn_table, turning_steps
from rosette_ros.dme.wire import Call, Value, Word, call, format_value, named, number, numbers, shown

DEFECT = -273.0
"""A sensor that reads no more than this, degrees Celsius, is defect."""
OFF_PLACE = 1e-4
"""How far from where it was sent the tip may stand after it was lifted, m."""


@dataclass(frozen=True, eq=False)
class MeasuredBall:
    """One ball as it was touched.

    points: (Q, 3) centres of the tip, m; normals: (Q, 3); touch_times: (Q,), when the server reported each touch, s of
    the system clock; centre: (3,) of the least-squares sphere, m; radius: of it, m; form_error: m; table_angle in
    [0, 2 pi), table_travel unwrapped, rad; approach: sense of the last table move, 0 before the first; temperature:
    degrees Celsius or NaN."""

    points: Floats
    normals: Floats
    touch_times: Floats
    centre: Floats
    radius: float
    form_error: float
    table_angle: float
    table_travel: float
    approach: int
    temperature: float

    @property
    def time(self) -> float:
        """When it was measured: the mean of its touches, s."""
        return float(self.touch_times.mean())


class DmeCmm:
    """The machine behind a session, as configured; remarks: what the server has made of the settings, in sentences."""

    def __init__(self, session: DmeSession, settings: DmeSettings) -> None:
        self.session, self.settings = session, settings
        self.table = TableState(0.0)
        self.remarks: list[str] = []
        self._has_thermometer = True

    async def prepare(self, may_move: bool = True) -> None:
        """Bring tool, speeds and reports to what is configured, and read back what came of it; nothing homes.

        may_move: whether a tool that is not in use may be changed for, which moves the machine."""
        settings, session = self.settings, self.session
        homed = await self.session.optional(Call('IsHomed'))
        if homed and numbers(homed[0], 'IsHomed') == (0.0,):
            raise CellError(f'{session.where}: expected a homed machine, found IsHomed(0); home it at the machine')
        machine = await session.optional(Call('GetMachineClass'))
        if not settings.simulated and 'simulated' in str(machine).lower():
            raise CellError(f'{session.where}: expected "simulated: true" in the settings, since the server says that '
                            'its machine is simulated: logs and certificates of its runs have to say so')
        await self.session.request(call('SetCoordSystem', Word('MachineCsy')))
        await self._take_tool(may_move)
        motion, remarks = settings.motion, list[str]()
        wanted = {'GoToPar.Speed': motion.dry_run_speed_mm_s if settings.dry_run else motion.speed_mm_s,
                  'PtMeasPar.Speed': motion.touch_speed_mm_s, 'PtMeasPar.Approach': motion.approach_mm,
                  'PtMeasPar.Search': motion.search_mm, 'PtMeasPar.Retract': motion.retract_mm}
        for name, value in wanted.items():
            found = await self._set_property(f'Tool.{name}', value) if value is not None else value
            if found != value:
                remarks.append(f'Tool.{name}: asked {value:g}, the server has '
                               f'{"no such property" if found is None else f"{found:g}"}')
            most = settings.path.stand_off_mm
            if found is not None and name.endswith(('Approach', 'Retract')) and found > most:
                raise CellError(f'{session.where}: Tool.{name}: expected at most path.stand_off_mm = {most:g}, found '
                                f'{found:g}, as the server has it')
        radius = await self.session.property_of('Tool.AvrRadius')
        if radius is not None and abs(radius - settings.tool.tip_radius_mm) > settings.tool.tip_tolerance_mm:
            raise CellError(f'{session.where}: expected a tip radius of {settings.tool.tip_radius_mm:g} mm '
                            f'(tool.tip_radius_mm), found {radius:g} from the server: is it the right tool?')
        await self.session.request(call('OnPtMeasReport', *map(Call, 'XYZ')))
        self.table = TableState(await read_table(self.session.request, settings.table))
        self.remarks = remarks

    async def _take_tool(self, may_move: bool) -> None:
        wanted = self.settings.tool.name
        if wanted and self.settings.tool.change:
            name = named(sum(await self.session.optional(call('GetProp', Call('Tool.Name'))) or [], ()), 'Tool.Name')
            if name == (wanted,):
                return
            if not may_move:
                raise ToolNotInUse(f'{self.session.where}: expected the tool {wanted!r} in use, found '
                                   f'{shown(name or ())}; '
                                   'it is changed for, which moves the machine, before the first ball')
        if wanted:
            try:
                await self.session.request(call('ChangeTool' if self.settings.tool.change else 'SetTool', wanted))
            except asyncio.CancelledError:
                if self.settings.tool.change:
                    await self.session.halt()
                raise

    async def _set_property(self, name: str, value: float) -> float | None:
        if await self.session.optional(call('SetProp', call(name, value))) is None:
            return None
        return await self.session.property_of(name)

    async def _moved(self, wanted: Call) -> SentCommand:
        """Send a command that moves; raises CellError also where the server warns that it has clamped an argument."""
        sent = await self.session.carry_out(wanted)
        for warning in sent.warnings:
            if warning.number == CLAMPED:
                raise CellError(f'{format_value(wanted)}: {warning}; expected a place that the machine reaches, it '
                                'went '
                                'elsewhere: see path.clearance_mm, path.box_low_mm, path.box_high_mm and the limits '
                                'of the machine')
        return sent

    async def position(self) -> Floats:
        """Return where the tip centre is, (3,), m."""
        values = sum(await self.session.request(call('Get', *map(Call, 'XYZ'))), ())
        return 1e-3 * np.array([numbers(values, axis)[0] for axis in 'XYZ'])

    async def measure(self, ball: int, centre: ArrayLike, table_angle: float, approach: int = 0,
                      pole: ArrayLike = (0.0, 0.0, 0.0), touches: int = 0) -> MeasuredBall:
        """Turn the table, touch a ball and return it; arguments and errors as of `go_around`."""
        path, points, times = await self.go_around(ball, centre, table_angle, approach, pole, touches)
        if not times:
            raise CellError(f'dry run: the way around ball {ball} was made above the plate, nothing was touched')
        angle = await read_table(self.session.request, self.settings.table, self.table.angle)
        temperature = await self.temperature()
        touched, normals = np.array(points), np.array([step.normal for step in path if step.normal is not None])
        sphere, travel = fit_spheres(touched[None]), float(np.deg2rad(angle))
        if self._is_compensated(float(sphere.radius[0])):
            # The radius of the tip was taken off along the commanded normals, not along those of the ball where it was
            # touched: without it 6 touches that are 0.1 mm off the middle shift the centre by 0.3 um.
            touched = touched + 1e-3 * self.settings.tool.tip_radius_mm * normals
            sphere = fit_spheres(touched[None])
        return MeasuredBall(
            touched, normals, np.array(times), sphere.centre[0], float(sphere.radius[0]), float(sphere.form[0]),
            travel % TWO_PI, travel, self.table.approach, temperature)

    async def go_around(self, ball: int, centre: ArrayLike, table_angle: float, approach: int = 0,
                        pole: ArrayLike = (0.0, 0.0, 0.0),
                        touches: int = 0) -> tuple[list[PathStep], list[Floats], list[float]]:
        """Turn the table and go around a ball; return the steps, the touched points, (3,), m, and their times, s.

        ball: one-based; centre: where it is expected, m; table_angle: rad; approach: sense in which the table gets
        there, 0 for the shorter way; pole: to the side of the ball that is probed, 0, 0, 0 for the table axis; touches:
        0 for the usual number. In a dry run all happens higher by the clearance, and nothing is touched. Raises
        InvalidPlan where the way is not safe, CellError where the machine refuses or finds no ball; the tip then stands
        in the clearance plane, unless a person has to look.
        """
        settings, place = self.settings, np.asarray(centre, dtype=float)
        balls, own = refuse_target(settings, PlannedBall(
            settings.table.balls, 0, ball, place, table_angle, approach, np.asarray(pole, dtype=float), touches))
        path = ball_path(settings, place, settings.table.frame.rotation[:, 2], touches)
        path = lifted(settings, path) if settings.dry_run else path
        around = obstacles(settings, balls, own, place)
        refuse_unsafe(settings, path, around)
        points, times, step = list[Floats](), list[float](), None
        try:
            position, target = await self._lift(), float(np.rad2deg(table_angle))
            if turning_steps(settings.table, self.table, target, approach):
                refuse_to_turn(settings, position)
                await turn_table(self._moved, self.session.request, settings.table, self.table, target, approach)
            refuse_unsafe(settings, path, around, start=position)
            for step in path:
                if step.normal is None:
                    await self._moved(go_to(step.point))
                else:
                    point, moment = await self._touch(step, step.normal)
                    points.append(point)
                    times.append(moment)
        except RosetteError as error:
            if self.session.is_halted or self.session.for_person or isinstance(error, DmeStopped):
                raise
            if self.session.stop:
                await self.session.clear()
            if step is None:
                raise  # the tip has not come down
            await self._lift()
            raise CellError(f'{step.why}: {error}') from error
        return path, points, times

    async def _lift(self) -> Floats:
        """Bring the tip to the clearance plane, unless it is above; return where it then is as read back, (3,), m.

        Raises CellError where it is not where it was sent."""
        position, table = await self.position(), self.settings.table
        angle = await read_table(self.session.request, table, self.table.angle)
        if abs(angle - self.table.angle) > table.tolerance_deg:  # a person has turned it
            self.table.approach = 0
        self.table.angle = angle
        steps = lift(self.settings, position, table.frame.to_outer(table.balls_at(np.deg2rad(self.table.angle))))
        for step in steps:
            await self._moved(go_to(step.point))
        if not steps:
            return position
        position = await self.position()
        if not np.linalg.norm(position - steps[-1].point) <= OFF_PLACE:
            raise CellError(f'lift to the clearance plane: expected the tip at {words(1e3 * steps[-1].point)} mm, '
                            'found '
                            f'{words(1e3 * position)} from X, Y, Z; nothing turns')
        return position

    async def _touch(self, step: PathStep, normal: Floats) -> tuple[Floats, float]:
        """Return a touched point, (3,), m, and when it was reported, s; raises CellError for what is none."""
        sent = await self._moved(call('PtMeas', *coordinates(step.point), call('IJK', *normal.tolist())))
        values = sum(sent.data, ())
        point = np.array([numbers(values, axis)[0] for axis in 'XYZ'])
        motion, tip = self.settings.motion, self.settings.tool.tip_radius_mm
        most = motion.approach_mm + motion.search_mm + 2 * tip
        if np.linalg.norm(point - 1e3 * step.point) > most:
            raise CellError(f'expected a point within {most:g} mm of {words(1e3 * step.point)} mm, found '
                            f'{words(point)}: '
                            'does the server count in mm and in machine coordinates?')
        return 1e-3 * point, sent.data_time

    def _is_compensated(self, radius: float) -> bool:
        """Return whether touches on a sphere of a radius, m, are on the ball; raises CellError for no such sphere."""
        ball, tip, found = self.settings.ball.radius_mm, self.settings.tool.tip_radius_mm, 1e3 * radius
        off, is_compensated = min((abs(found - ball - tip), False), (abs(found - ball), True))
        if off > self.settings.ball.radius_tolerance_mm:
            raise CellError(f'expected a sphere of radius {ball:g} mm, or {ball + tip:g} with the tip, found '
                            f'{found:.3f}; '
                            'see ball.radius_mm, tool.tip_radius_mm and the qualification of the tool')
        return is_compensated

    async def temperature(self) -> float:
        """Return the temperature at the plate, degrees Celsius; NaN where there is no sensor, or a defect one."""
        sensor = self.settings.temperature_sensor
        if self._has_thermometer:
            wanted = call('ReadTemperatureSensor', sensor) if sensor else Call('ReadAllTemperatures')
            data = await self.session.optional(wanted)
            self._has_thermometer = data is not None
            return next((value for value in _temperatures(sum(data or [], ())) if value > DEFECT), np.nan)
        return np.nan


def _temperatures(values: Sequence[Value]) -> Iterator[float]:
    """Yield the numbers in values, also those in brackets, in quotes only where they are called a temperature."""
    for value in values:
        if isinstance(value, Call):
            inner = value.values
            yield from map(number, inner) if value.name.endswith('Temperature') else _temperatures(inner)
        elif not isinstance(value, str):
            yield value


def coordinates(point: Floats) -> list[Call]:
    """Return X(...), Y(...), Z(...) of a point (3,), m."""
    return [call(axis, value) for axis, value in zip('XYZ', (1e3 * point).tolist())]


def go_to(point: Floats) -> Call:
    """Return the command that moves the tip to (3,), m."""
    return call('GoTo', *coordinates(point))
