# SPDX-License-Identifier: Apache-2.0
"""The errors that I++ DME predefines and this server answers: number, severity, words.

Source: I++ DME 1.4.3, section 8.2.
"""

from rosette_ros.dme.wire import DmeError

PREDEFINED = {
    1: (2, 'Illegal tag'), 2: (2, 'No space at pos. 6'), 6: (2, 'Transaction aborted (Use ClearAllErrors To Continue)'),
    7: (3, 'Illegal character'), 8: (3, 'Protocol error'), 500: (3, 'Emergency stop'), 501: (3, 'Unsupported command'),
    502: (3, 'Incorrect arguments'), 504: (1, 'Argument out of range'), 505: (3, 'Argument not recognized'),
    506: (3, 'Argument not supported'), 509: (3, 'Bad argument'), 510: (3, 'Bad property'),
    511: (3, 'Error processing method'), 512: (1, 'No daemons are active'), 513: (2, 'Daemon does not exist'),
    514: (2, 'Use ClearAllErrors to continue'),
    515: (2, 'Daemon already exists'), 1005: (3, 'Error during home'), 1006: (2, 'Surface not found'),
    1008: (3, 'Target position out of machine volume'), 1009: (3, 'Air pressure out of range'),
    1010: (2, 'Vector has no norm'), 1502: (3, 'Tool not found'), 1503: (3, 'Tool not defined'),
    2000: (3, 'Tool not calibrated'), 2500: (3, 'Machine limit encountered [Move Out Of Limits]'),
    2504: (3, 'Collision'), 2505: (2, 'Specified angle out of range')}
"""Number: (default severity, words)."""


class Refused(Exception):  # noqa: N818
    """A command that a server refuses or cannot finish, with the error that it answers."""

    def __init__(self, number: int, method: str) -> None:
        severity, words = PREDEFINED[number]
        self.error = DmeError(severity, number, method, words)
        super().__init__(str(self.error))
