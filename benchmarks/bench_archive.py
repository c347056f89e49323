# SPDX-License-Identifier: Apache-2.0
"""Adding logs of 12 balls (MCAP) to an archive: all cores beside a plain loop in one process, memory, 20 more logs.

Times are those of the wall and of the processors: on a computer that others use, too, the second ones tell. The number
of logs is ARCHIVE_LOGS (default 40; 2000 take the better part of an hour on 2 cores); the plain loop takes a part.
"""

import os
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.archive_logs import make_logs
from rosette_ros.archive.engines import DaskEngine, PlainLoop
from rosette_ros.archive.log_finder import find_logs
from rosette_ros.archive.run_adding import add_logs
from rosette_ros.archive.run_archive import RunArchive

LOGS, LOOP_LOGS, MORE = int(os.environ.get('ARCHIVE_LOGS', '40')), 20, 20
WANTED = 1.7
"""Rate on 2 quiet cores over that of the plain loop."""
MEGABYTE = 1e6


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
    with engine if isinstance(engine, DaskEngine) else tempfile.TemporaryFile():
        done = add_logs(archive, logs, engine, on_progress=watch.look)
        watch.look()
    watch.stop()
    if done.problems or done.new != len(logs):
        raise RuntimeError(f'wanted {len(logs)} logs to be evaluated, got {done}')
    return watch


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
        loop = added(plain, logs[:LOOP_LOGS], PlainLoop())
        loop_logs = len(logs[:LOOP_LOGS])
        print(f'  plain loop    {loop_logs:5d} logs  {loop_logs / loop.wall:6.3f} logs/s  '
              f'{loop.cpu[0] / loop_logs:6.3f} CPU s per log')
        watch = added(archive, logs, DaskEngine())
        own, workers = watch.cpu
        print(f'  {cores} processes   {LOGS:5d} logs  {LOGS / watch.wall:6.3f} logs/s  {workers / LOGS:6.3f} CPU s per '
              f'log in workers, {own / LOGS:.3f} beside them; cores {100 * workers / watch.wall / cores:.0f} % busy')
        print(f'  rate over that of the loop: {LOGS / watch.wall / (loop_logs / loop.wall):.2f} as measured, wanted '
              f'{WANTED} on 2 quiet cores; by processor time at most '
              f'{cores * loop.cpu[0] / loop_logs / ((own + workers) / LOGS):.2f}')
        for cpu, memory in watch.children.values():
            if cpu > 1 and len(memory) > 4:
                print(f'  memory of a worker: {memory[len(memory) // 4]:.0f} MB after a quarter, {memory[-1]:.0f} MB '
                      f'at the end, at most {max(memory):.0f} MB')
        same = rows(archive, {log.path for log in logs[:LOOP_LOGS]}) == rows(plain, {log.path for log in logs})
        print(f'  rows of both: {"the same to the last bit" if same else "DIFFERENT"}')
        print(f'  {sum(path.stat().st_size for path in archive.parts) / LOGS / 1e3:.1f} kB on the disk per run')
        again = added(archive, more, DaskEngine())
        empty = added(RunArchive(root / 'empty', make=True), more, DaskEngine())
        print(f'  {MORE} more logs: {sum(again.cpu):.1f} CPU s, {again.wall:.0f} s; '
              f'the same into an empty archive: {sum(empty.cpu):.1f} CPU s, {empty.wall:.0f} s')
        print('  nothing new: ', end='')
        begin = time.process_time()
        add_logs(archive, find_logs([str(root / 'logs'), str(root / 'more')]), PlainLoop())
        print(f'{time.process_time() - begin:.2f} CPU s')


if __name__ == '__main__':
    main()
