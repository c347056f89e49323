# SPDX-License-Identifier: Apache-2.0
"""Results for statistical process control as a QIF 3.0 document (ISO 23952): a characteristic for each error and its U.
"""

import datetime
import uuid
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from decimal import Decimal

from rosette_ros.core.run.number_words import ANGLES
from rosette_ros.core.uncertainty.error_summary import Conformity, worst_of
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.qdas_file import Characteristic

NAMESPACE = 'http://qifstandards.org/xsd/qif3'
_FACTORS = {'um': 1e-6, **{name: 1 / one.factor for name, one in ANGLES.items()}}
_STATUS = {Conformity.CONFORMS: 'PASS', Conformity.FAILS: 'FAIL', Conformity.UNDECIDED: 'INDETERMINATE',
           None: 'NOT_ANALYZED'}
_INSPECTION = {**_STATUS, Conformity.UNDECIDED: 'UNKNOWN', None: 'NOT_CALCULATED'}


def format_qif(characteristics: Sequence[Characteristic], identity: Identity, run_id: str,
               when: datetime.datetime | None, event: str) -> str:
    """Return results as a QIF 3.0 document: definition, nominal, item and measurement of each characteristic.

    combinedUncertainty is the standard uncertainty; arguments as of `format_dfq`."""
    standard, results, component, count = 1, 2, 3, len(characteristics)
    root = ET.Element('QIFDocument', {'xmlns': NAMESPACE, 'versionQIF': '3.0.0', 'idMax': str(component + 4 * count)})
    header = _part(root, 'Header')
    _part(_part(header, 'Application'), 'Name', 'rosette_ros')
    _part(header, 'Description', event)
    rules = _part(_part(root, 'StandardsDefinitions', n=1), 'Standard', id=standard)
    _part(_part(rules, 'Organization'), 'StandardsOrganizationEnum', 'ISO')
    _part(rules, 'Designator', '230-7')
    _state_units(_part(_part(root, 'FileUnits'), 'PrimaryUnits'), characteristics)
    every = _part(root, 'Characteristics')
    _part(every, 'FormalStandardId', standard)
    lists = [_part(every, f'Characteristic{name}', n=count) for name in ('Definitions', 'Nominals', 'Items')]
    whole = _part(root, 'Results')
    made = _part(_part(whole, 'MeasurementResultsSet', n=1), 'MeasurementResults', id=results)
    _state_traceability(_part(made, 'InspectionTraceability'), identity)
    lists.append(_part(_part(made, 'MeasuredCharacteristics'), 'CharacteristicMeasurements', n=count))
    for place, one in enumerate(characteristics):
        _add(one, lists, component + 4 * place, when)
    status = _INSPECTION[worst_of(one.conformity for one in characteristics)]
    _part(_part(made, 'InspectionStatus'), 'InspectionStatusEnum', status)
    _part(_part(made, 'ActualComponentIds', n=1), 'Id', component)
    table = _part(_part(_part(whole, 'ActualComponentSets', n=1), 'ActualComponentSet', n=1), 'ActualComponent',
                  id=component)
    _part(table, 'SerialNumber', identity['table.serial'] or run_id)
    _part(_part(table, 'Status'), 'InspectionStatusEnum', status)
    name = ET.Element('QPId')
    name.text = str(uuid.uuid5(uuid.NAMESPACE_URL, f'{run_id} {ET.tostring(root, "unicode")}'))  # of its content
    root.insert(0, name)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, "unicode")}\n'


def _add(one: Characteristic, lists: Sequence[ET.Element], last: int, when: datetime.datetime | None) -> None:
    """Add a characteristic to definitions, nominals, items and measurements; last: the last id that is used."""
    what = f'UserDefined{_kind(one)}Characteristic'
    definition, nominal, item, measured = (
        _part(parent, f'{what}{name}', id=last + place) for place, (parent, name) in enumerate(
            zip(lists, ('Definition', 'Nominal', 'Item', 'Measurement'), strict=True), 1))
    if one.limit is None:
        _part(definition, 'NonTolerance', 'MEASURED')
    else:
        tolerance = _part(definition, 'Tolerance')
        _part(tolerance, 'MaxValue', _number(one.limit))
        _part(tolerance, 'DefinedAsLimit', 'true')
    _part(definition, 'WhatToMeasure', one.name)
    _part(nominal, 'CharacteristicDefinitionId', last + 1)
    _part(nominal, 'Name', one.name)
    _part(item, 'Name', one.name)
    _part(item, 'CharacteristicNominalId', last + 2)
    _part(_part(measured, 'Status'), 'CharacteristicStatusEnum', _STATUS[one.conformity])
    _part(measured, 'CharacteristicItemId', last + 3)
    if when is not None:
        _part(measured, 'TimeStamp', f'{when:%Y-%m-%dT%H:%M:%S}')
    _part(measured, 'Value', _number(one.value), **(
        {} if one.u is None else {'combinedUncertainty': _number(one.u)}))


def _state_units(units: ET.Element, characteristics: Sequence[Characteristic]) -> None:
    """State the units of angles and of lengths, those of all values."""
    for kind, si in (('Angular', 'radian'), ('Linear', 'meter')):
        if unit := next((one.unit for one in characteristics if _kind(one) == kind), ''):
            made = _part(units, f'{kind}Unit')
            _part(made, 'SIUnitName', si)
            _part(made, 'UnitName', unit)
            _part(_part(made, 'UnitConversion'), 'Factor', _number(_FACTORS[unit]))


def _state_traceability(made: ET.Element, identity: Identity) -> None:
    """State who measured for whom, as far as it is known."""
    for entry, *path in (('laboratory.name', 'InspectingOrganization', 'Name'), ('customer.order', 'OrderNumber'),
                         ('certificate.number', 'ReportNumber'), ('operator.name', 'InspectionOperator', 'Name')):
        if identity[entry]:
            part = made
            for name in path:
                part = _part(part, name)
            part.text = identity[entry]


def _kind(one: Characteristic) -> str:
    return 'Linear' if one.unit == 'um' else 'Angular'


def _part(parent: ET.Element, name: str, text: object = '', **attributes: object) -> ET.Element:
    made = ET.SubElement(parent, name, {key: str(value) for key, value in attributes.items()})
    made.text = str(text) or None
    return made


def _number(value: float) -> str:
    """Return a number as xs:decimal, which has no exponent."""
    return f'{Decimal(f"{value:.9g}"):f}'
