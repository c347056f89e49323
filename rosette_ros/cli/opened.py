# SPDX-License-Identifier: Apache-2.0
"""A run as a verb opens it, and what follows from it."""

from argparse import Namespace
from functools import cached_property

from rich.console import Console

from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, find
from rosette_ros.cli.console import head, print_verdict, warn
from rosette_ros.core.diagnosis.diagnosis import Finding
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import open_identified
from rosette_ros.words.verdict_words import verdict_text


class Opened:
    """RUN with --run-id and --identity, --model, and what follows from them; a verb without such an option gives none.

    path: of another run than RUN, or of the first where there are several."""

    def __init__(self, options: Namespace, path: str | None = None) -> None:
        given = vars(options)
        self.path: str = given['run_path'] if path is None else path
        self.run, self.identity, _ = open_identified(self.path, given.get('run_id'), given.get('identity'))
        self._model_file: str | None = given.get('model')

    @cached_property
    def model(self) -> Model:
        """That of the file, the base model without one."""
        return read_model(self._model_file)

    @cached_property
    def fit(self) -> Fit:
        """The least squares."""
        return analyse(self.run, self.model)

    @cached_property
    def finding(self) -> Finding | None:
        """What is missing, None where the plate has too many balls to judge it unasked."""
        return find(self.fit.run, self.fit.model) if self.run.n <= MOST_BALLS_JUDGED else None

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None as for `finding`."""
        return self.finding.verdict if self.finding else None

    def begin(self, out: Console) -> None:
        """Print what was measured, and the verdict or, where there is none, what is wrong with the readings."""
        out.print(head(self.run))
        if self.verdict:
            print_verdict(out, verdict_text(self.verdict))
        else:
            warn(self.run)
