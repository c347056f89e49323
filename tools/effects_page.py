# SPDX-License-Identifier: Apache-2.0
"""Prints the page docs/effects.md, made from the library of effects: python tools/effects_page.py"""

import sys

from rosette_ros.cli.effects import facts, parameters
from rosette_ros.core.axes import axis_rotation
from rosette_ros.core.effects.custom import AMPLITUDE, DIRECTIONS, FUNCTIONS, NAMES, PER
from rosette_ros.core.effects.effect import Effect
from rosette_ros.core.effects.library import BASE_EFFECTS, EFFECTS
from rosette_ros.core.planning.advice import VARIANTS, planned_run
from rosette_ros.core.planning.visibility import visibility
from rosette_ros.core.scheme import plan

BALLS, RADIUS = 12, 0.1825
NEWLINE = '\n'

HEAD = """\
# The library of effects

This page is made from the library by `make docs`; a test compares the two.

Names are fixed: they appear in model files, messages and on the screen. p is the measured ball centre, t the
time since the first reading, T the temperature, T0 the first temperature, phi the table angle, beta the azimuth
of the ball on the plate, alpha = phi + beta that of the CMM position, Psi the cumulative table travel, R the
radius; e_r and e_t are the radial and the tangential unit vector, H is the unit step. Amplitudes are fitted
together with the base model; searched parameters are found on a grid and then refined. All values in files are
in SI units.
"""
BASE = """
## The base model

Each part can be left out of a model; the diagnosis then finds it as any other missing effect.
"""
VISIBLE = f"""
## What an order of measurement shows

Observable share of each effect for {BALLS} balls in per cent, the median over its settings: the part that the
base model does not absorb. The part that is not observable can bias the six curves (`rosette diagnose` gives the
size). *alternate* turns the table backwards in every second inner loop; ball_sag is that of a table along x.
`rosette advise` prints the shares for any number of balls, or for a run.
"""
CUSTOM = f"""
## Custom terms

In a model file, with an amplitude that is fitted:

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

{AMPLITUDE}
"""


def page() -> str:
    """Return the page as Markdown text."""
    parts = [HEAD, BASE, *map(section, BASE_EFFECTS), '\n## Effects\n', *map(section, EFFECTS.values()), CUSTOM,
             VISIBLE, share_table()]
    return '\n'.join(part.strip('\n') + '\n' for part in parts)


def section(effect: Effect) -> str:
    """Return the section of one effect."""
    lines = [f'### {effect.name}', '', effect.meaning, '']
    lines += [f'- **{name}:** {f"`{text}`" if text == effect.formula else text}' for name, text in facts(effect)]
    table = parameters(effect)
    if table.rows:
        heads = [column.name for column in table.columns]
        lines += ['', f'| {" | ".join(heads)} |', '|---' * len(heads) + '|']
        lines += [f'| `{row[0]}` | {" | ".join(row[1:])} |' for row in table.rows]
    return '\n'.join(lines) + '\n'


def share_table() -> str:
    """Return the table of observable shares in per cent by effect and order."""
    lying = [name for name, effect in EFFECTS.items() if effect.needs_tilt]
    columns = [{entry.name: entry.typical_share for rotation, names in ((None, ()), (axis_rotation([1, 0, 0]), lying))
                for entry in visibility(planned_run(plan(BALLS, order, 1, turning), RADIUS, rotation=rotation),
                                        names=names)} for order, turning in VARIANTS]
    heads = [order if turning == 'forward' else f'{order}, {turning}' for order, turning in VARIANTS]
    lines = [f'| effect | {" | ".join(heads)} |', '|---' * (1 + len(heads)) + '|']
    lines += [f'| {name} | {" | ".join(f"{100 * column[name]:.0f}" for column in columns)} |' for name in EFFECTS]
    return '\n'.join(lines) + '\n'


if __name__ == '__main__':
    sys.stdout.reconfigure(encoding='utf-8')
    sys.stdout.write(page())
