# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes that are forked from one that has loaded their modules: a cell starts in a third of the time."""

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from multiprocessing import forkserver

from rosette_ros.cell.supervisor import MODULES
from rosette_ros.nodes.names import PARENT_PID
from rosette_ros.studio import worker

_CONTEXT = multiprocessing.get_context('forkserver')
PRELOADED = [*MODULES.values(), *worker.PRELOADED]
"""What cells and the processes of the studio load."""


def preload():
    """Let the process that forks load these modules; it starts with the first that is forked."""
    forkserver.set_forkserver_preload(PRELOADED)


OUTPUTS: dict[str, None] = {}
"""The files to which nodes have written, in the order of their start."""


class ForkedNode:
    """What a Cell uses of subprocess.Popen, for `python -m MODULE ARGUMENTS`."""

    def __init__(self, command, stdin, stdout, stderr, start_new_session, env):
        assert command[:2] == [sys.executable, '-m'] and start_new_session
        OUTPUTS[stdout.name] = None
        self._process = _CONTEXT.Process(target=_run, args=(command[2:], env, os.getcwd(), stdout.name))
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self):
        """Return the exit code, None while it runs."""
        return self._process.exitcode

    poll = returncode.fget

    def wait(self, timeout=None):
        """Wait for the end and return the exit code."""
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired('node', timeout)
        return self.returncode

    def send_signal(self, number):
        """Send a signal, unless it has ended."""
        if self.returncode is None:
            os.kill(self.pid, number)

    def terminate(self):
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self):
        """End it."""
        self.send_signal(signal.SIGKILL)


def _run(command, environment, folder, output):
    """Be the node: in a session of its own, with an environment, a folder and an output like those of a new process."""
    os.close(forkserver._forkserver._forkserver_alive_fd)  # else it outlives tests that are killed, and the nodes do
    os.setsid()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment, **{PARENT_PID: str(os.getppid())})
    target = os.open(output, os.O_WRONLY | os.O_APPEND)
    os.dup2(target, 1)
    os.dup2(target, 2)
    os.close(target)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True)
    sys.argv = list(command)
    sys.exit(importlib.import_module(command[0]).main())
