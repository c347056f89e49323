# SPDX-License-Identifier: Apache-2.0
"""The options by which an archive is asked for runs."""

from argparse import Namespace, _ActionsContainer

from rosette_ros.archive.run_question import SERIAL, Question


def add_question(parser: _ActionsContainer) -> None:
    """Add what a question to an archive may ask for."""
    for word, name in SERIAL.items():
        parser.add_argument(f'--{word}', metavar='SERIAL' if name.endswith('serial') else 'NAME', default='',
                            help=f'runs of this {word}{" (good, doubtful, bad)" if word == "level" else ""}')
    parser.add_argument('--since', metavar='TIME', default='', help='measured then or later, such as 2026-04-12')
    parser.add_argument('--until', metavar='TIME', default='', help='measured before this time')
    parser.add_argument('--effect', metavar='NAME', default='', help='with this effect in the model or named by the '
                        'diagnosis')


def question_of(options: Namespace) -> Question:
    """Return what the options of `add_question` ask for."""
    equal = {word: vars(options)[word] for word in SERIAL if vars(options)[word]}
    return Question(equal, options.since, options.until, options.effect)
