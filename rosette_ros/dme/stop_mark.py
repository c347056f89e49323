# SPDX-License-Identifier: Apache-2.0
"""Why a person has to look at a machine, kept beside its settings file: no restart forgets it."""

from pathlib import Path

from rosette_ros.core.run.errors import RosetteError, one_line, plain
from rosette_ros.dme.dme_session import DmeLost, DmeSession, DmeStopped
from rosette_ros.io.text_file import regular, remove_file, replace_file

SUFFIX = '.stopped'


class StopMark:
    """The file SETTINGS.stopped; it is there while the machine moves for a target, and until a person has looked.

    It is on the disk before anything moves, as a whole: the end of the power forgets nothing.

    complaint: why it could not be written, '' where it could."""

    def __init__(self, settings: str | Path) -> None:
        # of the file itself, by whatever name it is given
        self.path, self.complaint = Path(f'{Path(settings).expanduser().resolve()}{SUFFIX}'), ''

    def read(self) -> str:
        """Return what it says, '' where there is none."""
        try:
            with open(self.path, encoding='utf-8', errors='replace', opener=regular) as stream:
                return plain(stream.read(), 500) or 'stopped'
        except FileNotFoundError:
            return ''
        except OSError as error:
            return f'{self.path}: cannot be read: {error.strerror}; a person has to look at the machine'

    def write(self, words: str) -> None:
        """Keep why, '' to remove the file; nothing moves a stopped machine: one that cannot be written is no error."""
        try:
            if words:
                replace_file(self.path, f'{words}\n'.encode())
            else:
                remove_file(self.path)
            self.complaint = ''
        except OSError as error:
            self.complaint = (f'{self.path}: cannot be written: {error.strerror}; a restart of the cell would forget '
                              'that a person has to look at the machine')

    def settle(self, session: DmeSession) -> None:
        """Keep why a session has stopped where a person has to look; else remove the file: nothing moves any more."""
        self.write(session.stop if session.for_person else '')

    def keep_refusal(self, error: RosetteError) -> None:
        """Keep that a server in an error state refused the session; nobody there is no stop, as nothing has moved."""
        if isinstance(error, DmeStopped) and not isinstance(error, DmeLost):
            self.write(one_line(error))

    def clear(self) -> None:
        """Remove it: nothing moves, or a person has looked."""
        self.write('')
