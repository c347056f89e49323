# SPDX-License-Identifier: Apache-2.0
"""Prints the page docs/effects.md, made from the library of effects: python tools/effects_page.py"""

import sys
from collections.abc import Iterable, Mapping, Sequence

from rosette_ros.core.effects.composed import COMPOSED, GOING, MOVING
from rosette_ros.core.effects.custom import AMPLITUDE, DIRECTIONS, FUNCTIONS, NAMES, PER
from rosette_ros.core.effects.effect import Effect
from rosette_ros.core.effects.library import BASE_EFFECTS, EFFECTS
from rosette_ros.core.planning.advice import VARIANTS, planned_run
from rosette_ros.core.run.axes import axis_rotation
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.sight.visibility import visibility

BALLS, RADIUS, SHOWN = 12, 0.1825, 30
IN_BOTH = {order for order, turning in VARIANTS if turning != 'forward'}
NEWLINE = '\n'

HEAD = """\
# The library of effects

Made from the library by `make docs`; a test compares both. `rosette effects NAME` adds parameters with units, what
the run has to record, what a second run shares, and the source. Names are fixed: they appear in model files,
messages and on the screen.

p is the measured ball centre, t the time since the first reading, T the temperature, T0 the first temperature, phi
the table angle, beta the azimuth of the ball on the plate, alpha = phi + beta that of the CMM position, Psi the
cumulative table travel, R the radius; e_r and e_t are the radial and the tangential unit vector, H is the unit
step. Amplitudes are fitted together with the base model; searched parameters are found on a grid and then refined.
Values in files are in SI units.

Effects of the machine (`frame_...`, `cmm_...`) act along its own axes, also where the table axis is not vertical;
those of table, plate and balls in the table frame or in the axes of the plate, which turn with it
([conventions](conventions.md#directions-of-effects)). A temperature recorded in coarse steps is taken as the
smoothest course within its rounding; readings without a temperature are left open. `rosette add` puts an effect
into a model, the [diagnosis](diagnosis.md) finds the one that is missing.
"""
BASE = """
## The base model

Each part can be left out of a model; the diagnosis then finds it as any other missing part.
"""
TABLE = f"""
## Effects

*Shown by*: the [orders](measuring.md#orders-of-measurement) of {BALLS} balls in which the sensitivity to the
effect, the share that table, plate and CMM deviations do not absorb, is at least {SHOWN} % (median over its
settings). What is absorbed may bias the six curves; `rosette diagnose` states by how much. *alternate* turns
the table backwards in every second inner loop; `ball_sag` is that of a table along x. `rosette advise` gives the
shares, smaller ones too, for any number of balls or for a run.
"""
COMPOSED_LAWS = f"""
## Composed laws

The library has laws with an origin in the field. Other motions of a body may follow other courses, too:
{len(COMPOSED)} more laws, put together from the two tables below, are searched and can be added to a model. Their names
are those of the motion and of the course: `axis_tilt_pulse` is a temporary tilt of the table axis,
`cmm_squareness_lag` a squareness that lags the temperature. What the library has keeps its name; only the
table turns by a course of its travel (`asynchronous`), a period of any shape (`periodic`) is looked for in the probe
only, and a deformation of the CMM by cycles only: its other courses are
[motions without a name](diagnosis.md#hypotheses) that depend on time and CMM position.
"""
CUSTOM = f"""
## Custom terms

A shape that is needed once is a custom term of the model file, with an amplitude that is fitted:

```yaml
effects:
  - {{own: wave, direction: z, expression: t*cos(3*alpha), per: all}}
```

or `rosette add wave --model FILE --direction z --expression "t*cos(3*alpha)"`.

- direction: {', '.join(DIRECTIONS)};
- expression: numbers, + - * / and powers of
{NEWLINE.join(f'  - `{name}`: {meaning}{f", {unit}" if unit else ""}'
              for name, (unit, meaning) in NAMES.items())}

  and the functions {', '.join(FUNCTIONS)}; it is read, never executed;
- per: one amplitude for each of {', '.join(PER)}.

{AMPLITUDE} An effect for everyone is an [entry of the library](adding-an-effect.md).
"""


def page() -> str:
    """Return the page as Markdown text."""
    parts = [HEAD, BASE, table(BASE_EFFECTS, None), TABLE, table(EFFECTS.values(), shown_by()),
             COMPOSED_LAWS, parts_of_laws(), CUSTOM]
    return '\n'.join(part.strip('\n') + '\n' for part in parts)


def parts_of_laws() -> str:
    """Return the tables of motions and courses that composed laws have."""
    moving = [f'| `{one.name}` | {one.does} | `{one.formula}` | {one.look} |' for one in MOVING]
    going = [f'| `{how.name}` | {how.how} | `{how.formula}` | {how.look} |' for how in GOING]
    return '\n'.join(['| motion | what moves | added to p, f the course | possible origin |', '|---|---|---|---|',
                      *moving, '', '| course | how | f | possible origin |', '|---|---|---|---|', *going, ''])


def table(effects: Iterable[Effect], shown: Mapping[str, str] | None) -> str:
    """Return a row for each effect; shown: the orders that show it, by name."""
    heads = ['effect', 'what it is', 'added to p', 'possible origin', *(['shown by'] if shown else [])]
    lines = [f'| {" | ".join(heads)} |', '|---' * len(heads) + '|']
    lines += [f'| {" | ".join([f"`{one.name}`", one.meaning, f"`{one.formula}`", one.look])} |'
              + (f' {shown[one.name]} |' if shown else '') for one in effects]
    return '\n'.join(lines) + '\n'


def shown_by() -> dict[str, str]:
    """Return the orders that show each effect; `all`, `all but` some, or their names."""
    lying = [name for name, effect in EFFECTS.items() if effect.needs_tilt]
    shares = {f'{order}, {turning}' if turning != 'forward' else order: {
        entry.name: 100 * entry.typical_share for rotation, names in ((None, ()), (axis_rotation([1, 0, 0]), lying))
        for entry in visibility(planned_run(plan(BALLS, order, 1, turning), RADIUS, rotation=rotation), names=names)}
        for order, turning in VARIANTS}
    return {name: in_words({order: share[name] >= SHOWN for order, share in shares.items()}) for name in EFFECTS}


def in_words(shows: Mapping[str, bool]) -> str:
    """Return which orders show something; an order in both senses stands once."""
    yes, no = ([order for order, shown in shows.items() if shown is wanted] for wanted in (True, False))
    if not yes or not no:
        return 'all' if yes else 'none'
    return f'all but {joined(no)}' if len(no) < len(yes) else joined(yes)


def joined(orders: Sequence[str]) -> str:
    """Return the names of orders; one that is named in both senses of turning stands once, without them."""
    both = {one for one in orders if f'{one}, alternate' in orders}
    words = []
    for one in orders:
        order, _, turning = one.partition(', ')
        if order not in both:
            words.append(f'`{order}` {turning or "forward"}' if order in IN_BOTH else f'`{order}`')
        elif not turning:
            words.append(f'`{order}`')
    return ', '.join(words)


if __name__ == '__main__':
    sys.stdout.reconfigure(encoding='utf-8')
    sys.stdout.write(page())
