# SPDX-License-Identifier: Apache-2.0
"""What the next readings of a run are for, in words."""

from collections import Counter
from typing import TYPE_CHECKING

from rosette_ros.core.run.errors import counted
from rosette_ros.words.effect_words import capital, names
from rosette_ros.words.motion_words import member_words

if TYPE_CHECKING:  # who shows what was found starts without the least squares
    from rosette_ros.core.diagnosis.posterior import Explanation
    from rosette_ros.core.planning.next_readings import NextReadings, Separation

NOTHING = 'no further effect'
NOTHING_TO_DO = 'Nothing more has to be measured.'


def contender_words(one: 'Explanation', other: 'Explanation | None' = None) -> str:
    """Return what an explanation has beyond another one, in words: 'a warm-up of the frame', 'no further effect'."""
    own = Counter(one.members) - Counter(other.members if other else ())
    return names(map(member_words, own.elements())) if own else NOTHING


def pair_words(pair: 'Separation', between: str) -> str:
    """Return the two explanations in doubt with a word between them."""
    return f'{contender_words(pair.first, pair.second)} {between} {contender_words(pair.second, pair.first)}'


def open_words(found: 'NextReadings') -> str:
    """Return what is open: 'warm-up or drift, 61 % against 39 %', '' where nothing is."""
    if found.is_settled:
        return ''
    if (pair := found.separates) is None:
        return f'U is {1e6 * found.uncertainty:.3g} µm'
    return f'{pair_words(pair, "or")}, {odds(pair.now)}'


def settling_words(what: str) -> str:
    """Return that more readings are measured, and for what."""
    return f'settling: {what}'


def settled_words(what: str, is_settled: bool, added: int = 0) -> str:
    """Return that no more readings are measured: what is settled, or open; added: readings, where no more may be."""
    after = f', after as many readings as are to be added ({added})' if added else ''
    return f'{"" if is_settled else "not "}settled: {what}{after}'


def block_words(found: 'NextReadings') -> str:
    """Return what the block is expected to tell, '' where there is none: '8 readings (4 min) are expected to separate
    warm-up from drift: 95 % against 5 %'."""
    if found.targets is None:
        return ''
    size = f'{counted(found.targets.ball.size, "reading")} ({max(found.duration / 60, 1):.0f} min)'
    wanted = f'{size} {"is" if found.targets.ball.size == 1 else "are"} expected to'
    if (pair := found.separates) is None:
        return (f'{wanted} lower U from {1e6 * found.uncertainty:.3g} to {1e6 * found.expected_uncertainty:.3g} µm')
    return f'{wanted} separate {pair_words(pair, "from")}: {odds(pair.expected)}'


def hopeless_words(found: 'NextReadings') -> str:
    """Return why no block helps, '' where one does: 'further readings of this cell cannot distinguish A from B'."""
    if not found.is_hopeless:
        return ''
    if (pair := found.separates) is None:
        return f'further readings of this cell do not lower U, {1e6 * found.uncertainty:.3g} µm'
    return f'further readings of this cell cannot distinguish {pair_words(pair, "from")}'


def standing_words(found: 'NextReadings') -> str:
    """Return how it stands: 'warm-up or drift, 61 % against 39 %', why no block helps, or what is settled."""
    if found.is_settled:
        return contender_words(found.contenders[0])
    return hopeless_words(found) or open_words(found)


def next_words(found: 'NextReadings') -> list[str]:
    """Return what is known, what is in doubt and what the block is for, a sentence each."""
    if found.is_settled:
        return [f'Settled: {contender_words(found.contenders[0])}; U of the curves is at most '
                f'{1e6 * found.uncertainty:.3g} µm.', NOTHING_TO_DO]
    return [f'{capital(text)}.' for text in (
        settling_words(open_words(found)), block_words(found), hopeless_words(found)) if text]


def odds(share: float) -> str:
    """Return a probability against the rest: '61 % against 39 %'."""
    first = min(max(round(100 * share), 1), 99)
    return f'{first} % against {100 - first} %'
