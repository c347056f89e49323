# SPDX-License-Identifier: Apache-2.0
"""How many logs are evaluated: one after the other in this process, or by the workers of a Dask cluster."""

import logging
import re
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import dask
from dask.system import CPU_COUNT
from distributed import Client, Future, KilledWorker, LocalCluster, as_completed

from rosette_ros.core.run.errors import InvalidConfig

Item = TypeVar('Item')
Result = TypeVar('Result')
AHEAD = 3
"""Tasks that are sent per thread of the workers: a worker never waits, and memory does not grow with the tasks."""
FRESH = 2.0
"""How long the number of threads is taken as known, s: workers come and go."""
ADDRESS = re.compile(r'\w+://.+|[^/]+:\d+')
"""Of a scheduler; Dask takes ten seconds and a traceback to refuse others."""
PATIENCE = 10
"""How long a scheduler is waited for, s."""

SETTINGS = {'worker.profile.enabled': False, 'admin.tick.interval': '1s', 'admin.system-monitor.interval': '10s',
            'worker.memory.monitor-interval': '2s', 'scheduler.work-stealing-interval': '1s',
            'nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_': None}
"""Settings of Dask on this computer. How often it looks at itself: its usual intervals, of 10 to 500 ms, take a fifth
of the processor time of an evaluation for the profile and a twelfth for the others. With the threshold that it gives to
the allocator of its workers, arrays of more than 128 kB go back to the system at once: 24 000 page faults per log
instead of 800, and a quarter more processor time."""


class DaskEngine(AbstractContextManager['DaskEngine']):
    """The workers of a cluster: that of a scheduler, or processes on this computer, one thread each, loopback only.

    scheduler: address such as tcp://host:8786, '' for this computer; workers: processes there, 0 for one per core. It
    starts when it is used for the first time. Raises InvalidConfig for an address without a port,
    and where the scheduler does not answer."""

    def __init__(self, scheduler: str = '', workers: int = 0) -> None:
        if scheduler and not ADDRESS.fullmatch(scheduler):
            raise InvalidConfig(f'--scheduler {scheduler}: expected the address of a Dask scheduler such as '
                                'tcp://host:8786, found one without a port')
        self._scheduler, self._workers = scheduler, workers or CPU_COUNT
        self._cluster: LocalCluster | None = None
        self._client: Client | None = None
        self._threads, self._counted = 0, -FRESH

    def __exit__(self, *_: object) -> None:
        for one in (self._client, self._cluster):
            if one is not None:
                one.close()

    @property
    def client(self) -> Client:
        """The client of the cluster."""
        if self._client is None:
            logging.getLogger('distributed').setLevel(logging.CRITICAL)
            if not self._scheduler:
                dask.config.set({f'distributed.{name}': value for name, value in SETTINGS.items()})
                try:
                    self._cluster = LocalCluster(
                        n_workers=self._workers, threads_per_worker=1, processes=True, host='127.0.0.1',
                        dashboard_address=None, scheduler_kwargs={'dashboard_address': '127.0.0.1:0'},
                        silence_logs=logging.CRITICAL, preload=[__name__])
                except (LookupError, OSError, RuntimeError, TypeError, ValueError) as error:
                    raise InvalidConfig(
                        'Dask: expected workers on this computer, found none: '
                        f'{" ".join(str(error).split()):.200}; correct the settings of Dask (DASK_... in the '
                        'environment, ~/.config/dask)') from error
            try:
                self._client = Client(self._cluster or self._scheduler, timeout=PATIENCE, set_as_default=False)
            except (OSError, ValueError) as error:
                raise InvalidConfig(f'--scheduler {self._scheduler}: expected a Dask scheduler such as '
                                    f'tcp://host:8786, found: {" ".join(str(error).split()):.200}') from error
        return self._client

    def _window(self) -> int:
        """Return how many tasks are sent at once."""
        if time.monotonic() - self._counted > FRESH:
            self._threads, self._counted = sum(self.client.nthreads().values()), time.monotonic()
        return AHEAD * max(self._threads, 1)

    def results(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[
            tuple[Item, Result | None]]:
        """See Engine."""
        sent = dict[Future, Item]()
        done: Any = None
        for item in items:
            done = done or as_completed([], loop=self.client.loop)
            future = self.client.submit(function, item, pure=False)
            sent[future] = item
            done.add(future)
            while len(sent) >= self._window():
                yield _next(done, sent)
        while sent:
            yield _next(done, sent)


def dask_setup(_: Any) -> None:
    """Let a worker of this computer, which runs it as it starts, leave Ctrl-C to the process that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _next(done: Any, sent: dict[Future, Item]) -> tuple[Item, Any]:
    future = next(done)
    try:
        return sent[future], future.result()
    except KilledWorker:
        return sent[future], None
    finally:
        del sent[future]
