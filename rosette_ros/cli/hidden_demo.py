# SPDX-License-Identifier: Apache-2.0
"""rosette demo --hidden: a machine hides something and the readings alone tell what.

What is hidden is sealed before anything is measured; the digest on the screen proves that nothing
was changed until the envelope is opened beside the answer.
"""

import math
import random
from dataclasses import dataclass

import numpy as np
from rich.markup import escape

from rosette_ros.analysis import (
    advise_run,
    analyse,
    claimed_model,
    diagnose,
    ladder,
)
from rosette_ros.analysis import compare as compare_model
from rosette_ros.cli import compare as compare_verb
from rosette_ros.cli import diagnose as diagnose_verb
from rosette_ros.cli.human import sentence
from rosette_ros.cli.screen import pairs, table
from rosette_ros.cli.summary import head, residual_words
from rosette_ros.cli.truth import compare as compare_truth
from rosette_ros.cli.truth import shown
from rosette_ros.core.base import base_space
from rosette_ros.core.scheme import ORDERS, Scheme
from rosette_ros.data.log_reader import read_log
from rosette_ros.data.model_file import write_model
from rosette_ros.machine import Machine
from rosette_ros.machine.envelope import open_envelope, seal_envelope
from rosette_ros.words import exact

ENVELOPE, MODEL = 'envelope.json', 'model.yaml'
HIDDEN_SIZES = {'most': 3, 'smallest_sigma': 2.0}
"""One to three effects of 2 to 30 times the noise: some may still be too small to be named."""
SURE_SIGMA = 12.0
"""Norm of the visible part, in sigma, from which an effect should be named."""


@dataclass(frozen=True)
class HiddenStory:
    """What is told of a machine that hides effects drawn from a seed."""

    seed: int
    order: str
    turning: str

    @property
    def groups(self):
        """What the machine's configuration says of it."""
        return {'hidden': {'seed': self.seed, **HIDDEN_SIZES}}

    def prepare(self, out, config, folder):
        """Seal the envelope before anything is measured."""
        digest = seal_envelope(folder / ENVELOPE, Machine(config))
        out.print(f'It hides something, drawn from seed {self.seed}. The sealed envelope has the '
                  f'digest\n  sha256 {digest}')

    def papers(self, folder):
        """Return the files that go into the log's folder besides the machine."""
        return (folder / ENVELOPE,)

    def tell(self, out, config, log_path, seconds):
        """Print the whole story, all of it from the log alone until the envelope is opened."""
        log = read_log(log_path)
        run = log.to_run()
        report = analyse(run)
        out.print(f'\n{head(run)}')
        chapter(out, '1', 'evaluate: does the base model explain the readings?')
        out.print(residual_words(report.fit))
        chapter(out, '2', 'compare: where does it fail?')
        compare_verb.show(out, compare_model(run))
        chapter(out, '3', 'diagnose: what is missing?')
        diagnosis = diagnose(run)
        diagnose_verb.show(out, run, diagnosis, diagnose_verb.hidden_effects(run, diagnosis))
        chapter(out, '4', 'add: does the error fall?')
        model = claimed_model(diagnosis)
        rungs = ladder(run, model)
        out.print(compare_verb.ladder_table(rungs))
        write_model(model, log_path / MODEL, force=True)
        frame = log.frame_of(run.run_id)
        tell_truth(out, config, frame, report, rungs[-1].report)
        chapter(out, '5', 'advise: what to measure next?')
        out.print(sentence(advise_run(run).text))
        chapter(out, '6', 'the envelope')
        open_beside(out, config, log_path, run, diagnosis)
        self.where(out, config, log_path, seconds)

    def where(self, out, config, log_path, seconds):
        """Print where everything is."""
        out.print()
        out.print(pairs([
            ('Log', escape(shown(log_path))), ('Model', escape(shown(log_path / MODEL))),
            ('Again', f'rosette demo --hidden {self.seed} --seed {config.seed} --balls '
                      f'{config.plate.balls}'),
            ('Took', f'{seconds:.1f} s')]))


def story_of(seed):
    """Return the HiddenStory of a seed; a negative one stands for a seed that is drawn now."""
    seed = random.SystemRandom().randrange(10**6) if seed < 0 else seed
    if 'sensitive' in ORDERS:
        return HiddenStory(seed, 'sensitive', 'forward')
    return HiddenStory(seed, 'random', 'alternate')


def chapter(out, number, title):
    """Print the head of a chapter."""
    out.print()
    out.rule(f'[bold]{number}  {title}[/]', align='left', style='dim')


def tell_truth(out, config, frame, before, after):
    """Print how far the six curves are from those built into the machine, before and after."""
    words = []
    for report in (before, after):
        found = compare_truth(report, config, frame)
        off = 1e6 * np.sqrt(np.mean((report.error_motions.values - found.truth)**2, axis=0))
        words.append(f'{np.sqrt(np.mean(off[:3]**2)):.3f} µm and '
                     f'{np.sqrt(np.mean(off[3:]**2)):.2f} µrad rms ({found.rms:.2f} standard '
                     'uncertainties)')
    out.print(f'\nThe six curves are off those built into the machine by\n  {words[0]} before,\n'
              f'  {words[1]} after; 1 standard uncertainty is expected.')


def open_beside(out, config, log_path, run, diagnosis):
    """Open the envelope and print what was hidden beside what was found."""
    envelope = open_envelope(log_path / ENVELOPE)
    strengths = visible_strengths(config, run, envelope.hidden)
    out.print(f'sha256 {envelope.digest}, as it was sealed\n')
    made = table(title='What was hidden, and what was found')
    for name, side in (('hidden', 'left'), ('with', 'left'), ('visible', 'right'),
                       ('answer', 'left')):
        made.add_column(name, justify=side, overflow='fold', no_wrap=name == 'visible')
    for hidden, strength in zip(envelope.hidden, strengths, strict=True):
        made.add_row(hidden['kind'], escape(content(hidden)), f'{strength:.0f} σ',
                     answer(hidden['kind'], strength, diagnosis))
    out.print(made)
    kinds = {hidden['kind'] for hidden in envelope.hidden}
    wrong = [name for name in diagnosis.missing if name not in kinds]
    if wrong:
        out.print(f'[yellow]Named but not hidden: {escape(", ".join(wrong))}[/]')
    out.print('visible: norm of what the effect does to the readings beyond all that table, plate '
              f'and CMM could do, in σ of a coordinate; from {SURE_SIGMA:g} σ a name is expected')


def content(hidden):
    """Return the parameters of a hidden effect as text."""
    return ', '.join(f'{key} {_value(value)}' for key, value in hidden.items() if key != 'kind')


def _value(value):
    if isinstance(value, (list, tuple)):
        return f'({", ".join(_value(one) for one in value)})'
    return exact(value, 3) if isinstance(value, float) and math.isfinite(value) else str(value)


def answer(kind, strength, diagnosis):
    """Return what the diagnosis said of a hidden effect."""
    alike = [entry.effect for entry in diagnosis.candidates
             if entry.claimed and kind in entry.look_alikes]
    if kind in diagnosis.missing:
        return '[green]named[/]'
    if alike:
        return f'[green]named as {alike[0]}, said to look the same here[/]'
    if kind in diagnosis.invisible:
        return '[yellow]this order hides it, as was said[/]'
    if strength < SURE_SIGMA:
        return '[yellow]too small to be named[/]'
    return '[red]not named[/]' + (', but said to be left unexplained' if diagnosis.unexplained
                                  else '')


def visible_strengths(config, run, hidden):
    """Return the norm of what each hidden effect adds to the residual of the base model, in sigma.

    The machine measures twice, with one effect and without any; the noise is the same in both.
    """
    scheme = Scheme(run.n, 'as measured', 0, run.table_position, run.ball,
                    np.where(run.approach < 0, -1, 1))
    clean = _centres(config, scheme, ())
    space = base_space(run, run.radius)
    sigma = 1e-6 * config.probing.repeatability_um
    moved = np.array([_centres(config, scheme, (effect,)) - clean for effect in hidden])
    left = space.residual(moved.reshape(len(hidden), run.size, 3))
    return np.linalg.norm(left.reshape(len(hidden), -1), axis=1) / sigma


def _centres(config, scheme, hidden):
    quiet = config.changed(hidden=list(hidden), hidden_draw=None)
    return Machine(quiet).run(scheme).centre
