# SPDX-License-Identifier: Apache-2.0
"""rosette diagnose: which physical effect the model lacks, how sure, and what cannot be seen."""

from rich.markup import escape

from rosette_ros.analysis import cross_check, diagnose
from rosette_ros.cli.arguments import add_formats, add_run
from rosette_ros.cli.compare import add_model, model_of
from rosette_ros.cli.human import parameter_table, sentence
from rosette_ros.cli.screen import console, pairs, print_json, table
from rosette_ros.cli.summary import head
from rosette_ros.core.advice import best_of, compared_orders
from rosette_ros.core.crosscheck import CONFIRMED
from rosette_ros.core.records import CURVES
from rosette_ros.core.visibility import visibility
from rosette_ros.data.open_run import open_run
from rosette_ros.diagnosis_json import diagnosis_json
from rosette_ros.words import MEANINGS, chance, fall, fixed, micro, names, percent

NEXT_BEST = 4
"""So many effects that are not claimed are shown."""
HARMLESS = 0.05
"""Bias of the curves per µm rms (µm, µrad) below which plate and CMM take an effect up whole."""
MOST_BALLS_ADVISED = 24
"""On larger runs the comparison of orders is left to `rosette advise`: it takes its time."""


def add_arguments(parser):
    """Declare what the verb takes."""
    add_run(parser)
    add_model(parser)
    parser.add_argument('--check', metavar='RUN_B', help='another run of the same cell: is what '
                        'this run teaches true there, where it had no part in finding it?')
    add_formats(parser)


def run(options):
    """Print the diagnosis."""
    measured, model = open_run(options.run_path), model_of(options)
    other = open_run(options.check) if options.check else None
    diagnosis = diagnose(measured, model)
    check = cross_check(other, diagnosis) if other is not None else None
    hidden = hidden_effects(measured, diagnosis)
    if options.json:
        print_json(diagnosis_json(measured, diagnosis, hidden, check))
        return
    out = console()
    out.print(head(measured))
    show(out, measured, diagnosis, hidden)
    if check is not None:
        show_check(out, check)


def hidden_effects(measured, diagnosis):
    """Return the Visibility of every effect that the order hides."""
    if not diagnosis.invisible:
        return ()
    return visibility(measured, diagnosis.final.sigma, diagnosis.final.model.base,
                      names=diagnosis.invisible)


def show(out, measured, diagnosis, hidden):
    """Print a Diagnosis for a person; hidden: Visibility of the invisible effects."""
    out.print(f'[bold]{sentence(diagnosis.verdict)}[/]\n')
    claimed = [entry for entry in diagnosis.candidates if entry.claimed]
    parts = [candidate_table(claimed, 'What is missing, strongest first, each beside those above'),
             meaning_table(claimed), claimed_parameters(claimed),
             candidate_table([entry for entry in diagnosis.candidates if not entry.claimed]
                             [:NEXT_BEST], 'Not claimed: the next best, and what they would bring'),
             bias_table(hidden), notes(measured, diagnosis)]
    for part in parts:
        if part is not None:
            out.print(part)
            out.print()


def candidate_table(candidates, title):
    """Return the table of candidates; None of none."""
    if not candidates:
        return None
    made = table(title=title)
    for name, side in (('effect', 'left'), ('chance\nof noise', 'right'), ('visible', 'right'),
                       ('residual\nµm', 'right'), ('readings left\nout, µm', 'right'),
                       ('ΔBIC', 'right'), ('looks like', 'left')):
        made.add_column(name, justify=side, no_wrap=name != 'looks like', overflow='fold')
    for one in candidates:
        made.add_row(escape(one.effect), chance(one.p), percent(one.visible_fraction),
                     fall(one.rms_before, one.rms_after),
                     fall(one.held_out_before, one.held_out_after), fixed(one.delta_bic, 0),
                     escape(', '.join(one.look_alikes)))
    return made


def meaning_table(candidates):
    """Return what the claimed effects mean and where to look in the cell; None of none."""
    rows = [(escape(name), escape(f'{MEANINGS[name].meaning} Look at: {MEANINGS[name].look}'))
            for name in dict.fromkeys(entry.effect for entry in candidates) if name in MEANINGS]
    return pairs(rows) if rows else None


def claimed_parameters(candidates):
    """Return the table of the parameters of what is claimed; None of none."""
    entries = [(one.effect, one.setting, one.parameters) for one in candidates if one.parameters]
    return parameter_table(entries, 'How large it is') if entries else None


def bias_table(hidden):
    """Return the table of what invisible effects would put on the curves; None of none."""
    if not hidden:
        return None
    units = ['µm' if curve.startswith('ct') else 'µrad' for curve in CURVES]
    made = table('hidden by this order', *(f'{curve}\n{unit}' for curve, unit in
                                           zip(CURVES, units, strict=True)), '',
                 title='What 1 µm rms of it would put on the curves, unseen')
    for entry in hidden:
        harm = '' if entry.bias.max() > HARMLESS else 'harmless'
        made.add_row(escape(entry.name), *(fixed(float(value), 2) for value in entry.bias), harm)
    return made


def notes(measured, diagnosis):
    """Return what remains to be said: left over, not judged, what to measure next."""
    rows = []
    if diagnosis.unexplained:
        rows.append(('Left over', sentence(diagnosis.unexplained_text)))
    if diagnosis.unavailable:
        rows.append(('Not judged', escape('; '.join(f'{name}: {reason}' for name, reason
                                                    in diagnosis.unavailable))))
    rows.append(('Next', escape(advice_line(measured, diagnosis))))
    return pairs(rows)


def advice_line(measured, diagnosis):
    """Return one line on what to do next."""
    steps = []
    for name in dict.fromkeys(diagnosis.missing):
        steps.append(f'rosette add {name} --model FILE')
    add = f'{"; ".join(steps)}. ' if steps else ''
    hidden = diagnosis.invisible
    if not hidden:
        return f'{add}This order shows every effect that can be judged.'
    if measured.n > MOST_BALLS_ADVISED:
        return f'{add}rosette advise RUN names an order that shows {names(hidden)}.'
    best = best_of(compared_orders(measured.n, measured.radius, diagnosis.final.sigma, hidden))
    shares = ', '.join(f'{name} to {percent(best.share(name))}' for name in hidden)
    return f'{add}Order {best.label} would show {shares} (rosette advise).'


def show_check(out, check):
    """Print the CrossCheck on another run."""
    colour = {True: 'green', False: 'red', None: 'yellow'}[check.confirmed]
    out.print(f'[bold]Checked on {escape(check.before.run.run_id or check.before.run.source)}[/], '
              'which had no part in the search')
    out.print(f'[{colour}]{sentence(check.text)}[/]')
    made = table(title='')
    for name, side in (('effect', 'left'), ('outcome', 'left'), ('visible', 'right'),
                       ('chance\nof noise', 'right'), ('residual\nµm', 'right'),
                       ('readings left\nout, µm', 'right'), ('same size', 'left')):
        made.add_column(name, justify=side, no_wrap=True)
    for one in check.effects:
        size = {True: 'yes', False: 'no', None: ''}[one.same_size]
        made.add_row(escape(one.name), one.outcome, percent(one.visible_fraction)
                     if one.visible_fraction == one.visible_fraction else '–', chance(one.p),
                     fall(one.rms_without, one.rms_with),
                     fall(one.held_out_without, one.held_out_with), size,
                     style=None if one.outcome == CONFIRMED else 'yellow')
    if check.effects:
        made.caption = (f'all together: left out {fall(check.held_out_before, check.held_out_after)}'
                        f' µm; with the sizes learnt, nothing fitted: '
                        f'{micro(check.held_out_carried)} µm')
        made.caption_justify = 'left'
        out.print(made)
