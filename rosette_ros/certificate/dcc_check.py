# SPDX-License-Identifier: Apache-2.0
"""A DCC compared with the run that it is of: what is in it is made again, what differs is told."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from rosette_ros.certificate.dcc import (
    CANONICAL,
    DCC,
    HINTS,
    OWN,
    SI,
    Element,
    content_digest,
    document,
    earlier_digest,
)
from rosette_ros.certificate.statements import Inputs, state
from rosette_ros.core.run.errors import InvalidData, RosetteError, one_line
from rosette_ros.invocation import __version__
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.identity_file import Identity, format_identity, parse_identity
from rosette_ros.io.log_reader import find_files
from rosette_ros.io.open_run import has_plate
from rosette_ros.presentation.report.joint_page import open_with_files
from rosette_ros.presentation.report.provenance import digest

MOST_BYTES = 16 << 20
EQUAL = 1e-6
"""Largest difference of numbers that are equal, µm, µrad, degrees, °C: 1e-12 m and rad."""
MOST_TOLD, DEEPEST = 3, 4
"""So many differences are told, and so many of the elements around each."""
USE = 'the order is --verify CERTIFICATE RUN'
_NUMBERS = {f'{{{SI}}}{name}' for name in ('value', 'valueXMLList', 'valueExpandedMU', 'valueExpandedMUXMLList')}
BAD = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""What making a certificate from inputs raises that somebody has changed."""


@dataclass(frozen=True)
class Verified:
    """A document that agrees with its run; largest: difference of a number, µm or µrad; is_signed: carries a signature.

    programs: of the document where they are others than these, '' otherwise; is_earlier: whether an earlier version
    made it, of which only numbers and data are compared."""

    largest: float
    is_signed: bool
    programs: str
    is_earlier: bool = False


def verify_certificate(data: bytes, source: str, paths: Sequence[str | Path]) -> Verified:
    """Return what agrees between a document and its runs; raises InvalidData, saying what was changed, where not."""
    root = parsed(data, source)
    signatures = root.findall('{http://www.w3.org/2000/09/xmldsig#}Signature')
    for one in signatures:
        root.remove(one)
    hashes = {path: _hashes(path) for path in paths}
    found, largest = list[str](), 0.0
    own = root.find(f'{{{DCC}}}comment/{{{OWN}}}content')
    is_earlier = own is not None and own.get('form') != CANONICAL
    if is_earlier and own.get('sha256') != earlier_digest(root):
        found.append('an earlier version made it, whose own SHA-256 is of the XML as it was written: another program '
                     'wrote it again, or its content was changed; take the file that was issued')
    elif not is_earlier and (own is None or own.get('sha256') != content_digest(root)):
        found.append('its content was changed after it was made (its own SHA-256 differs)')
    try:
        inputs = inputs_of(root)
        order = list(inputs.files)
        found += [f'{name}: no file of the run has the SHA-256 {one[:12]}… that the certificate states'
                  for one, name in inputs.files.items() if one not in set().union(*hashes.values())]
        made = document(state(sorted(paths, key=lambda path: max(  # runs may have a plate file in common
            (order.index(one) for one in hashes[path] if one in order), default=len(order))), inputs))
        is_same = dict(inputs.programs).get('rosette_ros') == __version__
        for words, size in _differences(root, made, ''):
            largest = max(largest, size)
            if words and (size or (is_same and not is_earlier)):
                found.append(words)
    except RosetteError as error:
        found.append(one_line(error).removeprefix('certificate: '))
    except BAD:
        found.append('it cannot be made again from what it states of its inputs')
    if found:
        more = f'; and {len(found) - MOST_TOLD} more' if len(found) > MOST_TOLD else ''
        raise InvalidData(f'{source}: expected the certificate of {", ".join(map(str, paths))} as it was issued, found '
                          f'that it is not: {"; ".join(found[:MOST_TOLD])}{more}')
    return Verified(largest, bool(signatures), '' if is_same else ', '.join(map(' '.join, inputs.programs[:1])),
                    is_earlier)


def parsed(data: bytes, source: str) -> Element:
    """Return the root of a DCC without reaching for anything else; raises InvalidData where it is none."""
    if len(data) > MOST_BYTES:
        raise InvalidData(f'{source}: expected a DCC of at most {MOST_BYTES} bytes, found more')
    parser = etree.XMLParser(no_network=True, resolve_entities=False, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError, LookupError) as error:
        got = ('a PDF; take the XML that is attached to it' if data.startswith(b'%PDF') else
               f'what is no XML: {" ".join(str(getattr(error, "msg", error)).split())}; {USE}')
        raise InvalidData(f'{source}: expected a DCC, found {got}') from None
    if root.getroottree().docinfo.internalDTD is not None or next(root.iter(etree.Entity), None) is not None:
        raise InvalidData(f'{source}: expected a DCC, found one with a document type or entities of its own')
    if root.tag != f'{{{DCC}}}digitalCalibrationCertificate':
        raise InvalidData(f'{source}: expected a DCC, found the element {root.tag!r:.80}; {USE}')
    etree.strip_tags(root, etree.Comment, etree.PI)
    for name in HINTS:
        root.attrib.pop(name, None)
    return root


def inputs_of(root: Element) -> Inputs:
    """Return what a document was made from; raises InvalidData where it does not say so."""
    own = root.find(f'{{{DCC}}}comment/{{{OWN}}}inputs')
    values = None
    try:
        values = json.loads(own.text) if own is not None else None
    except (TypeError, ValueError, RecursionError):
        pass
    if not isinstance(values, dict):
        raise InvalidData('the element rosette:inputs, from which it is made again, is missing or unreadable')
    identity = Identity(_texts(values['identity']), _texts(values['tolerances']))
    written, columns = format_identity(identity), values.get('columns')
    return Inputs(
        parse_identity(written.encode()) if written else identity, str(values['issued']), values['model'],
        values['run_id'], values['joint'] is True,
        {key: tuple(one) if isinstance(one, list) else one for key, one in values['sharing'].items()},
        values['budget'], read_columns(None if columns is None else _texts(columns)), _files(root),
        tuple((str(name), str(version)) for name, version in values['programs']))


def _files(root: Element) -> dict[str, str]:
    """Return the names of the data files by their SHA-256, as a document states them."""
    stated = ((one.findtext(f'{{{DCC}}}data/{{{DCC}}}text/{{{DCC}}}content'), one.findtext(f'{{{DCC}}}reference'))
              for one in root.iter(f'{{{DCC}}}metaData') if one.get('refType') == 'rosette_file')
    return {str(words).rpartition(' ')[2]: str(name) for words, name in stated}


def _texts(values: Any) -> dict[str, str]:
    if not all(isinstance(one, str) for one in (*values.keys(), *values.values())):
        raise TypeError('expected texts')
    return dict(values)


def _hashes(path: str | Path) -> set[str]:
    """Return the SHA-256 of the files of a run, also of the plate file of a table."""
    if has_plate(path):
        return {one.sha256 for one in open_with_files(path)[1]}
    return {digest(file).sha256 for file in find_files(path).files}


def _differences(one: Element, made: Element, path: str) -> Iterator[tuple[str, float]]:
    """Yield (words, size of a numeric difference) where an element of a document is not as it is made again."""
    if made.tag == f'{{{OWN}}}content':
        return  # compared as a whole
    here = f'{path}/{made.get("refType") or etree.QName(made).localname}'
    where = '/'.join(here.split('/')[-DEEPEST:])
    if one.tag != made.tag or dict(one.attrib) != dict(made.attrib):
        yield f'{where}: is another element', 0.0
        return
    mine, other = (one.text or '').strip(), (made.text or '').strip()
    if mine != other:
        if one.tag in _NUMBERS:
            yield from _numbers(where, mine, other)
        else:
            same = next((place for place, pair in enumerate(zip(mine, other)) if pair[0] != pair[1]), 0)
            begin = max(same - 10, 0)
            yield f'{where}: {mine[begin:begin + 40]!r}, from the run {other[begin:begin + 40]!r}', 0.0
    children, wanted = (list(element) for element in (one, made))
    if len(children) != len(wanted) or any((child.tail or '').strip() for child in children):
        yield f'{where}: has {len(children)} parts, from the run {len(wanted)}', 0.0
        return
    for child, like in zip(children, wanted):
        yield from _differences(child, like, here)


def _numbers(where: str, mine: str, other: str) -> Iterator[tuple[str, float]]:
    words = f'{where}: '
    try:
        pairs = list(zip(map(float, mine.split()), map(float, other.split()), strict=True))
    except ValueError:
        yield f'{words}{mine!r:.40}, from the run {other!r:.40}', math.inf
        return
    sizes = [abs(a - b) for a, b in pairs]
    worst = max(range(len(sizes)), key=lambda place: sizes[place] if sizes[place] >= 0 else math.inf)
    if not sizes[worst] <= EQUAL:
        yield f'{words}value {worst + 1} is {pairs[worst][0]!r}, from the run {pairs[worst][1]!r}', sizes[worst]
    else:
        yield '', sizes[worst]
