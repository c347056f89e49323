# SPDX-License-Identifier: Apache-2.0
"""Calculates in another process, which is ended as soon as its result is not wanted any more.

The process is forked from one that has loaded what calculations need, and loads nothing of the page itself.
"""

import asyncio
import importlib.util
import multiprocessing
import signal
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from rosette_ros.core.run.errors import RosetteError, one_line
from rosette_ros.core.run.number_words import angle_unit, show_angles
from rosette_ros.core.run.typed_words import typed

T = TypeVar('T')
VALUE, ERROR = 'value', 'error'
"""What the process sends at the end; before that, calls of functions by their names."""
PRELOADED = ('rosette_ros.studio.calculations', 'rosette_ros.studio.worker')
_FORKS = 'forkserver' in multiprocessing.get_all_start_methods()
_CONTEXT: Any = multiprocessing.get_context('forkserver' if _FORKS else 'spawn')
if _FORKS:
    _CONTEXT.set_forkserver_preload(list(PRELOADED))


def prepare() -> None:
    """Start the process that others are forked from, so that the first calculation need not wait for it."""
    if _FORKS:
        _start(forkserver.ensure_running)


def _start(start: Callable[[], object]) -> None:
    """Start a process that Ctrl-C does not reach: the studio ends it."""
    if not hasattr(signal, 'pthread_sigmask'):
        start()
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Superseded(Exception):
    """The result is not wanted any more."""


class WorkerFailed(RosetteError):
    """The process has ended without a result."""


class Worker:
    """Does one piece of work at a time: the next one ends the one before."""

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._thread = ThreadPoolExecutor(1, 'worker')

    async def run(self, function: Callable[..., T], *arguments: object, within: float | None = None,
                  memory: int | None = None, calls: Mapping[str, Callable[..., object]] | None = None,
                  **options: object) -> T:
        """Return function(*arguments, **options), calculated in another process.

        within, memory: most time, s, and most memory, bytes, that it may take; calls: options of the function by name
        that it calls: they are called here. Raises what the function raises, Superseded where `stop` or other work has
        ended it, and WorkerFailed.
        """
        self.stop()
        called = calls or {}
        loop = asyncio.get_running_loop()
        receiver, sender = _CONTEXT.Pipe(duplex=False)
        process = _CONTEXT.Process(target=_work, daemon=True, args=(
            sender, function, arguments, options, tuple(called), memory, angle_unit()))
        self._process = process

        def receive() -> tuple[str, Any]:
            try:
                _start(process.start)
                sender.close()
                if self._process is not process:
                    process.kill()
                while (answer := receiver.recv())[0] not in (VALUE, ERROR):
                    name, values = answer
                    loop.call_soon_threadsafe(called[name], *values)
                return answer
            except (EOFError, OSError):  # it was ended, perhaps as it started, or in the middle of what it said
                return ERROR, Superseded() if self._process is not process else WorkerFailed(
                    f'{function.__name__}: its process ended without a result; is there enough memory?')
            finally:
                receiver.close()
                if process.pid is not None:
                    process.join()

        try:
            async with asyncio.timeout(within):
                kind, value = await loop.run_in_executor(self._thread, receive)
        except TimeoutError:
            if self._process is process:
                self.stop()
            raise WorkerFailed(f'expected a result within {within:g} s, found none') from None
        if self._process is process:
            self._process = None
        if kind == ERROR:
            raise value
        result: T = value
        return result

    def stop(self) -> None:
        """End the work that is running; who waits for it gets Superseded."""
        process, self._process = self._process, None
        if process is not None and process.pid is not None:
            process.kill()


def _work(sender: Connection, function: Callable[..., object], arguments: tuple[object, ...],
          options: Mapping[str, object], calls: Collection[str], memory: int | None, unit: str) -> None:
    """Work in the other process; send what it calls, then the value or the error."""
    show_angles(unit)
    if memory is not None and importlib.util.find_spec('resource'):
        resource = importlib.import_module('resource')
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    try:
        with typed():  # the studio is a command
            value = function(*arguments, **options, **{
                name: lambda *values, name=name: sender.send((name, values)) for name in calls})
        sender.send((VALUE, value))
    except RosetteError as error:
        sender.send((ERROR, error))
    except MemoryError:
        sender.send((ERROR, WorkerFailed(f'expected at most {(memory or 0) >> 20} MB of memory, found more')))
    except Exception as error:
        sender.send((ERROR, WorkerFailed(f'a program error, reported on the console: {one_line(error)}')))
        raise
