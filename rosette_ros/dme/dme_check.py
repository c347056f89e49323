# SPDX-License-Identifier: Apache-2.0
"""What a server tells about itself: version, tools, axes, limits, thermometers, dialect. Nothing moves."""

from rosette_ros.dme.dme_session import Data, DmeSession
from rosette_ros.dme.wire import Call, call, named, shown
from rosette_ros.io.reading_checks import Check

SPEEDS = tuple(f'Tool.{group}.{name}' for group in ('GoToPar', 'PtMeasPar') for name in ('Speed', 'Accel'))
NAMES = {'': '', '.Min': 'least ', '.Max': 'most '}
LENGTHS = tuple(f'Tool.PtMeasPar.{name}' for name in ('Approach', 'Search', 'Retract'))


async def look_at(session: DmeSession) -> list[Check]:
    """Return what the server says; raises CellError where it takes no more commands."""
    out = list[Check]()

    async def asked(name: str, *calls: Call, wanted: bool | None = None) -> Data:
        data: Data = []
        for one in calls:
            data += await session.optional(one) or []
        out.append(Check(name, wanted and bool(data), '; '.join(map(shown, data)) or 'not supported'))
        return data

    await asked('version', Call('GetDMEVersion'))
    await asked('machine', Call('GetMachineClass'))
    homed = await session.optional(Call('IsHomed'))
    is_homed = None if not homed else named(homed[0], 'IsHomed') == (1.0,)
    out.append(Check('homed', is_homed,
                     {None: 'not supported', True: 'yes', False: 'no: home it at the machine'}[is_homed]))
    await asked('tools', Call('EnumTools'))
    await asked('tool in use', call('GetProp', Call('Tool.Name')))
    await asked('tip', call('GetProp', Call('Tool.AvrRadius')))
    await asked('position / mm', call('Get', *map(Call, 'XYZ')), wanted=True)
    await asked('table / deg', call('Get', Call('R')), wanted=True)
    for name in (*SPEEDS, *LENGTHS):
        found = {end: await session.property_of(f'{name}{end}') for end in NAMES}
        known = [f'{NAMES[end]}{value:g}' for end, value in found.items() if value is not None]
        out.append(Check(name, None, ', '.join(known) or 'not supported'))
    await asked('temperatures / °C', Call('ReadAllTemperatures'))
    return out
