# SPDX-License-Identifier: Apache-2.0
"""The page docs/effects.md, made from the library: `python -m rosette_ros.cli.effects_page`."""

import sys

from rosette_ros.cli.effects import CARRIES, KINDS, amplitudes
from rosette_ros.core.advice import VARIANTS, planned_run
from rosette_ros.core.effects.basic import BASE_EFFECTS
from rosette_ros.core.effects.expression import FUNCTIONS, NAMES
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.effects.own import DIRECTIONS, PER
from rosette_ros.core.scheme import plan
from rosette_ros.core.visibility import visibility
from rosette_ros.units import scale_of

BALLS, RADIUS = 12, 0.1825
NEWLINE = '\n'

HEAD = """\
# The library of effects

This page is made from the library by `make docs`; a test compares the two.

Names are fixed: they appear in model files, messages and on screen. p is the measured ball centre, t
the time since the first reading, T the temperature, T0 the first one, phi the table angle, beta the
azimuth of the ball on the plate, alpha = phi + beta that of the CMM position, Psi the cumulative
table travel, R the radius; e_r and e_t are unit vectors along the radius and along the turn, H is the
unit step. Amplitudes are fitted together with the base model; what is searched is found by trying and
then refined. All values in files are in SI units.
"""
BASE = """
## The base model

Each part can be left out of a model, and its absence is found like that of any other effect.
"""
VISIBLE = f"""
## What an order of measurement shows

Visible share of each effect for {BALLS} balls in per cent, typical over its settings: what is left of
it when table, plate and CMM have taken up all they can. What is not visible is not lost on the
diagnosis alone: it may stand in the six curves (`rosette diagnose` says how much). *alternate* turns
the table backwards in every second inner loop. `rosette advise` gives the numbers for any number of
balls, and those of a run.
"""
OWN = f"""
## A term of your own

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
"""


def page():
    """Return the page as Markdown text."""
    parts = [HEAD, BASE, *(_section(effect) for effect in BASE_EFFECTS), '\n## Effects\n',
             *(_section(effect) for effect in EFFECTS.values()), OWN, VISIBLE, share_table()]
    return '\n'.join(part.strip('\n') + '\n' for part in parts)


def _section(effect):
    """Return the section of one effect."""
    lines = [f'### {effect.name}', '', effect.meaning, '',
             f'- **Where to look:** {effect.look}',
             f'- **Added to p:** `{effect.formula}`',
             f'- **Needs:** {", ".join(effect.depends_on) or "nothing but the indices"}',
             f'- **In the next run:** {CARRIES[effect.carries]}',
             f'- **Source:** {effect.source}']
    quantities = [(one, 'fitted') for one in amplitudes(effect)]
    quantities += [(one, KINDS[one.kind]) for one in effect.searched]
    if quantities:
        lines += ['', '| parameter | meaning | SI unit | shown in | how |', '|---|---|---|---|---|']
    for one, how in quantities:
        shown = scale_of(one.unit, one.name).unit
        lines.append(f'| `{one.name}` | {one.meaning} | {one.unit} | {shown} | {how} |')
    return '\n'.join(lines) + '\n'


def share_table():
    """Return the table of visible shares in per cent by effect and order."""
    columns = []
    for order, turning in VARIANTS:
        run = planned_run(plan(BALLS, order, 1, turning), RADIUS)
        columns.append({entry.name: entry.typical_share for entry in visibility(run)})
    heads = [order if turning == 'forward' else f'{order}, {turning}'
             for order, turning in VARIANTS]
    lines = [f'| effect | {" | ".join(heads)} |', '|---' * (1 + len(heads)) + '|']
    for name in EFFECTS:
        cells = [f'{100 * column[name]:.0f}' for column in columns]
        lines.append(f'| {name} | {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'


if __name__ == '__main__':
    sys.stdout.reconfigure(encoding='utf-8')
    sys.stdout.write(page())
