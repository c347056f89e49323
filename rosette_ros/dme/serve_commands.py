# SPDX-License-Identifier: Apache-2.0
"""The commands of the simulated server: what each takes, does and answers. Millimetres and degrees as on the wire."""

import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from rosette_ros.core.records import Floats
from rosette_ros.dme.serve_errors import PREDEFINED, Refused
from rosette_ros.dme.serve_settings import DmeFaults, ServeSettings
from rosette_ros.dme.virtual_cmm import MovePace, TouchParameters, VirtualCmm, short_way
from rosette_ros.dme.wire import Call, Value, Word, call
from rosette_ros.simulation import MachineConfig
from rosette_ros.simulation.touch_by_touch import SingleTouch

Line: TypeAlias = tuple[Value, ...]
AXES, INCH = ('X', 'Y', 'Z'), 25.4
VERSIONS = {'1.4': '1.4.3', '2.x': '2.5'}
SYSTEMS = ('MachineCsy', 'MoveableMachineCsy', 'MultipleArmCsy', 'PartCsy')
REPORTABLE = (*AXES, 'IJK', 'ER', 'Q', 'R')
MOST_TURN = 36000.0
"""Degrees that the table may be turned by one command: a hundred turns."""
SENSOR = 'Part'
WITHOUT = frozenset(('GetDMEVersion', 'GetMachineClass', 'IsHomed', 'EnableUser', 'DisableUser', 'IsUserEnabled',
                     'EnumTools', 'Tool', 'FoundTool', 'GetCoordSystem', 'GetErrStatusE', 'GetXtdErrStatus',
                     'GetTemperatureSensors', 'ReadAllTemperatures'))
"""Commands without arguments."""
UNQUALIFIED, REFERENCE, NONE = 'Unqualified', 'RefTool', 'NoTool'


@dataclass(frozen=True)
class ToolParameter:
    """A parameter of a tool, mm, mm/s or mm/s^2: what may be set, what is set, and what a change of tool sets."""

    least: float
    most: float
    act: float
    default: float

    def parts(self) -> dict[str, float]:
        """Return its parts by their names in the protocol; the empty one is what is set."""
        return {'': self.act, '.Min': self.least, '.Max': self.most, '.Act': self.act, '.Def': self.default}


def parameters(cmm_speed: float, is_narrow: bool) -> dict[str, ToolParameter]:
    """Return the parameters of a tool as they are qualified; cmm_speed: mm/s; is_narrow: the limits are narrow."""
    wide = {'GoToPar.Speed': (1.0, 500.0, cmm_speed), 'GoToPar.Accel': (10.0, 3000.0, 1500.0),
            'PtMeasPar.Speed': (0.1, 20.0, 5.0), 'PtMeasPar.Accel': (10.0, 1000.0, 100.0),
            'PtMeasPar.Approach': (0.5, 20.0, 3.0), 'PtMeasPar.Search': (0.5, 20.0, 5.0),
            'PtMeasPar.Retract': (-1.0, 20.0, 3.0)}
    return {name: ToolParameter(least, 1.1 * act if is_narrow else most, act, act)
            for name, (least, most, act) in wide.items()}


class ServedCommands:
    """The state that commands change, and the commands by name, `at_once` and `moving`, that return lines of values."""

    def __init__(self, config: MachineConfig, settings: ServeSettings, faults: DmeFaults) -> None:
        self.settings, self.faults, self.cmm = settings, faults, VirtualCmm(config, settings, faults)
        self.tools = {name: parameters(config.timing.cmm_speed_mm_per_s, faults.has('clamped'))
                      for name in (REFERENCE, NONE, settings.tool, UNQUALIFIED)}
        self.tool, self.found, self.system, self.is_user_enabled = settings.tool, '', SYSTEMS[0], True
        self.report: tuple[str, ...] = AXES
        self.wants_clear = False
        self._unit = INCH if faults.has('inch') else 1.0
        plain = {'GetDMEVersion': self._about, 'GetMachineClass': self._about, 'IsHomed': self._about,
                 'EnableUser': self._user, 'DisableUser': self._user, 'IsUserEnabled': self._about,
                 'EnumTools': self._about, 'Tool': self._nothing, 'FoundTool': self._nothing, 'FindTool': self._find,
                 'SetTool': self._set_tool, 'GetProp': self._get_prop, 'GetPropE': self._get_prop,
                 'SetProp': self._set_prop, 'EnumProp': self._enum_prop, 'EnumAllProp': self._enum_prop,
                 'SetCoordSystem': self._set_system, 'GetCoordSystem': self._about, 'Get': self._get,
                 'OnPtMeasReport': self._on_report, 'GetErrorInfo': self._error_info,
                 'GetErrStatusE': self._about, 'GetXtdErrStatus': self._about}
        modern = {'GetTemperatureSensors': self._temperatures, 'ReadTemperatureSensor': self._temperatures,
                  'ReadAllTemperatures': self._temperatures, 'EnableRotaryTableVarCsy': self._nothing}
        self.at_once: Mapping[str, Callable[[Call], list[Line]]] = plain | (
            modern if settings.dialect == '2.x' else {})
        self.moving: Mapping[str, Callable[[Call], Awaitable[list[Line]]]] = {
            'Home': self._home, 'GoTo': self._go_to, 'ChangeTool': self._change_tool, 'AlignPart': self._align_part}

    async def carry_out(self, command: Call, on_contact: Callable[[Line], None]) -> list[Line]:
        """Return the data that a command answers, once it is done; raises Refused.

        on_contact: called with the data of PtMeas as soon as it has touched; the retract follows."""
        if command.name == 'PtMeas':
            self.is_user_enabled = False
            await self._pt_meas(command, on_contact)
            return []
        if command.name not in self.moving:
            return self.answer(command)
        self.is_user_enabled = False
        return await self.moving[command.name](command)

    def answer(self, command: Call) -> list[Line]:
        """Return the data of a command that takes no time; raises Refused, 501 where it is none."""
        if command.name not in self.at_once:
            raise Refused(501, command.name)
        if command.values and command.name in WITHOUT:
            raise Refused(502, command.name)
        return self.at_once[command.name](command)

    def begin_session(self) -> None:
        """Set what a session begins with."""
        self.report, self.is_user_enabled = AXES, True

    def place_values(self, names: Sequence[str]) -> Line:
        """Return position and angle by name, as Get does."""
        place = 1e3 * self.cmm.place
        return tuple(call(name, self._shown_angle() if name == 'R' else self._length(place[AXES.index(name)]))
                     for name in names)

    def _length(self, value: float) -> float:
        return round(float(value) / self._unit, self.settings.decimals)

    def _shown_angle(self) -> float:
        angle = round(self.settings.sign * math.degrees(self.cmm.angle), self.settings.decimals)
        return angle if self.settings.cumulative else angle % 360.0

    def _nothing(self, command: Call) -> list[Line]:
        return []

    def _about(self, command: Call) -> list[Line]:
        """Return what the server says of itself: a value a line."""
        homed, user = call('IsHomed', float(self.cmm.is_homed)), call('IsUserEnabled', float(self.is_user_enabled))
        answers: dict[str, tuple[Value, ...]] = {
            'GetDMEVersion': (call('DMEVersion', VERSIONS[self.settings.dialect]),),
            'GetMachineClass': (call('GetMachineClass', Word('SimulatedCartCMMWithRotaryTable')),), 'IsHomed': (homed,),
            'IsUserEnabled': (user,), 'EnumTools': tuple(self.tools),
            'GetCoordSystem': (call('CoordSystem', Word(self.system)),),
            'GetErrStatusE': (call('ErrStatus', float(self.wants_clear)),), 'GetXtdErrStatus': (homed, user)}
        return [(value,) for value in answers[command.name]]

    def _error_info(self, command: Call) -> list[Line]:
        which = int(_number(command, command.name))
        if which not in PREDEFINED:
            raise Refused(509, command.name)
        return [(PREDEFINED[which][1],)]

    def _user(self, command: Call) -> list[Line]:
        self.is_user_enabled = command.name == 'EnableUser'
        return []

    def _known_tool(self, command: Call) -> str:
        name = _one(command)
        if isinstance(name, Word) or not isinstance(name, str):
            raise Refused(509, command.name)
        if name not in self.tools:
            raise Refused(1502, command.name)
        return name

    def _find(self, command: Call) -> list[Line]:
        self.found = ''
        self.found = self._known_tool(command)
        return []

    def _set_tool(self, command: Call) -> list[Line]:
        self.tool = self._known_tool(command)
        self.tools[self.tool] = {name: replace(one, act=one.default) for name, one in self.tools[self.tool].items()}
        return []

    async def _change_tool(self, command: Call) -> list[Line]:
        name = self._known_tool(command)
        if name != self.tool:
            # The rack is at the home position: like a real one, it is reached on the straight way.
            await self.cmm.go_to(self.cmm.home_place, None, self._pace('GoToPar'), command.name)
        return self._set_tool(command)

    def _properties(self, owner: str) -> dict[str, float | str]:
        """Return the properties of the active tool, `Tool`, or the found one by their whole names."""
        name = {'Tool': self.tool, 'FoundTool': self.found or 'UnDefTool'}.get(owner, '')
        if not name:
            raise Refused(510, 'GetProp')
        out: dict[str, float | str] = {f'{owner}.Name': name, f'{owner}.Id': name}
        if name in self.tools:
            out[f'{owner}.AvrRadius'] = 0.0 if name == NONE else 1e3 * self.cmm.cell.pattern.tip / self._unit
            out |= {f'{owner}.{parameter}{part}': value / self._unit
                    for parameter, one in self.tools[name].items() for part, value in one.parts().items()}
        return out

    def _get_prop(self, command: Call) -> list[Line]:
        return [tuple(call(one.name, self._property(one)) for one in _calls(command))]

    def _property(self, asked: Call) -> float | str:
        owner = asked.name.partition('.')[0]
        if owner == 'FoundTool' and not self.found:
            raise Refused(1503, 'GetProp')
        found = self._properties(owner).get(asked.name)
        if found is None or asked.values:
            raise Refused(510, 'GetProp')
        return found

    def _set_prop(self, command: Call) -> list[Line]:
        made = dict(self.tools[self.tool])
        is_clamped = False
        for one in _calls(command):
            name = one.name.removeprefix('Tool.').removesuffix('.Act')
            if name not in made or not one.name.startswith('Tool.'):
                raise Refused(510, command.name)
            wanted, parameter = _number(one, command.name) * self._unit, made[name]
            act = min(max(wanted, parameter.least), parameter.most)
            is_clamped |= act != wanted
            made[name] = replace(parameter, act=act)
        self.tools[self.tool] = made
        if is_clamped:
            raise Refused(504, command.name)
        return []

    def _enum_prop(self, command: Call) -> list[Line]:
        """Return names and types below a name; EnumProp: those directly below it, a `Property` has its own."""
        under = f'{_calls(Call(command.name, (_one(command),)))[0].name}.'
        known = {name[len(under):]: value for name, value in self._properties(under.partition('.')[0]).items()
                 if name.startswith(under)}
        if not known:
            raise Refused(510, command.name)
        kinds = {name: 'String' if isinstance(value, str) else 'Number' for name, value in known.items()}
        if command.name == 'EnumAllProp':
            return list(kinds.items())
        parents = dict.fromkeys(name.partition('.')[0] for name in kinds if '.' in name)
        return [*((name, kind) for name, kind in kinds.items() if '.' not in name),
                *((name, 'Property') for name in parents)]

    def _set_system(self, command: Call) -> list[Line]:
        name = _one(command)
        if not isinstance(name, Word) or name not in SYSTEMS:
            raise Refused(509, command.name)
        self.system = str(name)  # no transformation can be set: all are the machine's own
        return []

    def _get(self, command: Call) -> list[Line]:
        names = [one.name for one in _calls(command)]
        if not set(names) <= {*AXES, 'R'} or any(one.values for one in _calls(command)):
            raise Refused(506, command.name)
        return [self.place_values(names)]

    def _on_report(self, command: Call) -> list[Line]:
        names = tuple(one.name for one in _calls(command))
        if not names or not set(names) <= set(REPORTABLE) or len(set(names)) < len(names):
            raise Refused(510, command.name)
        self.report = names
        return []

    def _temperatures(self, command: Call) -> list[Line]:
        value = round(self.cmm.temperature(), 6)
        if command.name == 'GetTemperatureSensors':
            return [(call('Name', SENSOR), call('Kind', Word('Part')), call('CMMTempCorrection', 0.0))]
        if command.name == 'ReadAllTemperatures':
            return [(call('Name', SENSOR), call('Temperature', value))]
        return [(value if _one(command) == SENSOR else -273.0,)]

    def _pace(self, block: str) -> MovePace:
        tool = self.tools[self.tool]
        return MovePace(1e-3 * tool[f'{block}.Speed'].act, 1e-3 * tool[f'{block}.Accel'].act)

    async def _home(self, command: Call) -> list[Line]:
        if command.values:
            raise Refused(502, command.name)
        await self.cmm.home()
        return []

    def _target(self, command: Call, others: Sequence[str]) -> tuple[Floats, dict[str, Call]]:
        """Return the place (3,), m, that the axes of a command name, and its other arguments by name."""
        given = {one.name: one for one in _calls(command)}
        if not given or not set(given) <= {*AXES, *others}:
            raise Refused(505, command.name)
        place = self.cmm.place.copy()
        for axis, name in enumerate(AXES):
            if name in given:
                place[axis] = 1e-3 * self._unit * _number(given[name], command.name)
        return place, given

    async def _go_to(self, command: Call) -> list[Line]:
        place, given = self._target(command, ['R'])
        angle = None
        if 'R' in given:
            value, now = _number(given['R'], command.name), self.cmm.angle
            if not (self.settings.cumulative and not self.faults.has('r_limited')) and not 0 <= value <= 360:
                raise Refused(2505, command.name)
            angle = math.radians(self.settings.sign * value)
            angle = angle if self.settings.cumulative else short_way(angle, now)
            if abs(angle - now) > math.radians(MOST_TURN) + 1e-9:
                raise Refused(2505, command.name)
        await self.cmm.go_to(place, angle, self._pace('GoToPar'), command.name)
        return []

    async def _pt_meas(self, command: Call, on_contact: Callable[[Line], None]) -> None:
        if self.tool == NONE:
            raise Refused(1503, command.name)
        if self.tool == UNQUALIFIED:
            raise Refused(2000, command.name)
        place, given = self._target(command, ['IJK'])
        if not set(given) & set(AXES):
            raise Refused(502, command.name)
        # Without IJK the probe comes from where it stands.
        outwards = (np.array(_numbers(given['IJK'], command.name)) if 'IJK' in given
                    else self.cmm.place - place)
        if outwards.shape != (3,):
            raise Refused(502, command.name)
        length = float(np.linalg.norm(outwards))
        if not 1e-9 < length < 1e9:
            raise Refused(1010, command.name)
        outwards = outwards / length
        tool = {name.removeprefix('PtMeasPar.'): one.act for name, one in self.tools[self.tool].items()}
        await self.cmm.measure(place, outwards, self._pace('GoToPar'), TouchParameters(
            self._pace('PtMeasPar'), 1e-3 * tool['Approach'], 1e-3 * tool['Search'], 1e-3 * tool['Retract']),
            lambda touch: on_contact(self._touched(touch, outwards)))

    def _touched(self, touch: SingleTouch, outwards: Floats) -> Line:
        """Return what is reported of a touch."""
        tip = self.cmm.cell.pattern.tip
        point = 1e3 * (touch.tip - tip * outwards if self.settings.compensated else touch.tip)
        values = {name: (self._length(point[axis]),) for axis, name in enumerate(AXES)}
        values |= {'IJK': tuple(round(one, 9) for one in outwards.tolist()), 'ER': (self._length(1e3 * tip),),
                   'Q': (0.0,), 'R': (self._shown_angle(),)}
        return tuple(call(name, *values[name]) for name in self.report)

    async def _align_part(self, command: Call) -> list[Line]:
        """Turn the table so that a direction of the part, given as at R = 0, points along one of the machine."""
        values = _numbers(command, command.name)
        if len(values) != 7:
            raise Refused(502, command.name)
        frame = self.cmm.machine.rough_frame.rotation
        flat = np.array([values[:3], values[3:6]]) @ frame
        flat[:, 2] = 0.0
        length = np.linalg.norm(flat, axis=1)
        if not (length > 1e-9).all():
            raise Refused(1010, command.name)
        flat = flat / length[:, None]
        angle = np.arctan2(flat[1, 1], flat[1, 0]) - np.arctan2(flat[0, 1], flat[0, 0])
        await self.cmm.go_to(self.cmm.place, short_way(float(angle), self.cmm.angle), self._pace('GoToPar'),
                             command.name)
        return [tuple((flat @ frame.T).ravel().tolist())]


def _calls(command: Call) -> tuple[Call, ...]:
    """Return the arguments of a command that are all Name(values), each name once."""
    found = tuple(one for one in command.values if isinstance(one, Call) and one.name)
    if len(found) < len(command.values) or len({one.name for one in found}) < len(found) or not found:
        raise Refused(502, command.name)
    return found


def _one(command: Call, what: str = '') -> Value:
    if len(command.values) != 1:
        raise Refused(502, what or command.name)
    return command.values[0]


def _numbers(given: Call, what: str) -> list[float]:
    """Return the finite numbers of Name(numbers) in the command `what`; in commands they stand without quotes."""
    made = [value for value in given.values if isinstance(value, float) and math.isfinite(value)]
    if len(made) < len(given.values):
        raise Refused(509, what)
    return made


def _number(given: Call, what: str) -> float:
    _one(given, what)
    return _numbers(given, what)[0]
