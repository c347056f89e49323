# SPDX-License-Identifier: Apache-2.0
"""Identity files: what is read, what is missing, what is refused in which words."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import yaml

from rosette_ros.core.run.axes import rotation_of
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.identity_file import (
    REQUIRED,
    SECTIONS,
    Identity,
    format_identity,
    parse_identity,
    read_identity,
    words_of_entry,
)

HEAD = 'schema: rosette-identity/1\n'


def parsed(text):
    """Return the Identity of a file's lines below the schema."""
    return parse_identity((HEAD + text).encode(), 'who.yaml')


def test_entries_are_texts_by_section():
    """A section that has a name only may be that text; dates are dates; what is empty is not stated."""
    found = parsed('operator: A.  B.\n'
                   'certificate: {number: "7", date: 2026-04-12, remarks: }\ntable: {serial: "012"}\n')
    assert found.entries == {'operator.name': 'A. B.', 'certificate.number': '7', 'certificate.date': '2026-04-12',
                             'table.serial': '012'}
    assert found['cmm.serial'] == ''
    assert set(found.missing) == {*REQUIRED} - {'operator.name', 'certificate.number', 'table.serial'}
    assert words_of_entry('table.serial') == 'serial number of the rotary table'


def test_the_example_states_nothing():
    """Whoever copies it and fills in nothing has stated nothing; all of its sections exist."""
    path = Path(__file__).parents[2] / 'config' / 'identity.yaml'
    assert read_identity(path) == Identity()
    assert {*yaml.safe_load(path.read_text())} == {'schema', 'tolerances', *SECTIONS}


def test_what_is_written_is_read_again():
    """The text in a log is the file without its comments."""
    found = parsed('customer: {name: Größe & <Söhne>}\ntolerances: {EXC: 1.5 µm, crz: 0.4 arcsec}\n')
    assert parse_identity(format_identity(found).encode()) == found
    assert format_identity(Identity()) == ''


def test_a_file_takes_the_place_of_the_log_and_contradictions_are_told():
    """Entry by entry."""
    logged, later = parsed('table: {serial: A, model: M}'), parsed('table: {serial: B}\nsigner: C')
    found, changed = logged.with_changes(later)
    assert found.entries == {'table.serial': 'B', 'table.model': 'M', 'signer.name': 'C'}
    assert changed == ("table.serial: 'A' in the log, 'B' now",)


def test_tolerances_are_lengths_and_angles_of_the_errors_of_the_table():
    """Names follow the axis; an A axis has no EXC."""
    found = parsed('tolerances: {EXC: 1.5 µm, cty: 300 nm, ECC: 1 arcsec, EAC: 2 urad}')
    assert found.limits(None) == pytest.approx({'ctx': 1.5e-6, 'cty': 3e-7, 'crz': np.pi / 648000, 'crx': 2e-6})
    other = parsed('tolerances: {crx: 2e-6 rad, cry: 2 arc seconds, crz: "3\'\'", EXC: "2um"}')
    assert other.limits(None) == pytest.approx(
        {'crx': 2e-6, 'cry': np.pi / 324000, 'crz': np.pi / 216000, 'ctx': 2e-6})
    assert [(one.number, one.unit) for one in pickle.loads(pickle.dumps(other.limits(None))).values()] == [
        ('2e-6', 'rad'), ('2', 'arcsec'), ('3', 'arcsec'), ('2', 'µm')], 'as stated, in another process too'
    assert parsed('tolerances: {EXC: .3 µm, cty: 2. um}').limits(None) == pytest.approx({'ctx': 3e-7, 'cty': 2e-6})
    with pytest.raises(InvalidData, match=r'who\.yaml: tolerances: EXC: expected errors of this table, EYA, EZA, EXA, '
                                          'EBA, ECA, EAA, found one of another axis; ctx … crz go with any axis'):
        found.limits(rotation_of([1, 0, 0]))
    twice = parsed('tolerances: {EXC: 1 um, ctx: 2 um}')
    later = parse_identity(b'schema: rosette-identity/1\noperator: A', 'later.yaml')
    for one in (twice, twice.with_changes(later)[0], later.with_changes(twice)[0]):
        with pytest.raises(InvalidData, match=r'who\.yaml: tolerances: ctx: expected each error once, ctx stands '
                                              r'twice'):
            one.limits(None)


@pytest.mark.parametrize(('data', 'words'), [
    (b'', 'with "schema: rosette-identity/1", found nothing$'),
    (b'operator: A', 'with "schema: rosette-identity/1", found .*operator.*; add that line$'),
    (b'just words', "with .*, found 'just words'$"),
    (b'schema: rosette-budget/1', "with .*, found {'schema': 'rosette-budget/1'}$")])
def test_another_file_is_refused(data, words):
    """It is said which line makes an identity of it."""
    with pytest.raises(InvalidData, match=f'who.yaml: expected a mapping {words}'):
        parse_identity(data, 'who.yaml')


@pytest.mark.parametrize(('text', 'words'), [
    ('tabel: {serial: A}', "expected one of certificate, .*, found 'tabel'; did you mean 'table'?"),
    ('table: {serail: A}', "table: expected one of maker, .*, found 'serail'; did you mean 'serial'?"),
    ('table: RT 400', "table: expected a mapping of maker, model, serial, calibration, remarks, found 'RT 400'"),
    ('table: {serial: 123}', 'table.serial: expected a text in quotes, found 123; without them YAML'),
    ('table: {serial: 0123}', "line .: expected a number in decimal digits, without leading zeros, found '0123'"),
    ('laboratory: {country: NO}', 'laboratory.country: expected a text in quotes, found False'),
    ('laboratory: {country: Germany}', "laboratory.country: expected two capital letters of ISO 3166-1 such as DE"),
    ('laboratory: {email: nope}', "laboratory.email: expected an address such as lab@example.org, found 'nope'"),
    ('certificate: {date: 12.4.2026}', "certificate.date: expected a date such as 2026-04-12, found '12.4.2026'"),
    ('measured: {begin: 2026-04-12, end: 2026-04-11}', 'measured: expected an end after the begin 2026-04-12'),
    ('place: {name: R, at: home}', "place.at: expected one of laboratory, customer, other, found 'home'"),
    ('operator: "\\x1b[31m"', 'operator.name: expected at most 200 printable characters'),
    (f'operator: {"x" * 201}', 'operator.name: expected at most 200 printable characters'),
    ('tolerances: 5', 'tolerances: expected a mapping such as "EXC: 1.5 µm", found 5'),
    ('tolerances: {EXX: 1 um}', "tolerances: expected the name of an error such as EXC or ctx, found 'EXX'; a C axis"),
    ('tolerances: {EXC: 1.5}', 'tolerances: EXC: expected a positive length with its unit .*, such as "1.5 µm", found '
                               '1.5'),
    ('tolerances: {EXC: 1 urad}', 'tolerances: EXC: expected a positive length'),
    ('tolerances: {EXC: "1,5 µm"}', "tolerances: EXC: expected .*, found '1,5 µm'; write a decimal point"),
    ('tolerances: {ECC: 1 deg}', "tolerances: ECC: expected a positive angle with its unit .µrad, .*arcsec., .*'1 "
                                 "deg'"),
    ('tolerances: {EAC: 1 um}', 'tolerances: EAC: expected a positive angle'),
    ('tolerances: {EAC: 0 arcsec}', 'tolerances: EAC: expected a positive angle')])
def test_what_is_wrong_is_said(text, words):
    """One line: file, entry, what was wanted, what came."""
    with pytest.raises(InvalidData, match=f'who.yaml: {words}'):
        parsed(text)
