# SPDX-License-Identifier: Apache-2.0
"""Slow work in a process of its own: it takes nothing from the page, and can be ended at any moment."""

import asyncio
import multiprocessing
import signal

from rosette_ros.core.errors import RosetteError

_CONTEXT = multiprocessing.get_context('forkserver')
_CONTEXT.set_forkserver_preload(['rosette_ros.analysis', 'rosette_ros.report'])


class Stale(Exception):
    """Nobody asks for this any more."""


class EndedEarly(RosetteError):
    """The process of an errand has ended without an answer."""


class Errands:
    """One errand at a time: a new one ends the one before."""

    def __init__(self):
        """Start without any."""
        self._process = None

    async def run(self, function, *arguments):
        """Return function(*arguments), worked out in another process.

        Raises what the function raises, and Stale where the errand was ended from here.
        """
        self.stop()
        receiver, sender = _CONTEXT.Pipe(duplex=False)
        process = _CONTEXT.Process(target=_carry_out, args=(sender, function, arguments), daemon=True)
        self._process = process
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, _start, process)
        sender.close()
        if self._process is not process:
            process.kill()
        try:
            went_well, value = await loop.run_in_executor(None, receiver.recv)
        except EOFError:
            if self._process is not process:
                raise Stale from None
            raise EndedEarly(f'{function.__name__}: its process ended before it was done; '
                             'is there enough memory?') from None
        finally:
            receiver.close()
            await loop.run_in_executor(None, process.join)
            if self._process is process:
                self._process = None
        if not went_well:
            raise value
        return value

    def stop(self):
        """End the errand that is on; whoever waits for it gets Stale."""
        process, self._process = self._process, None
        if process is not None and process.pid is not None:
            process.kill()


def _start(process):
    """Start a process that Ctrl-C does not reach: the page's process ends it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _carry_out(sender, function, arguments):
    """Work in the other process and send (True, value) or (False, error)."""
    try:
        answer = (True, function(*arguments))
    except RosetteError as error:
        answer = (False, error)
    sender.send(answer)
