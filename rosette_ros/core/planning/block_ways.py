# SPDX-License-Identifier: Apache-2.0
"""Ways on which a cell may go on: few turns of the table, waits, and at each stop any of the balls."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rosette_ros.core.planning.advice import times_of
from rosette_ros.core.run.geometry import TWO_PI, Floats, Ints
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import Scheme, Way
from rosette_ros.core.run.touches import USUAL, Pace

NEXT = 'next'
"""Name of the order of a block."""
STOPS = 1, 3, 12
"""Table positions of a way."""
LOOKED = 36
"""Readings of a way that are looked at, of more those that are evenly spread over the balls of each stop."""
WAITS = 0.0, 1.0
"""Waits before a way, in times that so many readings as the run has take without waits."""
TREND = 0.25
"""Last part of a run from which the temperature is continued, and time, over the run's, in which its change ends."""


@dataclass(frozen=True, eq=False)
class BlockWay:
    """Stops of the table in their order: positions (m,), one-based, and the senses in which they are reached; wait:
    before the first one, s."""

    position: Ints
    sense: Ints
    wait: float

    def scheme(self, run: Run, stop: Ints, ball: Ints) -> Scheme:
        """Return the readings of balls (S,) at stops (S,), 0..m-1, as they are measured: at each stop round the CMM.

        run: which they continue."""
        order = np.lexsort(((self.position[stop] + ball) % run.n, stop))
        stop, ball = stop[order], ball[order]
        wait = np.zeros(ball.size)
        wait[0] = self.wait
        return Scheme(run.n, NEXT, 0, self.position[stop], ball, self.sense[stop], table_offset=run.table_offset,
                      wait=wait)

    def every(self, run: Run) -> Scheme:
        """Return the readings at all stops of the balls that are at CMM positions that the run has used, from stop to
        stop others where not all are looked at: at others are gaps, in which the CMM's last move is not known."""
        balls, most = np.array(run.balls), max(LOOKED // self.position.size, 1)
        seen = [balls[np.isin((at + balls - 2) % run.n + 1, run.cmm_position)] for at in self.position]
        ball = [np.roll(own, -k)[np.linspace(0, own.size, min(own.size, most), endpoint=False).round().astype(int)]
                for k, own in enumerate(seen)]
        return self.scheme(run, np.repeat(np.arange(len(ball)), list(map(len, ball))), np.concatenate(ball))


def ways(run: Run, stops: Sequence[int] = STOPS) -> Iterator[BlockWay]:
    """Yield the ways on which a run may be continued: both senses, narrow and wide steps, with and without a wait, and
    the long way round, which is travel without a reading."""
    n, last, sense = run.n, int(run.table_position[-1]), last_sense(run)
    for wait in WAITS:
        seconds = wait * run.size * float(np.median(np.diff(run.time)))
        for count in dict.fromkeys(min(count, n) for count in stops):
            steps = dict.fromkeys((1, max(n // count, 1))) if count > 1 else (0, 1)
            for step in steps:
                for turning in (sense, -sense) if step else (sense,):
                    position = (last - 1 + turning * step * np.arange(1, count + 1)) % n + 1
                    yield BlockWay(position, np.full(count, turning), seconds)
                    if step == 1 and not wait:  # nearly once round before each of the readings of a stop
                        yield BlockWay(position, np.full(count, -turning), seconds)


def last_sense(run: Run) -> int:
    """Return the sense of the last move of the table in a run."""
    return -1 if run.approach[-1] < 0 else 1


def with_block(run: Run, block: Scheme) -> Scheme:
    """Return the readings of a run, as they were measured, and those of a block as one scheme."""
    parts = [(getattr(run, name), getattr(block, name)) for name in ('table_position', 'ball', 'approach')]
    position, ball, approach = (np.concatenate(one) for one in parts)
    return Scheme(run.n, NEXT, 0, position, ball, np.where(approach < 0, -1, 1), table_offset=run.table_offset,
                  wait=np.concatenate([np.zeros(run.size), block.wait]))


def continued(run: Run, scheme: Scheme, pace: Pace) -> Run:
    """Return a run as it is expected to be once the readings of a scheme follow: nominal centres, times of moves, waits
    and touches, the temperature on its way to rest."""
    size, joined = scheme.ball.size, {}
    for name in ('table_position', 'ball', 'approach'):
        joined[name] = np.concatenate([getattr(run, name), getattr(scheme, name)])
    position, ball, sense = (one[run.size - 1:] for one in joined.values())
    from_here = Scheme(run.n, NEXT, 0, position, ball, sense, wait=np.append(0, scheme.wait))
    time = run.time[-1] + times_of(from_here, run.radius, USUAL, pace)[1:]
    step = np.diff(position) * TWO_PI / run.n
    turn = np.where(scheme.approach > 0, step % TWO_PI, step % TWO_PI - TWO_PI)
    turn[np.abs(step) < 1e-9] = 0.0
    went = Way(position, ball, sense, np.arange(position.size)).cmm_sense(run.n, run.rotation)[1:]
    for name, new in (('centre', scheme.centres(run.radius)), ('time', time), ('temperature', _temperatures(run, time)),
                      ('session', np.full(size, run.session[-1])),
                      ('cmm_sense', np.where(went == 0, run.cmm_sense[-1], went)),
                      ('table_angle', scheme.table_angle - scheme.table_offset),
                      ('table_travel', run.table_travel[-1] + np.cumsum(turn))):
        joined[name] = np.concatenate([getattr(run, name), new])
    longer = run.replace(**joined, repeats=True)
    lost = tuple(dict.fromkeys((*longer.unrecorded, *run.unrecorded)))
    return longer if lost == longer.unrecorded else replace(longer, unrecorded=lost)


def _temperatures(run: Run, time: Floats) -> Floats:
    """Return the temperatures at times after a run: the change of its last part comes to rest."""
    reach = max(TREND * float(run.time[-1] - run.time[0]), 1e-9)
    late = (run.time >= run.time[-1] - reach) & np.isfinite(run.temperature)
    if not np.isfinite(run.temperature[-1]) or np.count_nonzero(late) < 3:
        return np.full(time.size, run.temperature[-1])
    slope, at_end = np.polyfit(run.time[late] - run.time[-1], run.temperature[late], 1)
    return np.asarray(at_end - slope * reach * np.expm1(-(time - run.time[-1]) / reach))
