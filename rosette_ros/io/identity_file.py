# SPDX-License-Identifier: Apache-2.0
"""Who, what and where of a calibration, which no reading tells: a file in YAML, schema rosette-identity/1."""

import datetime
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from rosette_ros.core.run.axes import iso_names
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Floats
from rosette_ros.core.run.number_words import ARC_SECOND, Tolerance
from rosette_ros.core.run.records import CURVES, SI_UNITS
from rosette_ros.io.safe_yaml import PlainDumper, known_keys, of_schema, parse_yaml
from rosette_ros.io.text_file import path_of, read_limited

SCHEMA = 'rosette-identity/1'
MOST_BYTES, LONGEST, LONGEST_REMARKS = 65536, 200, 2000
_ADDRESS = {'name': 'name', 'street': 'street and number', 'postcode': 'post code', 'city': 'city',
            'country': 'country (two letters of ISO 3166-1)', 'email': 'e-mail', 'phone': 'telephone'}
_DEVICE = {'maker': 'maker', 'model': 'model', 'serial': 'serial number', 'calibration': 'its own calibration',
           'remarks': 'remarks'}
DEVICES = {'table': 'rotary table', 'cmm': 'CMM', 'probe': 'probe', 'plate': 'ball plate',
           'thermometer': 'thermometer'}
"""What has maker, model and serial number, in words."""
SECTIONS: dict[str, dict[str, str]] = {
    'certificate': {'number': 'certificate number', 'date': 'date of issue', 'remarks': 'remarks'},
    'laboratory': {**_ADDRESS, 'accreditation': 'accreditation', 'logo': 'logo', 'mark': 'accreditation mark'},
    'customer': {**_ADDRESS, 'order': 'order number'},
    'place': {'name': 'place of the calibration', 'at': 'laboratory, customer or other'},
    'measured': {'begin': 'first day of measuring', 'end': 'last day of measuring'},
    'conditions': {'load': 'load on the table', 'speed': 'speed of the table',
                   'radial': 'radial place of the measurement', 'axial': 'axial place of the measurement'},
    'traceability': {'name': 'metrological traceability'},
    'operator': {'name': 'operator'}, 'signer': {'name': 'signer', 'role': 'role of the signer'},
    **{name: dict(_DEVICE) for name in DEVICES}}
"""Sections of the file, and the meaning of their entries."""
REQUIRED = ('certificate.number', 'laboratory.name', 'laboratory.city', 'laboratory.country', 'customer.name',
            'customer.city', 'place.name', 'conditions.load', 'conditions.speed', 'conditions.axial',
            'traceability.name', 'operator.name', 'signer.name',
            *(f'{device}.{entry}' for device in DEVICES for entry in ('maker', 'model', 'serial')))
"""Entries that a certificate is not complete without, ISO/IEC 17025, 7.8.2 and 7.8.4, ISO 230-7."""
PICTURES = ('laboratory.logo', 'laboratory.mark')
"""Names of pictures (PNG, JPEG) beside the identity file, for the head of the pages."""
NAMED = ('place', 'traceability', 'operator', 'signer')
"""Sections that may be a text alone, the name."""
AT = ('laboratory', 'customer', 'other')
_LENGTHS = {'µm': 1e-6, 'nm': 1e-9, 'mm': 1e-3}
_ANGLES = {'µrad': 1e-6, 'mrad': 1e-3, 'rad': 1.0, 'arcsec': ARC_SECOND}
_SPELT = {**dict.fromkeys(('μm', 'um'), 'µm'), **dict.fromkeys(('μrad', 'urad'), 'µrad'), **dict.fromkeys(
    ('arcsecond', 'arcseconds', '″', '"', "''"), 'arcsec')}
"""Other spellings of units."""
_TOLERANCE = re.compile(r'((?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*(\D+)')
_OF_LENGTH = 'length with its unit (nm, µm, mm), such as "1.5 µm"'
_OF_ANGLE = 'angle with its unit (µrad, mrad, rad, arcsec), such as "2 µrad" or "0.4 arcsec"'


@dataclass(frozen=True)
class Identity:
    """Entries by section and name, such as `table.serial`; tolerances: as written, by the name of the error.

    source: of the tolerances, its name in errors.
    """

    entries: Mapping[str, str] = field(default_factory=dict)
    tolerances: Mapping[str, str] = field(default_factory=dict)
    source: str = field(default='identity', compare=False)

    def __getitem__(self, entry: str) -> str:
        """Return an entry, '' where it is not stated."""
        return self.entries.get(entry, '')

    @property
    def missing(self) -> tuple[str, ...]:
        """The required entries that are not stated."""
        return tuple(entry for entry in REQUIRED if not self[entry])

    def with_changes(self, other: 'Identity') -> tuple['Identity', tuple[str, ...]]:
        """Return this with what another one states instead, and the contradictions in words."""
        changed = tuple(f'{key}: {self[key]!r} in the log, {value!r} now' for key, value in other.entries.items()
                        if self[key] not in ('', value))
        return replace(other if other.tolerances else self, entries={**self.entries, **other.entries}), changed

    def limits(self, rotation: Floats | None) -> dict[str, Tolerance]:
        """Return the tolerances of a table, m and rad, by curve; rotation: of the table frame, as of Run.

        Raises InvalidData where one belongs to a table about another axis, or stands twice."""
        curves = {iso.lstrip('-'): curve for curve, iso in iso_names(rotation).items()}
        found: dict[str, Tolerance] = {}
        where = f'{self.source}: tolerances'
        for name, words in self.tolerances.items():
            curve = curves.get(name, name)
            if curve not in CURVES:
                raise InvalidData(f'{where}: {name}: expected errors of this table, {", ".join(curves)}, found one of '
                                  'another axis; ctx … crz go with any axis')
            if curve in found:
                raise InvalidData(f'{where}: {name}: expected each error once, {curve} stands twice')
            found[curve] = _tolerance(words, SI_UNITS[curve] == 'm', f'{where}: {name}')
        return found


def read_identity(path: str | Path) -> Identity:
    """Return the Identity of a file; raises InvalidData, naming file and entry, where it is none."""
    return parse_identity(read_limited(path, 'an identity file', MOST_BYTES), str(path))


def folder_of(path: str | Path | None) -> Path:
    """Return where the pictures lie that an identity names: beside its file, else in the present folder."""
    return Path(path_of(str(path))).parent if path else Path()


def parse_identity(data: bytes, source: str = 'identity') -> Identity:
    """Return the Identity of a file's bytes; source: its name in errors."""
    values = of_schema(parse_yaml(data, source, InvalidData), SCHEMA, source, InvalidData)
    entries: dict[str, str] = {}
    known_keys((one for one in values if one != 'schema'), (*SECTIONS, 'tolerances'), source, InvalidData)
    for section, given in values.items():
        if section in ('schema', 'tolerances') or given is None:
            continue
        if section in NAMED and not isinstance(given, dict):
            given = {'name': given}
        if not isinstance(given, dict):
            raise InvalidData(f'{source}: {section}: expected a mapping of {", ".join(SECTIONS[section])}, found '
                              f'{given!r:.80}')
        known_keys(given, SECTIONS[section], f'{source}: {section}', InvalidData)
        for name, value in given.items():
            if value is not None and value != '':
                entries[f'{section}.{name}'] = _entry(section, name, value, f'{source}: {section}.{name}')
    if 'measured.begin' in entries and entries.get('measured.end', '9') < entries['measured.begin']:
        raise InvalidData(f'{source}: measured: expected an end after the begin {entries["measured.begin"]}, found '
                          f'{entries["measured.end"]}')
    return Identity(entries, _tolerances(values.get('tolerances') or {}, f'{source}: tolerances'), source)


def format_identity(identity: Identity) -> str:
    """Return an identity as the text of a file, YAML; '' for one without entries."""
    if not identity.entries and not identity.tolerances:
        return ''
    nested: dict[str, Any] = {'schema': SCHEMA}
    for key, value in identity.entries.items():
        section, _, name = key.partition('.')
        nested.setdefault(section, {})[name] = value
    return str(yaml.dump({**nested, **({'tolerances': dict(identity.tolerances)} if identity.tolerances else {})},
                         Dumper=PlainDumper, sort_keys=False, allow_unicode=True))


def words_of_entry(entry: str) -> str:
    """Return an entry in words: `serial number of the rotary table`."""
    section, _, name = entry.partition('.')
    words = SECTIONS[section][name]
    if section in DEVICES:
        return f'{words} of the {DEVICES[section]}'
    return f'{words} of the {section}' if section in ('laboratory', 'customer') else words


def _entry(section: str, name: str, value: object, where: str) -> str:
    if name in ('date', 'begin', 'end'):
        if type(value) is datetime.date:
            return value.isoformat()
        if isinstance(value, str):
            with suppress(ValueError):
                return datetime.date.fromisoformat(value).isoformat()
        raise InvalidData(f'{where}: expected a date such as 2026-04-12, found {value!r:.40}')
    if not isinstance(value, str):
        raise InvalidData(f'{where}: expected a text in quotes, found {value!r:.40}; without them YAML makes another '
                          'value '
                          'of it')
    text = ' '.join(value.split())
    most = LONGEST_REMARKS if name == 'remarks' or section == 'traceability' else LONGEST
    if len(text) > most or not text.isprintable():
        raise InvalidData(f'{where}: expected at most {most} printable characters, found {text!r:.60}')
    if name == 'country' and not re.fullmatch('[A-Z]{2}', text):
        raise InvalidData(f'{where}: expected two capital letters of ISO 3166-1 such as DE, found {text!r:.40}')
    if name == 'email' and not re.fullmatch(r'[^@\s]+@[^@\s]+\.[^@\s.]+', text):
        raise InvalidData(f'{where}: expected an address such as lab@example.org, found {text!r:.40}')
    if (section, name) == ('place', 'at') and text not in AT:
        raise InvalidData(f'{where}: expected one of {", ".join(AT)}, found {text!r:.40}')
    return text


def _tolerances(given: object, where: str) -> dict[str, str]:
    if not isinstance(given, dict):
        raise InvalidData(f'{where}: expected a mapping such as "EXC: 1.5 µm", found {given!r:.80}')
    found = {}
    for name, words in given.items():
        is_length = re.fullmatch('ct[xyz]|E[XYZ][ABC]', str(name))
        if not is_length and not re.fullmatch('cr[xyz]|E[ABC][ABC]', str(name)):
            raise InvalidData(f'{where}: expected the name of an error such as EXC or ctx, found {name!r:.40}; a C '
                              'axis '
                              'has EXC, EYC, EZC, EAC, EBC, ECC, any axis ctx … crz')
        _tolerance(words, bool(is_length), f'{where}: {name}')
        found[name] = ' '.join(words.split())
    return found


def _tolerance(words: object, is_length: bool, where: str) -> Tolerance:
    match = _TOLERANCE.fullmatch(words.strip()) if isinstance(words, str) else None
    spelt = ''.join(match[2].split()) if match else ''
    name = _SPELT.get(spelt, spelt)
    unit = (_LENGTHS if is_length else _ANGLES).get(name)
    if not match or not unit or not float(match[1]) > 0:
        comma = '; write a decimal point' if isinstance(words, str) and ',' in words else ''
        raise InvalidData(f'{where}: expected a positive {_OF_LENGTH if is_length else _OF_ANGLE}, found {words!r:.40}'
                          f'{comma}')
    return Tolerance(float(match[1]) * unit, match[1], name)
