# SPDX-License-Identifier: Apache-2.0
"""Times of a table as countries and programs write them."""

from datetime import UTC, datetime

import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.table_times import moments

SEVEN = datetime(2026, 11, 27, 7, 0, 34, tzinfo=UTC).timestamp()


def refused(row, wanted, advice):
    """Return the error of a cell, as a table makes it."""
    return InvalidData(f'row {row}: expected {wanted}; {advice}')


@pytest.mark.parametrize('cells', [
    ['2026-11-27 07:00:34', '2026-11-27 07:01:06.5'], ['2026-11-27T07:00:34Z', '2026-11-27T07:01:06.5Z'],
    ['2026/11/27 07:00:34', '2026/11/27 07:01:06,5'], ['27.11.2026 07:00:34', '27.11.2026 07:01:06.5'],
    ['27.11.2026/07:00:34', '27.11.2026/07:01:06.5'], ['27/11/2026 07:00:34', '27/11/2026 07:01:06.5'],
    ['11/27/2026 7:00:34 AM', '11/27/2026 7:01:06.5 am'], ['27-Nov-2026 07:00:34', '27-Nov-2026 07:01:06.5'],
    ['Nov 27, 2026 07:00:34', 'Nov 27, 2026 07:01:06.5'], ['27 nov 2026 07:00:34', '27 nov 2026 07:01:06.5'],
    ['20261127070034', '20261127070106.5'], ['20261127T070034', '20261127T070106.5'],
    ['2026-11-27 08:00:34+01:00', '2026-11-27 08:01:06.5+01:00']])
def test_dates_are_read_as_they_are_written(cells):
    """Seconds since the first, and the day."""
    found = moments([*cells, ''], refused)
    assert found.since_first == [0, 32.5, None] and found.begun == SEVEN
    assert found.words == 'dates with time of day were'


def test_noon_and_midnight():
    """12 AM is 0 h, 12 PM noon; a clock that goes back is that of the next day, a date is not."""
    assert moments(['03/04/2026 11:59:50 AM', '03/04/2026 12:00:00 PM'], refused).since_first == [0, 10]
    found = moments(['23:59:50', '00:00:10', '00:00:40'], refused)
    assert (found.since_first, found.begun, found.words) == ([0, 20, 50], None, 'times of day were')


def test_digits_are_clocks_where_they_cannot_be_seconds():
    """HHMMSS without zeros in front, but never a count of seconds that looks like one for some rows."""
    clocks = [f'{h}{m:02}{s:02}' for h, m, s in [(8, 0, 34 + 2 * k) for k in range(12)]
              + [(8, 1, 2 * k) for k in range(9)]]
    found = moments(clocks, refused)
    assert found.since_first[11:13] == [22, 26]
    for seconds in (range(0, 600, 30), range(80000, 80000 + 20 * 32, 32), range(0, 2000, 100), range(5)):
        assert moments([str(one) for one in seconds], refused) is None
    assert moments(['12.5', '30.1'], refused) is None and moments(['', ''], refused) is None


@pytest.mark.parametrize(('cells', 'words'), [
    (['03/04/2026 07:00:34', '03/04/2026 07:01:06'], 'row 0: expected a date whose day and month are told apart'),
    (['2026-11-27 07:00:34+01:00', '2026-11-27 07:01:06'], 'row 1: expected a time with a zone, as in the rows before'),
    (['2026-11-27 07:00:34', '2026-11-27 07:01:06Z'], 'row 1: expected a time without a zone, as in the rows before'),
    (['27-Nov-2026 07:00:34', 'soon'], 'row 1: expected seconds, 2026-11-27 08:00:34, 27.11.2026'),
    (['2026-11-31 07:00:34'], 'row 0: expected seconds'), (['27.11.26 07:00:34'], 'row 0: expected seconds'),
    (['13:00 PM'], 'row 0: expected seconds'), ([f'{"1 " * 40}07:00:34'], 'row 0: expected seconds')])
def test_what_cannot_be_told_is_named_with_what_is_read(cells, words):
    """No time is guessed."""
    with pytest.raises(InvalidData) as caught:
        moments(cells, refused)
    assert str(caught.value).startswith(words)
