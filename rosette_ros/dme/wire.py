# SPDX-License-Identifier: Apache-2.0
"""The lines of I++ DME: framing, tags, commands, answers, and the grammar of their values.

A line is ASCII and ends in CR LF. A command is `00012 GoTo(X(1.5), Y(2))`, with the tag E0012 for events; answers carry
its tag: `&` acknowledged, `# values` data, `! Error(...)` error, `%` done. A value is a number, "a text", a Word, or
Name(values), also without a name. In data a blank may follow `#` (1.4) or not (2.x). Source: I++ DME 1.4.3, section 6.
"""

import asyncio
import math
import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from rosette_ros.core.run.errors import CellError, plain

PORT = 1294
"""The TCP port that is registered for I++ DME."""
LONGEST = 65536
"""Bytes of the longest line, CR LF included."""
DEEPEST = 12
"""Values nested deeper than this are refused; the protocol needs 3."""
ACK, DATA, ERROR, DONE = '&#!%'
_END = ('mark', ')')
_COMMA = '; these are decimal commas: set the decimal sign of the I++ server to a point (its language or region)'
UNSOLICITED = frozenset(('E0000', '00000'))
"""Tags of what a server says without having been asked."""

_COMMAND = re.compile(r'([0-9]{5}|E[0-9]{4}) (.+)')
_RESPONSE = re.compile(r'([0-9]{5}|E[0-9]{4}) ([&#!%]) *(.*)')
_TOKEN = re.compile(r' *(?:"(?P<text>[^"]*)"|(?P<call>(?:[A-Za-z_][A-Za-z0-9_.]*)?\()|(?P<mark>[),])|'
                    r'(?:(?P<odd>(?i:[+-]?(?:nan|inf(?:inity)?|1\.#[a-z]+[0-9]*)))|(?P<word>[A-Za-z_][A-Za-z0-9_.]*)|'
                    r'(?P<number>[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?))(?![A-Za-z0-9_.#"(])) *')


class NotDme(CellError):
    """A line or value that is not I++ DME, or not what the command answers."""


class Word(str):
    """A name without arguments, such as MachineCsy; a text in quotes is a plain str."""

    __slots__ = ()


@dataclass(frozen=True)
class Call:
    """A name with values: a command, X(1.5), or a list without a name, as of AlignPart."""

    name: str
    values: 'tuple[Value, ...]' = ()


Value: TypeAlias = float | str | Word | Call


@dataclass(frozen=True)
class Command:
    """What the client sends."""

    tag: str
    call: Call

    def line(self) -> str:
        """Return the line without CR LF; raises NotDme for what cannot be written."""
        return f'{self.tag} {format_value(self.call)}'


@dataclass(frozen=True)
class Response:
    """What the server sends: kind ACK, DATA, ERROR or DONE."""

    tag: str
    kind: str
    values: tuple[Value, ...] = ()

    def line(self, blank: bool = True) -> str:
        """Return the line without CR LF, with a blank after `#` or without; raises NotDme as format_value."""
        values = ', '.join(map(format_value, self.values))
        return f'{self.tag} {self.kind}{" " if values and (blank or self.kind != DATA) else ""}{values}'


@dataclass(frozen=True)
class DmeError:
    """What a server says is wrong: severity 0-3 or 9, number such as 1006, the method, and words."""

    severity: int
    number: int
    method: str = ''
    text: str = field(default='', compare=False)

    def value(self) -> Call:
        """Return it as it stands in an answer; in its words what cannot be written becomes an apostrophe or `?`."""
        method, words = (text.replace('"', "'").encode('ascii', 'replace').decode() for text in
                         (plain(self.method), plain(self.text)))
        return Call('Error', (self.severity, Word(f'{self.number:04d}'), method, words))

    def __str__(self) -> str:
        words = plain(self.text, 200) or 'no words'
        return f'error {self.number:04d} (severity {self.severity}): {words}'


async def read_line(reader: asyncio.StreamReader) -> str | None:
    """Return the next line without CR LF, None at the end of the connection.

    The reader's limit has to be LONGEST. Raises NotDme for a line that is too long, cut off, or not ASCII; what is left
    of a connection after that means nothing."""
    try:
        data = await reader.readuntil(b'\n')
    except asyncio.IncompleteReadError as error:
        if error.partial:
            raise NotDme(f'expected a line that ends in CR LF, found {error.partial[-60:]!r} and the end') from None
        return None
    except asyncio.LimitOverrunError:
        raise NotDme(f'expected a line of at most {LONGEST} bytes, found more') from None
    if not data.endswith(b'\r\n'):
        raise NotDme(f'expected a line that ends in CR LF, found {data[-60:]!r}')
    return decoded(data[:-2])


def decoded(data: bytes) -> str:
    """Return a line as text; raises NotDme where it holds what is not printable ASCII."""
    text = data.decode('latin-1')
    if not (text.isascii() and text.isprintable()):
        raise NotDme(f'expected printable ASCII, found {data[:60]!r}')
    return text


def encoded(line: str) -> bytes:
    """Return a line as it is sent."""
    return line.encode('ascii') + b'\r\n'


def parse_command(line: str) -> Command:
    """Return what a client's line says; raises NotDme where it is no command."""
    found = _COMMAND.fullmatch(line)
    if not found or found[1] in UNSOLICITED:
        raise NotDme(f'expected a tag 00001-99999 or E0001-E9999, a blank and a command, found {line!r:.80}')
    values = parse_values(found[2])
    if len(values) != 1 or not isinstance(values[0], Call) or not values[0].name:
        raise NotDme(f'expected one command such as StartSession(), found {found[2]!r:.80}')
    return Command(found[1], values[0])


def parse_response(line: str) -> Response:
    """Return what a server's line says, in either dialect; raises NotDme where it is none of the four kinds."""
    found = _RESPONSE.fullmatch(line)
    if not found:
        raise NotDme(f'expected a tag and one of & # ! %, found {line!r:.80}')
    tag, kind, rest = found.groups()
    if kind in (ACK, DONE) and rest:
        raise NotDme(f'expected nothing after {tag} {kind}, found {rest!r:.80}')
    return Response(tag, kind, parse_values(rest))


def parse_values(text: str) -> tuple[Value, ...]:
    """Return the values in a text, separated by commas; raises NotDme where it says something else."""
    tokens, at = deque[tuple[str, str]](), 0
    while at < len(text):
        found = _TOKEN.match(text, at)
        if not found and text[at:].strip(' '):
            raise NotDme(f'expected a value, a comma or a bracket, found {text[at:at + 20]!r} in {text!r:.80}')
        at = found.end() if found else len(text)
        if found and found.lastgroup:
            tokens.append((found.lastgroup, found[found.lastgroup]))
    out = _values(tokens, text, DEEPEST)
    if tokens:
        raise NotDme(f'expected values separated by commas, found {tokens[0][1]!r:.20} in {text!r:.80}')
    return out


def _values(tokens: deque[tuple[str, str]], text: str, depth: int) -> tuple[Value, ...]:
    """Return the values up to what is neither one nor a comma, and take their tokens."""
    out: list[Value] = []
    while tokens and (out or tokens[0] != _END):
        kind, word = tokens.popleft()
        if kind == 'call':
            if not depth:
                raise NotDme(f'expected at most {DEEPEST} brackets within brackets, found {text!r:.80}')
            out.append(Call(word[:-1], _values(tokens, text, depth - 1)))
            if not tokens or tokens.popleft() != _END:
                raise NotDme(f'expected commas between values and a bracket at their end, found {text!r:.80}')
        elif kind == 'mark':
            raise NotDme(f'expected a value, found {word!r} in {text!r:.80}')
        else:
            out.append(word if kind == 'text' else Word(word) if kind == 'word' else
                       float(word) if kind == 'number' else math.nan)
        if not tokens or tokens[0] != ('mark', ','):
            break
        tokens.popleft()
        if not tokens:
            raise NotDme(f'expected a value after the last comma, found {text!r:.80}')
    return tuple(out)


def format_value(value: Value) -> str:
    """Return a value as it is written; raises NotDme where it cannot be: not finite, or a text with quotes."""
    if isinstance(value, Call):
        return f'{value.name}({", ".join(map(format_value, value.values))})'
    if isinstance(value, Word):
        return value
    if isinstance(value, str):
        if '"' in value or not (value.isascii() and value.isprintable()):
            raise NotDme(f'expected a text of printable ASCII without quotes, found {value!r:.80}')
        return f'"{value}"'
    if not math.isfinite(value):
        raise NotDme(f'expected a finite number, found {value}')
    return f'{round(value, 9) + 0.0:.9f}'.rstrip('0').rstrip('.')  # + 0.0: never -0


def call(name: str, *values: 'Value | Call') -> Call:
    """Return Name(values): call('GoTo', call('X', 1.0), call('Y', 2.0))."""
    return Call(name, values)


def named(values: Iterable[Value], name: str) -> tuple[Value, ...] | None:
    """Return what stands in the brackets of a name among values, in whatever order they are; None if it is missing.

    Raises NotDme where the name is there more than once, and not with the same values."""
    found = [value for value in values if isinstance(value, Call) and value.name == name]
    if any(one != found[0] for one in found):
        raise NotDme(f'expected one {name}(...), found {shown(found)}')
    return found[0].values if found else None


def numbers(values: Sequence[Value], name: str, count: int = 1) -> tuple[float, ...]:
    """Return the finite numbers in the brackets of a name among values; raises NotDme where they are not `count`."""
    found = named(values, name)
    try:
        made = tuple(map(number, found or ()))
    except NotDme as error:
        raise NotDme(f'{name}: {error}') from None
    if found is None or len(made) != count:
        raise NotDme(f'expected {name}(...) with {count} numbers, found '
                     f'{shown(values)}{_COMMA * (len(made) == 2 * count)}')
    return made


def number(value: Value) -> float:
    """Return a finite number, also where it stands in quotes; raises NotDme where there is none."""
    made = _as_float(value) if isinstance(value, float | int | str) else math.nan
    if not math.isfinite(made):
        has_comma = isinstance(value, str) and math.isfinite(_as_float(value.replace(',', '.')))
        raise NotDme(f'expected a finite number, found {shown([value])}{_COMMA * has_comma}')
    return made


def _as_float(value: float | str) -> float:
    try:
        return float(value)
    except ValueError:
        return math.nan


def text(value: Value) -> str:
    """Return a value as a text, with quotes or without."""
    return str(value) if isinstance(value, str) else shown([value])


def shown(values: Iterable[Value]) -> str:
    """Return values in one line of words, for errors."""
    return plain(', '.join(repr(value) if isinstance(value, float) and not math.isfinite(value) else
                           f'{value.name}({shown(value.values)})' if isinstance(value, Call) else format_value(value)
                           for value in values) or 'nothing', 120)


def error_of(response: Response) -> DmeError:
    """Return the error in a response of the kind ERROR; raises NotDme where it does not say one."""
    found = named(response.values, 'Error')
    if found is None or len(found) < 2:
        raise NotDme(f'expected Error(severity, number, method, text), found {shown(response.values)}')
    severity, code = (number(value) for value in found[:2])
    if severity not in (0, 1, 2, 3, 9) or code not in range(10000):
        raise NotDme(f'expected a severity 0-3 or 9 and a number 0000-9999, found {shown(found[:2])}')
    method, words = (*map(text, found[2:4]), '', '')[:2]
    return DmeError(int(severity), int(code), method, words)
