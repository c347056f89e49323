# SPDX-License-Identifier: Apache-2.0
"""Lines of I++ DME: those of the specification and of servers, and what is none."""

import asyncio
import contextlib
import math
from collections import Counter
from random import Random

import pytest

from rosette_ros.core.run.errors import CellError
from rosette_ros.dme.dme_session import DmeLost, DmeRefused, DmeSession, DmeStopped
from rosette_ros.dme.wire import (
    ACK,
    DATA,
    DONE,
    ERROR,
    LONGEST,
    Call,
    Command,
    DmeError,
    NotDme,
    Response,
    Word,
    call,
    encoded,
    error_of,
    format_value,
    named,
    number,
    numbers,
    parse_command,
    parse_response,
    parse_values,
    read_line,
)

COMMANDS = [
    ('00012 ChangeTool("Probe1")', Call('ChangeTool', ('Probe1',))),
    ('00018 Get(X(),Y(),Tool.A())', Call('Get', (Call('X'), Call('Y'), Call('Tool.A')))),
    ('00520 PtMeas(X(1), Y(-2.5), IJK(0,0,1))', call('PtMeas', call('X', 1), call('Y', -2.5), call('IJK', 0, 0, 1))),
    ('00670 SetCoordSystem(PartCsy)', Call('SetCoordSystem', (Word('PartCsy'),))),
    ('00491 StopDaemon(E0490)', Call('StopDaemon', (Word('E0490'),))),
    ('E0020 AbortE()', Call('AbortE')),
]
RESPONSES = [
    ('00012 &', Response('00012', ACK)),
    ('00012 %', Response('00012', DONE)),
    ('00018 # R(0.00000), X(100.5)', Response('00018', DATA, (call('R', 0), call('X', 100.5)))),
    ('00018 #R(0),X(1.005e2)', Response('00018', DATA, (call('R', 0), call('X', 100.5)))),
    ('00101 # (1.0, 0.0, .5)', Response('00101', DATA, (Call('', (1.0, 0.0, 0.5)),))),
    ('00501 # ChangeToolAction(Switch, Z(-8))',
     Response('00501', DATA, (Call('ChangeToolAction', (Word('Switch'), call('Z', -8))),))),
    ('00301 # "Speed", "Number"', Response('00301', DATA, ('Speed', 'Number'))),
]


@pytest.mark.parametrize(('line', 'wanted'), COMMANDS)
def test_commands(line, wanted):
    """Those of the specification are read, and written so that they are read again."""
    command = parse_command(line)
    assert command == Command(line[:5], wanted)
    assert parse_command(command.line()) == command


@pytest.mark.parametrize(('line', 'wanted'), RESPONSES)
def test_responses(line, wanted):
    """Both dialects are read and written."""
    assert parse_response(line) == wanted
    assert parse_response(wanted.line()) == parse_response(wanted.line(blank=False)) == wanted


@pytest.mark.parametrize(('line', 'words'), [
    ('', 'expected a tag'), ('12 Get()', 'expected a tag'), ('00000 Get()', 'expected a tag'),
    ('E0000 Get()', 'expected a tag'), ('00001 Get', 'expected one command'), ('00001 Get(), Get()', 'expected one '
                                                                                                     'command'),
    ('00001 (1)', 'expected one command'),
    ('00001 Get(', 'a bracket at their end'), ('00001 Get(X(1,)', "expected a value, found ')'"),
    ('00001 Get(1 2)', 'expected commas'), ('00001 Get (1)', "found '('"), ('00001 Get(1))', "found ')'"),
    ('00001 Get("x)', 'expected a value, a comma'), ('00001 Get(1.2.3)', 'expected a value, a comma'),
    ('00001 ' + '(' * 60000, 'at most 12 brackets'),
])
def test_what_is_no_command(line, words):
    """One error that says what was wanted."""
    with pytest.raises(NotDme, match='expected') as caught:
        parse_command(line)
    assert words in str(caught.value)


@pytest.mark.parametrize(('line', 'words'), [
    ('HTTP/1.1 400 Bad Request', 'expected a tag and one of'), ('00001 & more', 'expected nothing after'),
    ('00001 $', 'expected a tag'), ('00001 # X(1),', 'after the last comma'), ('00001 # X 1', 'separated by commas'),
])
def test_what_is_no_response(line, words):
    """Likewise for a client."""
    with pytest.raises(NotDme, match=words):
        parse_response(line)


def test_numbers_are_written_without_exponent():
    """To 1e-9 mm or degrees, without digits that say nothing."""
    assert [format_value(v) for v in (100, -0.05, 1e-9, -1e-12, 1 / 3)] == ['100', '-0.05', '0.000000001', '0',
                                                                            '0.333333333']


@pytest.mark.parametrize('value', [math.nan, math.inf, 'a "b"', 'ü', 'a\r\nb'])
def test_what_cannot_be_written(value):
    """Never half a line, never two."""
    with pytest.raises(NotDme):
        format_value(value)


def test_answers_are_read_by_name():
    """Whatever the order; a number may stand in quotes; what is missing or no number is told."""
    values = parse_values('IJK(0, 0, 1), Y("2.5"), X(nan), Z(-1.#IND)')
    assert numbers(values, 'Y') == (2.5,)
    assert numbers(values, 'IJK', 3) == (0, 0, 1)
    assert named(values, 'R') is None
    assert numbers(parse_values('X(2), Y(1), X(2)'), 'X') == (2,)
    for name, words in [('X', 'X: expected a finite number, found nan'), ('Z', 'Z: expected a finite number, found '
                                                                               'nan'),
                        ('R', r'expected R\(...\) with 1 numbers, found IJK'), ('IJK', 'with 1 numbers')]:
        with pytest.raises(NotDme, match=words):
            numbers(values, name)
    with pytest.raises(NotDme, match='found "1e999"'):
        number('1e999')


@pytest.mark.parametrize('line', ['00032 ! Error(3, 1008, "GoTo", "Out of volume")',
                                  '00032 ! Error("3", "1008", GoTo, "Out of volume")'])
def test_errors(line):
    """With the number in quotes or without; and written again with its four digits."""
    error = error_of(parse_response(line))
    assert (error, error.text) == (DmeError(3, 1008, 'GoTo'), 'Out of volume')
    assert str(error) == 'error 1008 (severity 3): Out of volume'
    assert Response('00032', ERROR, (DmeError(2, 6, 'a "b"', 'x\ny').value(),)).line() == (
        '00032 ! Error(2, 0006, "a \'b\'", "x y")')


@pytest.mark.parametrize('line', ['00001 ! Error(7, 1008)', '00001 ! Error(1)', '00001 ! "x"',
                                  '00001 ! Error(1e999, 2)', '00001 ! Error(2, 1.5)'])
def test_errors_that_say_none(line):
    """A severity or number that the protocol does not have."""
    with pytest.raises(NotDme):
        error_of(parse_response(line))


def lines_of(*packets):
    """Return what a reader makes of packets: lines, and at the end None or the words of an error."""
    async def read():
        reader = asyncio.StreamReader(limit=LONGEST)
        for packet in packets:
            reader.feed_data(packet)
        reader.feed_eof()
        out = []
        while True:
            try:
                out.append(await read_line(reader))
            except NotDme as error:
                return [*out, str(error)]
            if out[-1] is None:
                return out
    return asyncio.run(read())


def test_framing():
    """Packets may split and join lines anywhere."""
    data = encoded('00001 &') + encoded('00001 %')
    for cut in range(len(data)):
        assert lines_of(data[:cut], data[cut:]) == ['00001 &', '00001 %', None]
    assert lines_of(*(bytes([byte]) for byte in data)) == ['00001 &', '00001 %', None]


@pytest.mark.parametrize(('data', 'words'), [
    (b'00001 &\n', 'ends in CR LF'), (b'00001 \xff\r\n', 'printable ASCII'), (b'0000\n1 &\r\n', 'ends in CR LF'),
    (b'x' * (2 * LONGEST) + b'\r\n', 'at most 65536 bytes'),
])
def test_framing_of_what_is_no_line(data, words):
    """Of bounded length, printable, and complete."""
    [error] = lines_of(data)
    assert words in error


PIECES = [b'(', b')', b',', b' ', b'"', b'#', b'&', b'!', b'%', b'00001', b'E0000', b'X', b'X(1)', b'Error', b'.', b'-',
          b'nan', b'1.#IND', b'0513', b'\x00', b'\xff', b'\n', b'\r', b'1e999', b'0006']


def made_up(count, seed):
    """Yield lines of a server, cut, doubled, mixed and strewn with pieces."""
    random = Random(seed)
    whole = [f'00001{line[5:]}'.encode() for line, _ in RESPONSES] + [
        b'00001 ! Error(2, 0006, "GoTo", "aborted")', b'E0000 ! Error(3, 0500, "x", "y")', b'00001 # X(1), Y(2), Z(3)']
    for _ in range(count):
        line = bytearray(random.choice(whole))
        for _ in range(random.randrange(5)):
            at = random.randrange(len(line) + 1)
            end = min(at + random.randrange(4), len(line))
            line[at:end] = random.choice([b'', bytes(line[at:end] * 2), random.choice(PIECES), random.randbytes(2)])
        yield bytes(line)


def test_ten_thousand_made_up_lines():
    """Through the client: data, the error of the command, or a connection that is given up in one line of words."""
    class Writer:
        def write(self, data):
            """Nobody reads it."""

        def close(self):
            """Nothing is open."""

    async def heard():
        ends = Counter()
        for line in made_up(10_000, seed=1):
            reader = asyncio.StreamReader(limit=LONGEST)
            session = DmeSession(reader, Writer(), 'here')
            reader.feed_data(b'00001 &\r\n' + line + b'\r\n00001 %\r\n')
            try:
                values = sum(await session.request(Call('Get')), ())
                ends['data'] += 1
                with contextlib.suppress(NotDme):
                    numbers(values, 'X')
            except CellError as error:
                assert str(error).isprintable()
                ends[type(error)] += 1
            await session.close()
        return ends

    ends = asyncio.run(heard())
    assert ends.total() == 10_000
    assert min(ends[kind] for kind in ('data', DmeRefused, DmeLost, DmeStopped)) > 100
