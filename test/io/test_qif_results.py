# SPDX-License-Identifier: Apache-2.0
"""Results as QIF 3.0: what is in the document."""

import datetime
import re

import pytest
from lxml import etree

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.uncertainty.error_summary import Conformity
from rosette_ros.io.foreign import qif
from rosette_ros.io.identity_file import Identity, parse_identity
from rosette_ros.io.qdas_file import Characteristic
from rosette_ros.io.qif_results import NAMESPACE, format_qif

IDENTITY = parse_identity(b'schema: rosette-identity/1\ntable: {serial: RT-7}\noperator: N. & N.\n'
                          b'customer: {order: "12"}\nlaboratory: {name: Lab}\ncertificate: {number: "7"}\n')
RESULTS = (Characteristic('ctz EZC, range', 1.25e-5, 2.0, 'um', 3e-6, Conformity.CONFORMS),
           Characteristic('ctz, U (k = 2) of the range', 6e-6, None, 'um'),
           Characteristic('crz ECC, range', 123456.789, 1.0, 'urad', 0.5, Conformity.FAILS),
           Characteristic('crx EAC, range', 4.0, 4.1, 'urad', 0.5, Conformity.UNDECIDED))
WHEN = datetime.datetime(2026, 4, 12, 8, 30)
NAMES = {'q': NAMESPACE}


def root_of(results=RESULTS, identity=IDENTITY, when=WHEN):
    """Return the root of the document of results."""
    return etree.fromstring(format_qif(results, identity, 'run 1', when, 'The model fits: 0.1 µm < 1.').encode())


def texts(root, path):
    """Return the texts of a path."""
    return root.xpath(f'{path}/text()', namespaces=NAMES)


def test_a_characteristic_has_its_value_uncertainty_limit_and_decision():
    """Each from definition over nominal and item to its measurement; no number has an exponent."""
    root = root_of()
    values = root.xpath('//q:CharacteristicMeasurements/*/q:Value', namespaces=NAMES)
    assert [one.text for one in values] == ['0.0000125', '0.000006', '123456.789', '4']
    assert [one.get('combinedUncertainty') for one in values] == ['0.000003', None, '0.5', '0.5']
    assert texts(root, '//q:CharacteristicStatusEnum') == ['PASS', 'NOT_ANALYZED', 'FAIL', 'INDETERMINATE']
    assert set(texts(root, '//q:InspectionStatusEnum')) == {'FAIL'}
    assert texts(root, '//q:Tolerance/q:MaxValue') == ['2', '1', '4.1']
    assert texts(root, '//q:UnitName') == ['urad', 'um'] and texts(root, '//q:Factor') == ['0.000001'] * 2
    for place, one in enumerate(RESULTS):
        measured = root.xpath('//q:CharacteristicMeasurements/*', namespaces=NAMES)[place]
        [item] = root.xpath(f'//*[@id="{texts(measured, "q:CharacteristicItemId")[0]}"]')
        [nominal] = root.xpath(f'//*[@id="{texts(item, "q:CharacteristicNominalId")[0]}"]')
        [definition] = root.xpath(f'//*[@id="{texts(nominal, "q:CharacteristicDefinitionId")[0]}"]')
        assert texts(item, 'q:Name') == texts(nominal, 'q:Name') == texts(definition, 'q:WhatToMeasure') == [one.name]
    ids = list(map(int, root.xpath('//@id')))
    assert sorted(ids) == [*range(1, int(root.get('idMax')) + 1)]


def test_who_measured_what_when_is_stated():
    """As far as it is known; the same results have the same document id."""
    root = root_of()
    assert texts(root, '//q:SerialNumber') == ['RT-7'] and texts(root, '//q:InspectionOperator/q:Name') == ['N. & N.']
    assert texts(root, '//q:ReportNumber') == ['7'] and set(texts(root, '//q:TimeStamp')) == {'2026-04-12T08:30:00'}
    assert texts(root, '//q:Header/q:Description') == ['The model fits: 0.1 µm < 1.']
    bare = root_of(RESULTS[1:2], Identity(), None)
    assert texts(bare, '//q:SerialNumber') == ['run 1'] and not texts(bare, '//q:TimeStamp')
    assert texts(bare, '//q:InspectionStatusEnum') == ['NOT_CALCULATED'] * 2
    assert texts(root, 'q:QPId') == texts(root_of(), 'q:QPId') != texts(bare, 'q:QPId')
    assert re.fullmatch(r'[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}', texts(root, 'q:QPId')[0])


def test_results_are_no_readings():
    """The reader of foreign tables knows the document, and says that it has no measured spheres."""
    with pytest.raises(InvalidData, match='expected QIF results with measured spheres .*, found none'):
        qif.read(format_qif(RESULTS, IDENTITY, 'run 1', WHEN, 'The model fits.'), 'results.qif')
