# SPDX-License-Identifier: Apache-2.0
"""The card of a verdict in the terminal, from facts alone."""

import io

from rosette_ros.cli.console import console
from rosette_ros.cli.evaluate import print_card
from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.verdict import Outcome, Residual, Verdict
from rosette_ros.core.effects.effect import Setting

RESIDUAL = Residual(1.02e-7, 9.1e-8, 0.2, 1.0)


def card(verdict, *model):
    """Return the lines of a card."""
    out = io.StringIO()
    print_card(console(out), verdict, 'my run.csv', *model)
    return out.getvalue().splitlines()


def test_a_model_that_fits_is_a_sentence():
    """Nothing is to be done, and no headline says it twice."""
    assert ' '.join(card(Verdict(Outcome.FITS, RESIDUAL, RESIDUAL))).startswith('The model fits: the residual of ')


def test_what_has_no_name_can_be_kept_as_a_term():
    """By the command as it is printed."""
    setting = Setting(of='time since move', kind='slow', along='frame along y')
    cause = Cause((), ('frame',), (('time since move',),), 0.97, laws=(((), 0.97),))
    one = MissingEffect('free', setting, cause=cause, together=0.97)
    lines = card(Verdict(Outcome.UNNAMED, RESIDUAL, RESIDUAL, unnamed=(one,)), 'mine.yaml')
    assert lines[0] == 'SYSTEMATIC EFFECT FOUND, CAUSE NOT IDENTIFIED'
    assert lines[-1].endswith("rosette add free --set 'of=time since move' --set kind=slow --set 'along=frame along y' "
                              "--model mine.yaml --run 'my run.csv'")
    lines = card(Verdict(Outcome.UNNAMED, RESIDUAL, RESIDUAL, unnamed=(one,), is_open=True), 'mine.yaml')
    assert lines[-1].endswith("rosette advise 'my run.csv' --readings 12 --model mine.yaml")
