# SPDX-License-Identifier: Apache-2.0
"""A program on a terminal of its own, and somebody who types."""

import os
import pty
import re
import select
import subprocess
import sys
import time

LEADS = ('import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execvp(sys.argv[1], sys.argv[1:])')
"""Makes the terminal that of the process, so that Ctrl-C interrupts it."""


class Terminal:
    """A context manager; words: the program and its arguments; screen: what it has printed, without colours."""

    def __init__(self, *words, **environment):
        self._words = [sys.executable, '-c', LEADS, *map(str, words)]
        self._environment = {**os.environ, 'TERM': 'xterm', **environment}
        self.screen = ''

    def __enter__(self):
        self._own, end = pty.openpty()
        self.process = subprocess.Popen(
            self._words, stdin=end, stdout=end, stderr=end, env=self._environment, start_new_session=True)
        os.close(end)
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self._own)

    def type(self, keys):
        """Press keys."""
        os.write(self._own, keys.encode())

    def wait_for(self, words, timeout=300.0):
        """Read until words stand on the screen; return what stands after the last call."""
        begin, deadline = len(self.screen), time.monotonic() + timeout
        while words not in self.screen[begin:]:
            assert time.monotonic() < deadline, f'expected {words!r} on the screen, found {self.screen[-2000:]}'
            assert self._read(), f'expected {words!r} before the end, found {self.screen[-2000:]}'
        return self.screen[begin:]

    def end(self, keys='', timeout=300.0):
        """Read until the program has ended; return its exit code.

        keys: pressed until it has, as a person does: a signal that comes between two instructions of Python's input()
        is seen after the next key only."""
        deadline = time.monotonic() + timeout
        while (now := time.monotonic()) < deadline:
            if keys:
                self.type(keys)
            while time.monotonic() < now + 5.0:
                if not self._read():
                    return self.process.wait(timeout)
        raise AssertionError(f'expected the end within {timeout} s, found {self.screen[-2000:]}')

    def _read(self):
        """Return whether the program still has the terminal."""
        if select.select([self._own], [], [], 0.2)[0]:
            try:
                data = os.read(self._own, 65536)
            except OSError:  # all who had it have closed it
                return False
            self.screen += re.sub(r'\x1b\[[0-9;?]*[A-Za-z]', '', data.decode(errors='replace')).replace('\r\n', '\n')
        return True
