# SPDX-License-Identifier: Apache-2.0
"""rosette effects: the library of physical effects, or one of them explained."""

from rich.markup import escape

from rosette_ros.cli.arguments import add_formats
from rosette_ros.cli.screen import console, pairs, print_json, table
from rosette_ros.core.advice import planned_run
from rosette_ros.core.effects.library import EFFECTS, effect
from rosette_ros.core.scheme import plan
from rosette_ros.diagnosis_json import effects_json
from rosette_ros.units import scale_of
from rosette_ros.words import MEANINGS

CARRIES = {
    'all': 'settings and sizes hold for the next run of the same cell',
    'shape': 'the settings hold for the next run, phases and sizes do not',
    'nothing': 'an event of one run',
}
"""What of an effect a later run shares, in words."""
KINDS = {'scale': 'searched and refined', 'phase': 'searched and refined',
         'instant': 'searched: a moment between two readings', 'choice': 'one of a few, tried all'}


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('name', metavar='NAME', nargs='?', help='one effect, explained')
    add_formats(parser)


def run(options):
    """Print the library or one effect."""
    if options.name is None:
        chosen = tuple(MEANINGS.values())
    else:
        chosen = (MEANINGS.get(options.name) or effect(options.name),)
    if options.json:
        print_json(effects_json(chosen, {one.name: amplitudes(one) for one in chosen}))
    elif options.name is None:
        show_library(chosen)
    else:
        show_effect(chosen[0])


def amplitudes(one):
    """Return the Quantities fitted at one setting of an effect; none for the base model's parts."""
    if one.name not in EFFECTS:
        return ()
    example = planned_run(plan(12, 'random', turning='alternate'), 0.1825)
    return one.amplitudes(example, one.settings(example)[0])


def show_library(chosen):
    """Print the table of names and meanings."""
    made = table(title='Effects that a model may have and a diagnosis may name')
    made.add_column('name', justify='left', no_wrap=True)
    made.add_column('what it means', justify='left', overflow='fold')
    for one in chosen:
        if one.name == next(iter(EFFECTS)):
            made.add_section()
        made.add_row(one.name, escape(one.meaning))
    out = console()
    out.print(made)
    out.print('\nThe first three are the base model. [bold]rosette effects NAME[/] explains one; '
              'terms of your own: [bold]rosette add --help[/].')


def show_effect(one):
    """Print everything about one effect."""
    out = console()
    out.print(f'[bold]{one.name}[/]: {escape(one.meaning)}\n')
    rows = [('Where to look', one.look), ('Added to p', one.formula),
            ('Needs', ', '.join(one.depends_on) or 'nothing but the indices'),
            ('In the next run', CARRIES[one.carries]), ('Source', one.source)]
    out.print(pairs([(name, escape(text)) for name, text in rows]))
    quantities = [(quantity, 'fitted') for quantity in amplitudes(one)]
    quantities += [(quantity, KINDS[quantity.kind]) for quantity in one.searched]
    if not quantities:
        return
    made = table(title='\nParameters')
    for name in ('name', 'meaning', 'SI unit', 'shown in', 'how'):
        made.add_column(name, justify='left', overflow='fold')
    for quantity, how in quantities:
        shown = scale_of(quantity.unit, quantity.name).unit
        made.add_row(quantity.name, escape(quantity.meaning), escape(quantity.unit),
                     escape(shown), how)
    out.print(made)
    out.print('\nPhysical names mean: columns of this form, fitted together with the base model. '
              'Values in model files and --set are in SI units.')
