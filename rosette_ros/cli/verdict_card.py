# SPDX-License-Identifier: Apache-2.0
"""The card of a verdict in the terminal: headline, sentence, causes, what the run cannot tell, what to do, commands."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from rosette_ros import command
from rosette_ros.cli.console import COLOURS, print_parts, say
from rosette_ros.core.diagnosis.verdict import Outcome, Verdict
from rosette_ros.core.effects.free import FREE
from rosette_ros.presentation.explanation_results import causes
from rosette_ros.words.verdict_words import HEADLINES, NOTHING_TO_DO, verdict_text

NEW_MODEL = 'model.yaml'
"""Model file of a command where the run was judged without one."""


def print_card(out: Console, verdict: Verdict, run_path: Path | str, model: Path | str | None = None) -> None:
    """Print the card of a verdict on a run; model: the file of the model that was judged, None for the base model."""
    text = verdict_text(verdict)
    has_headline = verdict.outcome != Outcome.FITS  # whose sentence says it
    if has_headline:
        out.print(f'[bold {COLOURS[verdict.level]}]{HEADLINES[verdict.outcome]}[/]')
    say(out, text.sentence, None if has_headline else COLOURS[verdict.level])
    if verdict.missing:
        print_parts(out, [causes(verdict)])
        out.print()
    for sentence in (*text.limits, *([text.action] if text.action != NOTHING_TO_DO else [])):
        say(out, sentence)
    for words in _commands(verdict):
        line = command('add', *words, '--model', model or NEW_MODEL, '--run', run_path)
        out.print(f'  {escape(line)}', soft_wrap=True)


def _commands(verdict: Verdict) -> Iterator[list[str]]:
    """Yield what to add: all causes together, then each motion without a name."""
    if verdict.missing:
        yield [one.name for one in verdict.missing]
    for one in verdict.unnamed:
        yield [FREE.name, *_settings(one.setting)]


def _settings(setting: Mapping[str, float | str]) -> list[str]:
    return [word for name, value in setting.items() for word in ('--set', f'{name}={value}')]
