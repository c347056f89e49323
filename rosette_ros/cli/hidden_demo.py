# SPDX-License-Identifier: Apache-2.0
"""What the demonstrations share: results compared with the truth; the demo whose machine hides effects, and its
envelope: the readings alone show what is hidden.

What is hidden is sealed before anything is measured; the digest on the screen proves that nothing was changed until the
envelope is opened and compared with the diagnosis.
"""

import math
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from rich.console import Console
from rich.markup import escape

from rosette_ros.analysis import advise_run, analyse, summarise
from rosette_ros.api.evaluating import Diagnosed
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import COLOURS, console, head, pairs, print_table, say
from rosette_ros.cli.evaluate import show_comparison, show_diagnosis
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.records import Floats, Run, remove_gauge
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.invocation import command
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import EXTENDED
from rosette_ros.io.model_file import read_model, write_model
from rosette_ros.presentation.formatting import duration, residual_words, sigmas, sized
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.presentation.tables import nested_models
from rosette_ros.simulation import Machine, MachineConfig, load_machine
from rosette_ros.simulation.envelope import open_envelope, seal_envelope
from rosette_ros.simulation.motion import MachineState
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.effect_words import exact, fixed
from rosette_ros.words.motion_words import titles

ENVELOPE, MODEL = 'envelope.json', 'model.yaml'
INSTANTS = ('at_h', 'from_h')
"""Parameters of hidden effects that are times since the machine was switched on."""
SIZES = {'most': 3, 'smallest_sigma': 2.0}
"""One to three effects of 2 to 30 times the noise: some may still be too small to be named."""
SURE_SIGMA = 12.0
"""Norm of what is not absorbed, in sigma, from which an effect should be named."""
MACHINE = 'machine.yaml'


def seal(out: Console | None, machine: Machine, seed: int, folder: Path) -> None:
    """Seal what a machine hides, as it stands before a run, into a folder; out: None where it was told."""
    digest = seal_envelope(folder / ENVELOPE, machine)
    if out is None:
        return
    out.print(f'It hides effects drawn from seed {seed}. The sealed envelope has the digest\n'
              f'  sha256 {digest}')


def show_hidden(out: Console, config: MachineConfig, seed: int, order: str, log_path: Path, seconds: float,
                is_open: bool = False, until: float | None = None, offline: tuple[str, ...] = ()) -> None:
    """Print how badly the base model fits and how to go on; the envelope stays shut until it is asked for.

    is_open: whether it is asked for already; until: with which probability it had to be settled, None where it had not;
    offline: option of the demo where it measured without nodes.
    """
    run = read_log(log_path).to_run()
    out.print(f'\n{head(run)}\nThe residual of the base model is {residual_words(analyse(run))}\n')
    out.print(pairs([
        ('Log', escape(shown(log_path))), ('Took', f'{seconds:.1f} s'),
        ('Repeat', escape(command('demo', *offline, '--hidden', seed, '--seed', config.seed, '--balls',
                                  config.plate.balls, '--order', order, '--axis',
                                  *(f'{one:g}' for one in config.placement.axis),
                                  *(('--until', until) if until else ()))))]))
    if not is_open:
        out.print('\nBlind test sealed. To find out what is hidden:')
        for verb in ('compare', 'diagnose', 'envelope'):
            out.print(f'  {escape(command(verb, shown(log_path)))}', soft_wrap=True)
        is_open = sys.stdin.isatty() and out.is_terminal
        if is_open:
            out.input('Press Enter to open it now, or Ctrl-C to leave it shut. ')
    if is_open:
        tell(out, log_path)


def show_runs(out: Console, paths: Sequence[Path]) -> None:
    """Print how several runs of a machine that hides effects are diagnosed together."""
    every = [shown(path) for path in paths]
    out.print(f'\n{len(every)} runs of one machine. To find out what comes again in them:')
    out.print(f'  {escape(command("diagnose", *every))}', soft_wrap=True)
    out.print('The envelope of run 1, beside what is found in run 1 alone:\n'
              f'  {escape(command("envelope", every[0]))}', soft_wrap=True)


def show_added(out: Console, log_path: Path, planned: int) -> None:
    """Print what was added to the readings of the plan, and why it ended."""
    log = read_log(log_path)
    run, said = log.to_run(), next(one.text for one in reversed(log.events) if one.kind == EXTENDED)
    added = f'{run.size - planned} were added ({duration(run.time[-1] - run.time[planned - 1])})'
    out.print(f'\nAfter the {planned} readings of the plan, {added if run.size > planned else "none was added"}: '
              f'{escape(said)}', soft_wrap=True)



def tell(out: Console, log_path: Path, model_path: str | None = None, whole: bool = False) -> None:
    """Open the envelope of a run beside what is found; model_path: judge this model instead; whole: print all results.

    Writes the model that is found beside the log."""
    config, log = load_machine(log_path / MACHINE), read_log(log_path)
    run = log.to_run()
    mine = None if model_path is None else analyse(run, read_model(model_path))
    summary = summarise(run, has_ladder=whole)
    out.print(f'\n{head(run)}')
    found = summary.final if mine is None else mine
    named = summary.diagnosis.missing if mine is None else tuple(term.name for term in mine.model.terms)
    show_envelope(out, config, log_path, run, summary.diagnosis, named, model_path)
    show_truth(out, config, log.frame_of(run.run_id), summary.fit, found)
    if whole:
        section(out, '1', 'evaluate: does the base model explain the readings?')
        out.print(residual_words(summary.fit))
        section(out, '2', 'compare: where does it fail?')
        show_comparison(out, summary.comparison, summary.verdict)
        section(out, '3', 'diagnose: what is missing?')
        show_diagnosis(out, summary.diagnosis, Diagnosed(summary.diagnosis).invisible)
        section(out, '4', 'add: does the residual fall?')
        print_table(out, nested_models(summary.ladder))
        section(out, '5', 'advise: what to measure next?')
        out.print(advice_words(summary.advice or advise_run(run)))
    else:
        again = ('--model', model_path) if model_path else ()
        out.print('\nHow it is found, step by step:\n  '
                  f'{escape(command("envelope", shown(log_path), *again, "--all"))}', soft_wrap=True)
    write_model(summary.final.model, log_path / MODEL, force=True)
    out.print(f'\nModel with all that is found: {escape(shown(log_path / MODEL))}', soft_wrap=True)


def section(out: Console, number: str, title: str) -> None:
    """Print the head of a section."""
    out.print()
    out.rule(f'[bold]{number}  {title}[/]', align='left', style='dim')


def show_truth(out: Console, config: MachineConfig, frame: Frame | None, before: Fit, after: Fit) -> None:
    """Print how far the six curves are from those built into the machine, before and after."""
    sizes = []
    for fit in (before, after):
        found = compare(fit, config, frame)
        off = np.sqrt(np.mean((fit.error_motions.values - found.truth)**2, axis=0))
        sizes.append(f'{sized(float(np.sqrt(np.mean(off[:3]**2))), "m", 3)} and '
                     f'{sized(float(np.sqrt(np.mean(off[3:]**2))))} rms '
                     f'({found.rms:.2f} standard uncertainties)')
    out.print(f'\nThe six curves differ from those built into the machine by\n  {sizes[0]} before,\n'
              f'  {sizes[1]} after; expected 1.')


def show_envelope(out: Console, config: MachineConfig, log_path: Path, run: Run, diagnosis: Diagnosis,
                  named: Sequence[str], model: str | None = None) -> None:
    """Open the envelope and print what was hidden beside what is named, by the diagnosis or by the model of a file."""
    envelope = open_envelope(log_path / ENVELOPE)
    begin, strengths = visible_strengths(config, run, envelope.hidden, envelope.state)
    kinds = [hidden['kind'] for hidden in envelope.hidden]
    answers = [answer(kind, strength, diagnosis, named) for kind, strength in zip(kinds, strengths, strict=True)]
    levels, wrong = [level for _, level in answers], wrongly_named(kinds, diagnosis, named)
    who = 'The diagnosis' if model is None else f'The model of {model}'
    parts = [f'{title}: {titles(names)}' for title, names in (
        ('found', [kind for kind, level in zip(kinds, levels) if level == Level.GOOD]),
        ('missed', [kind for kind, level in zip(kinds, levels) if level == Level.BAD]),
        ('not to be seen in this run', [kind for kind, level in zip(kinds, levels) if level == Level.DOUBTFUL]),
        ('superfluous', wrong)) if names]
    say(out, f'{who}: {"; ".join(parts)}.', COLOURS['bad' if Level.BAD in levels or wrong else 'good'])
    out.print()
    print_table(out, Table('hidden', 'Blind test: hidden and found effects', (
        words('kind', 'hidden', kinds),
        words('parameters', 'with', [content(hidden, begin) for hidden in envelope.hidden]),
        column('strength', 'not absorbed', strengths, sigmas),
        words('answer', 'answer', [text for text, _ in answers])), levels=tuple(levels)))
    out.print('not absorbed: size in the readings of what table, plate and CMM cannot cause, in σ '
              f'of a coordinate; from {SURE_SIGMA:g} σ it should be named\n'
              'times count from the first reading of the run\n'
              f'sha256 {envelope.digest}, as it was sealed')


def content(hidden: Mapping[str, Any], begin: float) -> str:
    """Return the parameters of a hidden effect as text; begin: machine time of the first reading of the run, s."""
    parts = [f'{key.removesuffix("_h")} {fixed(60 * value - begin / 60, 1)} min' if key in INSTANTS else
             f'{key} {_value(value)}' for key, value in hidden.items() if key != 'kind']
    return ', '.join(parts)


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f'({", ".join(_value(one) for one in value)})'
    return exact(value, 3) if isinstance(value, float) and math.isfinite(value) else str(value)


def _named_instead(kind: str, diagnosis: Diagnosis, named: Sequence[str]) -> list[str]:
    """Return the effects that are named and of which it is stated that a hidden one looks the same."""
    return [entry.name for entry in diagnosis.candidates if entry.name in named and kind in entry.look_alikes]


def wrongly_named(kinds: Sequence[str], diagnosis: Diagnosis, named: Sequence[str]) -> list[str]:
    """Return the names that neither are hidden nor stand for what is, as the diagnosis states."""
    right = {*kinds, *(name for kind in kinds for name in _named_instead(kind, diagnosis, named))}
    return [name for name in dict.fromkeys(named) if name not in right]


def answer(kind: str, strength: float, diagnosis: Diagnosis, named: Sequence[str]) -> tuple[str, Level]:
    """Return whether a hidden effect is named; one that could not be seen is doubtful."""
    alike = _named_instead(kind, diagnosis, named)
    if kind in named:
        return 'named', Level.GOOD
    if alike:
        return f'named as {alike[0]}, which looks the same here, as stated', Level.GOOD
    if kind in diagnosis.invisible:
        return 'this order cannot show it, as stated', Level.DOUBTFUL
    if strength < SURE_SIGMA:
        return 'too small to be named', Level.DOUBTFUL
    return 'not named' + (', but something is stated to be unexplained' if diagnosis.unexplained else ''), Level.BAD


def visible_strengths(config: MachineConfig, run: Run, hidden: Sequence[Mapping[str, Any]],
                      state: MachineState | None = None) -> tuple[float, Floats]:
    """Return the machine time of the first reading, s, and the norm that each effect adds to the residual of the base
    model, in σ, measured with it and without; state: where the machine stood before the run, None: just switched on.
    """
    scheme = Scheme(run.n, 'as measured', 0, run.table_position, run.ball, np.where(run.approach < 0, -1, 1))
    made = [Machine(config.changed(hidden=each, hidden_draw=None), state).calibrate(scheme)
            for each in ([], *([effect] for effect in hidden))]
    clean, *moved = (one.centre for one, *_ in made)
    left = BaseSpace(run, run.radius).residual(np.array(moved).reshape(len(hidden), run.size, 3) - clean)
    strengths = np.linalg.norm(left.reshape(len(hidden), -1), axis=1) / (1e-6 * config.probing.repeatability_um)
    return float(made[0][2].time[0]), strengths


def envelope_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--angle-unit')
    add_shared(parser, '--model', help='judge your own model: what it has found, missed, and what is superfluous')
    parser.add_argument('--all', action='store_true', help='print how it is found, too, step by step')


def run_envelope(options: Namespace) -> None:
    """Open the envelope; raises InvalidData where the run has none."""
    path = Path(options.run_path)
    if not (path / ENVELOPE).is_file():
        raise InvalidData(f'{path}: expected the log of `rosette demo --hidden`, found none with {ENVELOPE}')
    tell(console(), path, options.model, options.all)


def write_machine(config: MachineConfig, path: Path) -> None:
    """Write a machine configuration as YAML."""
    values = config.model_dump(mode='json', exclude={'hidden_draw'})
    if config.hidden_draw is not None:
        values['hidden'] = config.hidden_draw.model_dump(mode='json', exclude_none=True)
    path.write_text(yaml.safe_dump(values, sort_keys=False), encoding='utf-8')


class TruthComparison(NamedTuple):
    """The truth, (n, 6), m and rad, freed of the gauge; errors of results, (n, 6), in standard uncertainties."""

    truth: Floats
    error: Floats

    @property
    def rms(self) -> float:
        """Root mean square of the normalised errors; 1 is expected."""
        return float(np.sqrt(np.mean(self.error**2)))


def compare(fit: Fit, config: MachineConfig, frame: Frame | None) -> TruthComparison:
    """Return the comparison of a fit with the machine's truth in the frame that was found."""
    motions = fit.error_motions
    truth = remove_gauge(Machine(config).table_truth(motions.angle, frame))
    return TruthComparison(truth, (motions.values - truth) / motions.u)


def shown(path: Path) -> str:
    """Return a path as short as it can be typed from here."""
    path, here = path.absolute(), Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)

IMPLEMENTED = {'envelope': (envelope_arguments, run_envelope)}
