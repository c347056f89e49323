# SPDX-License-Identifier: Apache-2.0
"""What each effect of the library moves and on what it depends, as docs/effects.md states it."""

from benchmarks.blind.cause import BODIES, Names, Variables, said

FRAME, PLATE, TURN, AXIS, TILT, GROWTH, SCALES, OVAL = ((body,) for body in BODIES)
Z = FRAME + PLATE
"""Along z both move alike."""
LIBRARY: dict[str, tuple[Names, Variables]] = {
    **{f'frame_{name}': (FRAME, said('time')) for name in (
        'drift', 'drift_onset', 'drift_curved', 'warmup', 'cycle', 'step', 'pulse', 'recovery')},
    'frame_temperature': (FRAME, said('temperature')),
    'frame_temperature_lag': (FRAME, said('temperature')),
    **{f'{part}_{name}': (body, said('time')) for part, body in (('table_zero', TURN), ('axis_tilt', AXIS))
       for name in ('drift', 'warmup', 'step')},
    **{f'{part}_{name}': (body, said('temperature')) for part, body in (('table_zero', TURN), ('axis_tilt', AXIS))
       for name in ('temperature', 'lag')},
    'table_backlash': (TURN, said('table sense')),
    'table_backlash_angle': (TURN, said('table sense + table angle')),
    'encoder_interpolation': (TURN, said('table angle')),
    'asynchronous_motion': (Z + AXIS, said('travel')),
    'table_warmup': (Z, said('travel')),
    'plate_creep': (PLATE, said('time')),
    'plate_creep_settling': (PLATE, said('time')),
    'plate_slip': (PLATE + TURN, said('time')),
    'plate_tilt_step': (TILT, said('time')),
    'plate_tilt_settling': (TILT, said('time')),
    'plate_expansion': (GROWTH, said('time', 'temperature')),
    'plate_expansion_lag': (GROWTH, said('temperature')),
    'plate_soaking': (GROWTH, said('time')),
    'plate_warp': (Z, said('ball + time')),
    'plate_support': (Z, said('ball + table angle')),
    'ball_slip': (PLATE, said('ball + time')),
    'ball_creep': (PLATE, said('ball + time')),
    'ball_rattle': (PLATE, said('ball + time', 'ball + table sense')),
    'ball_machine_offset': (FRAME, said('ball')),
    'ball_sag': (PLATE, said('ball + table angle')),
    'ball_form': (Z, said('ball + table angle')),
    'cmm_scale_drift': (SCALES, said('time')),
    'cmm_scale_temperature': (SCALES, said('temperature')),
    'cmm_scale_lag': (SCALES, said('temperature')),
    'cmm_squareness_drift': (SCALES, said('time')),
    'cmm_reversal': (FRAME, said('cmm sense')),
    'cmm_reversal_position': (FRAME, said('cmm sense + CMM position')),
    'probe_approach': (FRAME, said('cmm direction')),
    'outlier': ((), ()),
}
"""Of each effect what moves, and its variables, alternatives; a single wrong reading has none."""
COMPOSED: dict[str, tuple[Names, Variables]] = {
    f'{part}_{course}': (body, said(f'ball + {variable}' if part == 'plate_warp' else variable)) for part, body in (
        ('table_zero', TURN), ('axis_tilt', AXIS), ('plate_tilt', TILT), ('plate_slide', PLATE), ('plate_warp', Z),
        ('plate_growth', GROWTH), ('plate_oval', OVAL), ('cmm_scale', SCALES), ('cmm_squareness', SCALES))
    for courses, variable in (('drift warmup onset cycle step pulse recovery', 'time'),
                              ('temperature lag', 'temperature'), ('asynchronous', 'travel'),
                              ('play', 'table memory'))
    for course in courses.split()}
COMPOSED |= {'frame_periodic': (FRAME, said('time')), 'cmm_deformation_cycle': (FRAME, said('time + CMM position'))}
"""The same of laws that are put together of a motion and a course."""


def statement(name: str) -> tuple[Names, Variables]:
    """Return what moves in an effect and all that is true of its variables.

    A temperature has a course in time; a tilt, turn or growth moves each place otherwise.
    """
    body, own = (COMPOSED | LIBRARY)[name]
    some = (*own, *(one - {'temperature'} | {'time'} for one in own if 'temperature' in one))
    places = [place for one in body if one not in Z for place in BODIES[one]]
    return body, tuple(dict.fromkeys((*some, *(one | {place} for place in places for one in some))))


def alike(name: str) -> Names:
    """Return the other effects that move the same body with the same variable."""
    body, variables = LIBRARY[name]
    return tuple(other for other, (moved, own) in LIBRARY.items()
                 if other != name and {*body} & {*moved} and {*variables} & {*own})
