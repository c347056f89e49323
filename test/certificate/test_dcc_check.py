# SPDX-License-Identifier: Apache-2.0
"""A certificate is compared with its run: sound ones agree, changed ones are refused in one line that says why."""

import contextlib
import functools
import os
import random
import re
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest
from certificates import DAYS, FULL, KINDS, made, table
from lxml import etree

from rosette_ros.certificate import dcc_check
from rosette_ros.certificate.dcc import earlier_digest, to_xml
from rosette_ros.certificate.dcc_check import parsed, verify_certificate
from rosette_ros.certificate.statements import Inputs, state
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.identity_file import parse_identity

pytestmark = pytest.mark.long

MUTATIONS = int(os.environ.get('FUZZ_EXAMPLES', 300))
"""So many changed documents; `make fuzz` takes more."""


def verified(kind, data=None, paths=None):
    """Verify a document, that of the kind if no other."""
    own, _, sound = made(kind)
    return verify_certificate(sound if data is None else data, 'cert.xml', paths or own)


@pytest.mark.parametrize('kind', KINDS)
def test_a_sound_certificate_agrees(kind):
    """Every number to the last bit on the same computer."""
    assert verified(kind) == dcc_check.Verified(0.0, False, '')


def test_it_agrees_wherever_the_data_are_and_whatever_they_are_called(tmp_path):
    """The name stays as it was when the certificate was made; the hash decides."""
    (path,), _, data = made('clean')
    copy = tmp_path / 'other.csv'
    shutil.copy(path, copy)
    assert verify_certificate(data, 'cert.xml', [copy]).largest == 0
    copy.write_text(f'{path.read_text()}\n')
    with pytest.raises(InvalidData, match='clean.csv: no file of the run has the SHA-256'):
        verify_certificate(data, 'cert.xml', [copy])


def test_a_table_with_a_plate_file_agrees(tmp_path):
    """Wherever both are; a plate file that was changed is another one."""
    folders = [tmp_path / name for name in ('made', 'copied')]
    for folder in folders:
        folder.mkdir()
        (folder / 'plate.yaml').write_text('schema: rosette-plate/1\nazimuth_deg: [0, 60, 120, 180, 240, 300]\n'
                                           'radius_mm: 182.5\n')
        for seed, name in enumerate(('one', 'two', 'three'), 1):
            text = table(f'plate_{name}', seed=seed).read_text()
            (folder / f'{name}.csv').write_text(text.replace(
                '# balls: 6', '# plate: plate.yaml\n# table_positions: 6', 1))
    first, other = ([folder / f'{name}.csv' for name in ('one', 'two', 'three')] for folder in folders)
    inputs = Inputs(parse_identity((FULL + DAYS).encode()), '2026-11-30', is_joint=True)
    for paths, found in ((first[:1], other[:1]), (first, other[::-1])):
        data = to_xml(state(paths, inputs))
        assert verify_certificate(data, 'cert.xml', found).largest == 0
    (folders[1] / 'plate.yaml').write_text((folders[0] / 'plate.yaml').read_text() + '# other\n')
    with pytest.raises(InvalidData, match='plate.yaml: no file of the run has the SHA-256'):
        verify_certificate(data, 'cert.xml', other)


def test_runs_may_be_named_in_any_order():
    """The document says which was the first."""
    paths, _, data = made('joint')
    assert verify_certificate(data, 'cert.xml', paths[::-1]).largest == 0


def test_white_space_and_a_signature_change_nothing():
    """A document that was indented anew and signed by another program; that it is signed is said."""
    signature = b'<ds:Signature xmlns:ds="http://www.w3.org/2000/09/xmldsig#"><a/></ds:Signature>'
    data = re.sub(rb'>\n *<', b'> <', made('clean')[2])
    assert verified('clean', data) == dcc_check.Verified(0.0, False, '')
    signed = data.replace(b'</dcc:digitalCal', signature + b'</dcc:digitalCal')
    assert verified('clean', signed).is_signed


@pytest.mark.parametrize(('old', 'new', 'words'), [
    (b'>T-0815<', b'>T-0816<', "item/identifications/identification/value: 'T-0816', from the run 'T-0815'"),
    (b'>pass<', b'>fail<', "conformity: 'fail', from the run 'pass'"),
    (b'>2026-04-12<', b'>2026-04-11<', "coreData/beginPerformanceDate: '2026-04-11', from the run '2026-04-12'"),
    (b'<dcc:model>T5</dcc:model>', b'', 'measuringEquipment: has 3 parts, from the run 4'),
    (b'<si:coverageFactor>2<', b'<si:coverageFactor>3<', "coverageFactor: '3', from the run '2'"),
    (b'refType="rosette_ctx"', b'refType="rosette_cty"', 'list/rosette_ctx: is another element'),
    (b'SIMULATED: error', b'error', "name/content: 'error motions of the table', from the run 'SIMULATED: error"),
    (b'<rosette:inputs', b'<rosette:nothing', 'the element rosette:inputs, from which it is made again, is missing')])
def test_what_was_changed_is_said(old, new, words):
    """Identity, conformity, day, equipment, coverage factor, curve, simulated, what it is made again from."""
    data = made('clean')[2]
    assert old in data
    data = data.replace(old, new, 1).replace(b'</rosette:inputs', b'</rosette:nothing' if b'nothing' in new else
                                             b'</rosette:inputs')
    with pytest.raises(InvalidData, match=re.escape(words)) as refused:
        verified('clean', data)
    assert str(refused.value).startswith(f'cert.xml: expected the certificate of {made("clean")[0][0]} as it was '
                                         'issued, found that it is not: its content was changed after it was made (its '
                                         'own SHA-256 differs)')


def test_inputs_of_the_budget_that_were_changed_are_told():
    """All lines follow from them; what is no input any more is refused in its words."""
    data = made('budget')[2]
    wrong = data.replace(b'"form_um": 0.13', b'"form_um": 0.12', 1)
    with pytest.raises(InvalidData, match=r'its own SHA-256 differs.*; .*value \d is '):
        verified('budget', wrong)
    with pytest.raises(InvalidData, match='ball_form: form_um: expected a positive number, found -1'):
        verified('budget', data.replace(b'"form_um": 0.13', b'"form_um": -1', 1))


def test_a_number_that_was_changed_is_named():
    """The value, which one of the curve; 1e-12 m are nothing, more is."""
    data = made('clean')[2]
    begin = data.index(b'<si:valueXMLList>', data.index(b'refType="rosette_ctz"')) + len(b'<si:valueXMLList>')
    first = data[begin:data.index(b' ', begin)]
    for change, is_told in ((0.5e-6, False), (2e-6, True)):
        wrong = data[:begin] + repr(float(first) + change).encode() + data[begin + len(first):]
        with pytest.raises(InvalidData) as refused:
            verified('clean', wrong)
        assert ('rosette_ctz/realListXMLList/valueXMLList: value 1 is ' in str(refused.value)) == is_told


def test_the_certificate_of_another_run_is_refused():
    """Its hash is told first."""
    with pytest.raises(InvalidData, match=r'found that it is not: clean.csv: no file of the run has the SHA-256 '
                                          r'\w{12}… that the certificate states; '):
        verified('clean', paths=made('without_temperatures')[0])


def test_a_run_that_is_not_there_says_nothing_of_the_certificate():
    """Which was called another one."""
    with pytest.raises(InvalidData, match='^no_such.csv: expected a log directory'):
        verified('clean', paths=['no_such.csv'])


def test_another_version_is_compared_by_its_numbers(monkeypatch):
    """Words may be others then; the hash and the numbers may not."""
    monkeypatch.setattr(dcc_check, '__version__', '9.9')
    assert verified('clean').programs == 'rosette_ros 0.1.0'
    with pytest.raises(InvalidData, match='its content was changed'):
        verified('clean', made('clean')[2].replace(b'>T-0815<', b'>T-0816<', 1))


@pytest.mark.parametrize(('data', 'words'), [
    (b'', 'expected a DCC, found what is no XML: '), (b'<a', 'expected a DCC, found what is no XML: '),
    (b'<a/>', "found the element 'a'; the order is --verify CERTIFICATE RUN"),
    (b'\x00\xff', 'expected a DCC, found what is no XML: '),
    (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', 'found one with a document type or entities of its own'),
    (b'<!DOCTYPE a SYSTEM "file:///etc/hostname"><a/>', 'found one with a document type or entities of its own'),
    (b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/hostname">]><a>&b;</a>', 'entities of its own'),
    (b'<?xml version="1.0" encoding="no-such-thing"?><a/>', 'expected a DCC, found what is no XML: '),
    (b'%PDF-1.4', 'expected a DCC, found a PDF; take the XML that is attached to it'),
    (b'<a>' * 300 + b'</a>' * 300, 'expected a DCC, found what is no XML: '),
    (b' ' * ((16 << 20) + 1), 'expected a DCC of at most 16777216 bytes, found more')])
def test_what_is_no_certificate_is_refused(data, words):
    """Nothing is fetched, no entity is replaced, nothing deep or large is read."""
    with pytest.raises(InvalidData, match=f'cert.xml: {words}|{words}') as refused:
        parsed(data, 'cert.xml')
    assert '\n' not in str(refused.value)


def test_what_another_library_writes_again_is_the_same():
    """Other prefixes, a default namespace, attributes in another order, a stylesheet, comments, hints of schemas."""
    sound = made('clean')[2]
    own = re.sub(rb'(</?)dcc:', rb'\1', sound).replace(b'xmlns:dcc=', b'xmlns=')
    assert b'<measurementResults>' in own
    by_library = ET.tostring(ET.fromstring(sound))
    assert b'<ns0:' in by_library
    swapped = re.sub(rb'(<rosette:content)( xmlns:rosette="[^"]*")( form="[^"]*")( sha256="[^"]*")',
                     rb'\1\4\3\2', sound)
    assert swapped != sound
    hint = b' xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:schemaLocation="https://ptb.de/dcc x.xsd"'
    dressed = sound.replace(b'?>\n<dcc', b'?>\n<?xml-stylesheet href="x.xsl"?><!-- one -->\n<dcc', 1)
    dressed = dressed.replace(b' schemaVersion=', hint + b' schemaVersion=', 1)
    dressed = dressed.replace(b'<dcc:administrativeData>', b'<dcc:administrativeData><!-- two -->', 1)
    for data in (own, by_library, swapped, dressed):
        assert verified('clean', data) == dcc_check.Verified(0.0, False, '')
        with pytest.raises(InvalidData, match='its content was changed after it was made'):
            verified('clean', data.replace(b'T-0815', b'T-0816'))


def test_a_certificate_of_an_earlier_version_is_told_as_such():
    """Its digest counts prefixes: as it was issued it agrees, written again it is not called changed."""
    root = etree.fromstring(made('clean')[2])
    own = root.find('{*}comment/{*}content')
    del own.attrib['form']
    own.set('sha256', earlier_digest(root))
    data = etree.tostring(root)
    assert verified('clean', data) == dcc_check.Verified(0.0, False, '', is_earlier=True)
    with pytest.raises(InvalidData, match='found that it is not: an earlier version made it, whose own SHA-256 is'):
        verified('clean', ET.tostring(ET.fromstring(data)))


def mutated(data, rng):
    """Return a document with one change: bytes, a piece, a tag, a number, an order."""
    at, more = rng.randrange(len(data)), rng.randrange(1, 40)
    kind = rng.randrange(7)
    if kind == 0:
        return data[:at] + bytes([rng.randrange(256)]) + data[at + 1:]
    if kind == 1:
        return data[:at] + data[at + more:]
    if kind == 2:
        return data[:at] + data[at:at + more] + data[at:]
    if kind == 3:
        return data[:at] + rng.choice([b'<!-- x -->', b'&amp;', b'<a/>', b'\x00', b'0', '−'.encode(), b'<![CDATA[]]>',
                                       b'&#0;', b'&x;', b'<?x?>', b'9' * 400, b'nan', b'1e999']) + data[at:]
    if kind == 4:
        words = [found.span() for found in re.finditer(rb'[\w.+-]+', data)]
        begin, end = rng.choice(words)
        return data[:begin] + rng.choice([b'0', b'-1', b'', b'inf', b'x', data[slice(*rng.choice(words))]]) + data[end:]
    if kind == 5:
        lines = data.split(b'\n')
        one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[one], lines[other] = lines[other], lines[one]
        return b'\n'.join(lines)
    return data[:at]


@pytest.mark.parametrize(('kind', 'share'), [('clean', 0.4), ('two_effects', 0.2), ('joint', 0.2), ('budget', 0.2)])
def test_changed_documents_are_refused_in_one_line(kind, share, monkeypatch):
    """Whatever is changed, and nothing but an InvalidData, but for what says the same in canonical form."""
    paths, certificate, sound = made(kind)
    rng, again = random.Random(1), functools.cache(lambda: state(paths, certificate.inputs))
    same = dcc_check.content_digest(parsed(sound, 'sound'))

    def stated(given, inputs):  # the run is evaluated once, as long as it is to be evaluated alike
        return again() if replace(inputs, files={}) == certificate.inputs else state(given, inputs)

    def says_the_same(data):  # a comment, for one, says nothing
        with contextlib.suppress(InvalidData):
            root = parsed(data, 'changed')
            own = root.find('{*}comment/{*}content')
            return own is not None and dcc_check.content_digest(root) == same == own.get('sha256')
        return False
    monkeypatch.setattr(dcc_check, 'state', stated)
    for _ in range(int(share * MUTATIONS)):
        data = next(one for one in iter(lambda: mutated(sound, rng), None) if not says_the_same(one))
        with pytest.raises(InvalidData) as refused:
            verify_certificate(data, 'cert.xml', paths)
        assert '\n' not in str(refused.value) and len(str(refused.value)) < 1500
