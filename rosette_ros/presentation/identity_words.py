# SPDX-License-Identifier: Apache-2.0
"""Who, what and where as people read it: what is stated, and what is missing."""

from collections.abc import Sequence

from rosette_ros.io.identity_file import DEVICES, SECTIONS, Identity, words_of_entry

NOT_STATED = 'not stated'
SIMULATED = 'SIMULATED: the readings are those of a simulated CMM; no real table was measured.'
NOTHING = 'Who, what and where are not stated: there is no identity file.'
_ADDRESS = ('name', 'street', 'postcode', 'city', 'country')


def identity_rows(identity: Identity, contradictions: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Return what is stated, as (name, text), [] where nothing is; contradictions: of log and file, in words."""
    if not identity.entries:
        return []
    rows = [('Certificate', identity['certificate.number']), ('Laboratory', contact(identity, 'laboratory')),
            ('Accreditation', identity['laboratory.accreditation']), ('Customer', contact(identity, 'customer')),
            ('Order no.', identity['customer.order']), ('Place', identity['place.name']),
            *conditions(identity), ('Traceability', identity['traceability.name']),
            ('Operator', identity['operator.name']), ('Signer', signer(identity)),
            *((f'{words[0].upper()}{words[1:]}', device(identity, name)) for name, words in DEVICES.items()),
            ('Remarks', identity['certificate.remarks']),
            ('Tolerances', ', '.join(f'{name} {words}' for name, words in identity.tolerances.items())),
            ('Contradiction', '; '.join(contradictions)),
            ('Not stated (ISO/IEC 17025)', ', '.join(map(words_of_entry, identity.missing)))]
    return [row for row in rows if row[1]]


def who_words(identity: Identity) -> str:
    """Return in a line which table, of which laboratory for which customer, '' where none of it is stated."""
    table = ' '.join(filter(None, (identity['table.maker'], identity['table.model'])))
    serial = f'No. {identity["table.serial"]}' if identity['table.serial'] else ''
    parts = (('Rotary table', ', '.join(filter(None, (table, serial)))), ('laboratory', identity['laboratory.name']),
             ('customer', identity['customer.name']))
    return '; '.join(f'{name} {words}' for name, words in parts if words)


def conditions(identity: Identity) -> list[tuple[str, str]]:
    """Return the conditions of measurement that no reading tells, as (name, text), '' for one that is not stated."""
    return [(f'{words[0].upper()}{words[1:]}', identity[f'conditions.{name}'])
            for name, words in SECTIONS['conditions'].items()]


def stated_days(identity: Identity) -> str:
    """Return the days of measuring that are stated, '' where none are."""
    begin, end = identity['measured.begin'], identity['measured.end']
    return f'not recorded; measured {begin}{f" to {end}" * (end not in ("", begin))}, as stated' if begin else ''


def simulated_words(simulated: Sequence[str], count: int) -> str:
    """Return the sentence of a page about those of `count` runs, by name, that were simulated, '' where none was."""
    names = 'the readings' if len(simulated) == count else f'the readings of {", ".join(simulated)}'
    return SIMULATED.replace('the readings', names) if simulated else ''


def contact(identity: Identity, section: str) -> str:
    """Return name and address of the laboratory or the customer, '' where nothing is stated."""
    stated = [words for entry in _ADDRESS if (words := identity[f'{section}.{entry}'])]
    return ', '.join(stated if identity[f'{section}.name'] or not stated else [f'name {NOT_STATED}', *stated])


def signer(identity: Identity) -> str:
    """Return name and role of the signer."""
    return ', '.join(filter(None, (identity['signer.name'], identity['signer.role'])))


def device(identity: Identity, name: str) -> str:
    """Return maker, model, serial number, calibration and remarks of a device."""
    words = {'serial': 'No. ', 'calibration': 'calibration '}
    parts = {entry: identity[f'{name}.{entry}'] for entry in ('maker', 'model', 'serial', 'calibration', 'remarks')}
    return ', '.join(f'{words.get(entry, "")}{value}' for entry, value in parts.items() if value)
