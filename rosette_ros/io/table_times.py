# SPDX-License-Identifier: Apache-2.0
"""Times of a table that are no seconds: dates with time of day as countries write them, clocks, rows of digits."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from rosette_ros.core.run.errors import InvalidData

FORMS = ('seconds, 2026-11-27 08:00:34, 27.11.2026 08:00:34, 27/11/2026 08:00:34, 11/27/2026 08:00:34 AM, '
         '27-Nov-2026 08:00:34, 20261127080034 or 08:00:34, each with a zone such as +01:00 in every row or in none')
"""What is read, as errors say it."""
LONGEST = 60
FEWEST_CLOCKS = 12
"""So many whole numbers that are times of day HHMMSS, of different minutes and seconds, are no chance."""
DAY = 86400.0
_CLOCK = r'(?P<hour>\d{1,2}):(?P<minute>\d\d)(?::(?P<second>\d\d)(?P<part>[.,]\d{1,9})?)?'
_FORM = re.compile(rf'(?:(?P<date>\S.{{0,30}}?)[\s,T/]{{1,3}})?{_CLOCK}\s?(?P<half>[AaPp]\.?[Mm]\.?)?\s?'
                   r'(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?')
_DIGITS = re.compile(r'(\d{4})(\d\d)(\d\d)T?(?P<clock>\d{6})([.,]\d{1,9})?')
_MONTHS = {name: place for place, names in enumerate((
    'jan', 'feb', 'mar mär mrz', 'apr', 'may mai', 'jun', 'jul', 'aug', 'sep', 'oct okt', 'nov', 'dec dez'), 1)
    for name in names.split()}


@dataclass(frozen=True)
class Moments:
    """Times of rows, s since the first one, None where a cell is empty; begun: of the first, s since the epoch, None
    where there is no date; words: what was taken as times."""

    since_first: list[float | None]
    begun: float | None
    words: str


def moments(cells: Sequence[str], wrong: Callable[[int, str, str], InvalidData]) -> Moments | None:
    """Return what cells say that are dates or times of day; None where they are numbers.

    wrong: returns the error of a cell from its row, what was wanted, and what to do. Raises it where some cells can be
    read and others not, where day and month cannot be told apart, and where some have a time zone and others none."""
    texts = [cell.strip() for cell in cells]
    given = [text for text in texts if text]
    if not given:
        return None
    digits = [_DIGITS.fullmatch(text) for text in given]
    if all(digits):
        texts = [f'{text[:4]}-{text[4:6]}-{text[6:8]} {_with_colons(text[8:].lstrip("T"))}' if text else ''
                 for text in texts]
    elif _are_clocks(given):
        texts = [_with_colons(text.zfill(6 + len(text.partition('.')[2]) + ('.' in text))) if text else ''
                 for text in texts]
    elif ':' not in given[0]:
        return None
    found = [_FORM.fullmatch(text) if len(text) <= LONGEST else None for text in texts]
    month_first = _is_month_first(found, wrong)
    times = list[float | None]()
    for row, (text, one) in enumerate(zip(texts, found)):
        try:
            times.append(_seconds(one, month_first) if one else None)
        except (ValueError, KeyError, OverflowError):
            one = None
        if text and one is None:
            raise wrong(row, FORMS, '')
    has_zone = [bool(one['zone']) for one in found if one]
    if len({*has_zone}) > 1:
        row = next(row for row, one in enumerate(found) if one and bool(one['zone']) != has_zone[0])
        raise wrong(row, f'a time {"with" if has_zone[0] else "without"} a zone, as in the rows before',
                    'write the zone in every row, or in none')
    first = next(one for one in times if one is not None)
    is_dated = any(one and one['date'] for one in found)
    return Moments(_over_midnight([None if one is None else one - first for one in times], is_dated),
                   first if is_dated else None,
                   'dates with time of day were' if is_dated else 'times of day were')


def _with_colons(clock: str) -> str:
    return f'{clock[:2]}:{clock[2:4]}:{clock[4:]}'


def _are_clocks(texts: Sequence[str]) -> bool:
    """Return whether numbers are times of day, HHMMSS, and no count of seconds."""
    if len(texts) < FEWEST_CLOCKS or not all(re.fullmatch(r'\d{1,6}(\.\d{1,9})?', text) for text in texts):
        return False
    wholes = [int(text.partition('.')[0]) for text in texts]
    seconds, minutes = ({one // unit % 100 for one in wholes} for unit in (1, 100))
    return (max(wholes) < 240_000 and max(seconds) < 60 and max(minutes) < 60 and len(minutes) > 1
            and max(seconds) - min(seconds) >= 30)


def _is_month_first(found: Sequence[re.Match[str] | None], wrong: Callable[[int, str, str], InvalidData]) -> bool:
    """Return whether the month comes first in dates such as 11/27/2026, of which one tells it of all."""
    dated = [(row, re.fullmatch(r'(\d\d?)[/-](\d\d?)[/-]\d{4}', one['date'])) for row, one in enumerate(found)
             if one and one['date']]
    pairs = [(int(one[1]), int(one[2])) for _, one in dated if one]
    if not pairs or max(first for first, _ in pairs) > 12:
        return False
    if max(second for _, second in pairs) > 12 or any(one['half'] for one in found if one):
        return True
    raise wrong(dated[0][0], 'a date whose day and month are told apart', 'write it as 2026-11-27 08:00:34')


def _seconds(one: re.Match[str], month_first: bool) -> float:
    """Return the time that a cell says, s since the epoch, or since midnight; raises ValueError or KeyError."""
    hour = int(one['hour'])
    if one['half']:
        if not 1 <= hour <= 12:
            raise ValueError(hour)
        hour = hour % 12 + 12 * (one['half'][0] in 'pP')
    year, month, day = _date(one['date'], month_first) if one['date'] else (1970, 1, 1)
    moment = datetime(year, month, day, hour, int(one['minute']), int(one['second'] or 0), tzinfo=UTC)
    if (zone := one['zone']) and zone[0] in '+-':
        east = timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
        moment -= east if zone[0] == '+' else -east
    return moment.timestamp() + float((one['part'] or '0').replace(',', '.'))


def _date(text: str, month_first: bool) -> tuple[int, int, int]:
    parts = [part for part in re.split(r'[-./,\s]', text) if part]
    if len(parts) != 3:
        raise ValueError(text)
    if names := [part for part in parts if part[:3].casefold() in _MONTHS]:
        parts.remove(names[0])
        year, day = sorted(parts, key=len, reverse=True)
        return _year(year), _MONTHS[names[0][:3].casefold()], int(day)
    if len(parts[0]) == 4:
        return _year(parts[0]), int(parts[1]), int(parts[2])
    one, other = (int(parts[1]), int(parts[0])) if month_first else (int(parts[0]), int(parts[1]))
    return _year(parts[2]), other, one


def _year(text: str) -> int:
    if len(text) != 4:
        raise ValueError(text)
    return int(text)


def _over_midnight(times: list[float | None], is_dated: bool) -> list[float | None]:
    """Return times of which each clock that goes back by more than half a day is that of the next day."""
    if is_dated:
        return times
    made, days, last = list[float | None](), 0.0, 0.0
    for one in times:
        if one is not None:
            days += DAY * (one + days < last - DAY / 2)
            last = one + days
        made.append(None if one is None else last)
    return made
