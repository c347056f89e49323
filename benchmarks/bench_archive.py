# SPDX-License-Identifier: Apache-2.0
"""Adding logs of 12 balls (MCAP) to an archive: all cores beside a plain loop in one process, memory, 20 more logs.

Rates are compared in turns, for a computer that others use, too, changes its speed. Plain loops side by side, one per
core, show what it allows: two cores may share caches and more. The number of logs of the long addition is ARCHIVE_LOGS
(default 40; 2000 take about 20 minutes on 2 cores).
"""

import multiprocessing
import os
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.archive_logs import make_logs
from rosette_ros.archive.engines import DaskEngine
from rosette_ros.archive.run_adding import add_logs, find_logs
from rosette_ros.archive.run_archive import RunArchive

LOGS, LOOP_LOGS, MORE = int(os.environ.get('ARCHIVE_LOGS', '40')), 20, 20
TURNS, TURN_LOGS = 6, 20  # plain loop, then so many by each core
WANTED = 1.7
"""Rate on 2 quiet cores over that of the plain loop."""
MEGABYTE = 1e6


class PlainLoop:
    """An engine without other processes: one after the other."""

    def results(self, function, items):
        """See archive.run_adding.Engine."""
        return ((item, function(item)) for item in items)


class Watch:
    """Wall and processor seconds of this process and its children until it is stopped, and memory of the children."""

    def __init__(self):
        """Begin; children: (CPU seconds, memory in MB at each look) by process."""
        self.children = {}
        self._own = psutil.Process()
        self._began, self._cpu = time.perf_counter(), sum(self._own.cpu_times()[:2])

    def look(self, *_):
        """Note what the children take now: as they end, it is lost."""
        for child in self._own.children(recursive=True):
            try:
                cpu, memory = sum(child.cpu_times()[:2]), child.memory_info().rss / MEGABYTE
            except psutil.Error:
                continue
            self.children[child.pid] = (cpu, [*self.children.get(child.pid, (0, []))[1], memory])

    def stop(self):
        """Set wall, in seconds, and cpu, the seconds of this process and of its children."""
        self.wall = time.perf_counter() - self._began
        self.cpu = sum(self._own.cpu_times()[:2]) - self._cpu, sum(cpu for cpu, _ in self.children.values())


def added(archive, logs, engine):
    """Add logs and return the Watch; raise where one was not evaluated."""
    watch = Watch()
    done = add_logs(archive, logs, engine, on_progress=watch.look)
    watch.look()
    watch.stop()
    if done.problems or done.new != len(logs):
        raise RuntimeError(f'expected {len(logs)} logs to be evaluated, found {done}')
    return watch


def rate(root, logs, engine):
    """Return the logs per second that are added to an archive of their own."""
    return len(logs) / added(RunArchive(tempfile.mkdtemp(dir=root), make=True), logs, engine).wall


def plain_rate(root, logs):
    """Return that of a plain loop."""
    return rate(root, logs, PlainLoop())


def rates(root, logs, cores):
    """Return the logs per second of a plain loop, of as many at once as there are cores, and of the cluster: harmonic
    means. Each is the first in a third of the turns: what has run before may slow a processor down."""
    all_logs = (logs * cores)[:TURN_LOGS * cores]
    with DaskEngine() as engine, multiprocessing.get_context('spawn').Pool(cores) as pool:
        kinds = [lambda: pool.apply(plain_rate, (root, logs[:TURN_LOGS])),
                 lambda: sum(pool.starmap(plain_rate, [(root, logs[:TURN_LOGS])] * cores)),
                 lambda: rate(root, all_logs, engine)]
        for kind in kinds:
            kind()  # starts processes
        seconds = [0.0] * len(kinds)
        for turn in range(TURNS):
            for place in range(len(kinds)):
                kind = (turn + place) % len(kinds)
                seconds[kind] += 1 / kinds[kind]()
    return [TURNS / each for each in seconds]


def rows(archive, paths):
    """Return the rows of some logs without the time when they were added."""
    found = archive.read_rows().drop_columns(['added_at']).to_pylist()
    return [repr(row) for row in found if row['path'] in paths]


def main():
    """Measure and print."""
    cores = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        begin = time.perf_counter()
        make_logs(root / 'logs', range(LOGS))
        make_logs(root / 'more', range(LOGS, LOGS + MORE))
        print(f'{LOGS} + {MORE} logs of 12 balls made in {time.perf_counter() - begin:.1f} s; '
              f'load {os.getloadavg()[0]:.1f} on {cores} cores')
        logs, more = find_logs([str(root / 'logs')]), find_logs([str(root / 'more')])
        plain, archive = (RunArchive(root / name, make=True) for name in ('plain', 'archive'))
        one, limit, many = rates(root, logs, cores)
        print(f'  in {TURNS} turns: plain loop {one:.3f} logs/s, {cores} at once {limit:.3f} ({limit / one:.2f} times '
              f'one: what this computer allows), {cores} workers {many:.3f} ({many / one:.2f} times one, expected '
              f'{WANTED} on 2 quiet cores; {many / limit:.2f} of what it allows)', flush=True)
        loop = added(plain, logs[:LOOP_LOGS], PlainLoop())
        print(f'  plain loop: {loop.cpu[0] / len(logs[:LOOP_LOGS]):.3f} CPU s per log', flush=True)
        with DaskEngine() as engine:
            watch = added(archive, logs, engine)
        own, workers = watch.cpu
        busy = (own + workers) / watch.wall / cores
        print(f'  {LOGS} logs by {cores} workers: {LOGS / watch.wall:.3f} logs/s, {workers / LOGS:.3f} CPU s per log '
              f'in them, {own / LOGS:.3f} beside them; cores {100 * busy:.0f} % busy', flush=True)
        for cpu, memory in watch.children.values():
            if cpu > 1 and len(memory) > 4:
                print(f'  memory of a worker: {memory[len(memory) // 4]:.0f} MB after a quarter, {memory[-1]:.0f} MB '
                      f'at the end, at most {max(memory):.0f} MB')
        same = rows(archive, {log.path for log in logs[:LOOP_LOGS]}) == rows(plain, {log.path for log in logs})
        print(f'  rows of both: {"the same to the last bit" if same else "DIFFERENT"}')
        print(f'  {sum(path.stat().st_size for path in archive.parts) / LOGS / 1e3:.1f} kB on the disk per run')
        with DaskEngine() as engine:
            again = added(archive, more, engine)
        with DaskEngine() as engine:
            empty = added(RunArchive(root / 'empty', make=True), more, engine)
        print(f'  {MORE} more logs: {sum(again.cpu):.1f} CPU s, {again.wall:.0f} s; '
              f'the same into an empty archive: {sum(empty.cpu):.1f} CPU s, {empty.wall:.0f} s')
        print('  nothing new: ', end='')
        begin = time.process_time()
        add_logs(archive, find_logs([str(root / 'logs'), str(root / 'more')]), PlainLoop())
        print(f'{time.process_time() - begin:.2f} CPU s')


if __name__ == '__main__':
    main()
