# SPDX-License-Identifier: Apache-2.0
"""rosette effects: the library of physical effects, or one of them explained."""

from argparse import ArgumentParser, Namespace

from rich.markup import escape

from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, pairs, print_json, print_parts, print_table
from rosette_ros.core.effects.effect import Effect, Quantity, Setting
from rosette_ros.core.effects.library import EFFECTS, effect
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.scheme import plan
from rosette_ros.presentation.formatting import MEANINGS, scale_of
from rosette_ros.presentation.json_output import effects_json
from rosette_ros.presentation.table_format import Table, words

CARRIES = {'all': 'settings and sizes hold for the next run of the same cell',
           'shape': 'the settings hold for the next run, phases and sizes do not', 'nothing': 'an event of one run'}
"""What of an effect a later run shares."""
KINDS = {'scale': 'searched and refined', 'phase': 'searched and refined',
         'instant': 'searched: all that a run can tell apart', 'choice': 'one of a few, all are tried'}


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('name', metavar='NAME', nargs='?', help='one effect, explained')
    add_shared(parser, '--json')


def run(options: Namespace) -> None:
    """Print the library or one effect."""
    chosen = tuple(MEANINGS.values()) if options.name is None else (MEANINGS.get(options.name) or effect(options.name),)
    if options.json:
        print_json(effects_json(chosen, {one.name: amplitudes(one) for one in chosen}))
    elif options.name is None:
        out = console()
        print_table(out, Table('library', 'Effects that a model may have and a diagnosis may name', (
            words('name', 'name', [one.name for one in chosen]),
            words('meaning', 'meaning', [one.meaning for one in chosen]))))
        out.print('\nThe first three are the base model. [bold]rosette effects NAME[/] explains one; custom terms: '
                  '[bold]rosette add --help[/].')
    else:
        show_effect(chosen[0])


def amplitudes(one: Effect) -> tuple[Quantity, ...]:
    """Return what is fitted at one setting of an effect; nothing for the parts of the base model."""
    if one.name not in EFFECTS:
        return ()
    example = planned_run(plan(12, 'random', turning='alternate'), 0.1825)
    return tuple(one.amplitudes(example, (*one.settings(example), Setting())[0]))


def facts(one: Effect) -> list[tuple[str, str]]:
    """Return what is known of an effect, as (name, text)."""
    return [('Where to look', one.look), ('Added to p', one.formula),
            ('Needs', ', '.join((*one.depends_on, *['a table axis that is not vertical'] * one.needs_tilt))
             or 'nothing but the indices'),
            ('In the next run', CARRIES[one.carries]), ('Source', one.source)]


def parameters(one: Effect) -> Table:
    """Return the table of the parameters of an effect; without rows where it has none."""
    every = [*((quantity, 'fitted') for quantity in amplitudes(one)),
             *((quantity, KINDS[quantity.kind]) for quantity in one.searched)]
    return Table('parameters', 'Parameters', (
        words('parameter', 'parameter', [quantity.name for quantity, _ in every]),
        words('meaning', 'meaning', [quantity.meaning for quantity, _ in every]),
        words('unit_si', 'SI unit', [quantity.unit for quantity, _ in every]),
        words('unit', 'shown in', [scale_of(quantity.unit, quantity.name).unit for quantity, _ in every]),
        words('how', 'how', [how for _, how in every])))


def show_effect(one: Effect) -> None:
    """Print everything about one effect."""
    out, table = console(), parameters(one)
    out.print(f'[bold]{one.name}[/]: {escape(one.meaning)}')
    print_parts(out, [pairs([(name, escape(text)) for name, text in facts(one)])])
    if table.rows:
        print_parts(out, [table, 'Physical names mean: columns of this form, fitted together with the base '
                          'model. Values in model files and --set are in SI units.'])
