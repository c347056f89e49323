# SPDX-License-Identifier: Apache-2.0
"""When what is asked after a run gets a log of its own. No ROS here.

The log of a run is closed at its end. A question to the evaluator that comes later opens a log that
follows it, `<run_id>_analysis`, and this is closed when all is answered and nothing more is asked.
"""

LONGEST_ANSWER = 600.0
"""An answer that has not come after so long will not come, s."""


class FollowUp:
    """Counts questions and answers; times are steady, s.

    quiet: how long nothing may be asked until the log is closed, s; 0: there are no such logs.
    """

    def __init__(self, quiet):
        """Start without questions."""
        self._quiet = quiet
        self._waiting = 0
        self._heard = 0.0
        self.is_open = False

    def asked(self, now):
        """Take note of a question; return whether a log has to be opened, if none is open."""
        self._waiting += 1
        self._heard = now
        return self._quiet > 0

    def answered(self, now):
        """Take note of an answer."""
        self._waiting = max(self._waiting - 1, 0)
        self._heard = now

    def is_over(self, now):
        """Return whether the log that was opened can be closed."""
        rest = now - self._heard
        return self.is_open and (rest >= self._quiet if not self._waiting
                                 else rest >= LONGEST_ANSWER)


def free_name(run_id, is_taken):
    """Return the name of a log that follows a run: `<run_id>_analysis`, `_analysis_2` and so on.

    is_taken: tells whether a name is used already; run_id: '' where no run is known.
    """
    name = f'{run_id}_analysis' if run_id else 'analysis'
    if not is_taken(name):
        return name
    count = 2
    while is_taken(f'{name}_{count}'):
        count += 1
    return f'{name}_{count}'
