# SPDX-License-Identifier: Apache-2.0
"""The DCC: valid by PTB's schema, by the rules of its Schematron, and it says what the run says.

The schema is not part of the project: ROSETTE_DCC_XSD names dcc.xsd, else ../shared/dcc beside the project is taken."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from certificates import BUDGET, DAYS, FULL, KINDS, made, own_budget, table
from lxml import etree
from schematron import Schematron

from rosette_ros.analysis import result
from rosette_ros.certificate.dcc import to_xml, unit_of
from rosette_ros.certificate.statements import Inputs, release, state
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.uncertainty.error_summary import Conformity
from rosette_ros.io.budget_file import read_stated, refuse_examples
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.formatting import model_words, residual_words

XSD = Path(os.environ.get('ROSETTE_DCC_XSD') or Path(__file__).parents[3] / 'shared' / 'dcc' / 'v3.3.0' / 'dcc.xsd')
NAMES = {'dcc': 'https://ptb.de/dcc', 'si': 'https://ptb.de/si'}


def root_of(kind):
    """Return the document of a kind of run, parsed."""
    return etree.fromstring(made(kind)[2])


def texts(root, path):
    """Return the texts at an XPath."""
    return [one if isinstance(one, str) else one.text for one in root.xpath(path, namespaces=NAMES)]


@pytest.fixture(scope='module')
def schema():
    """Return PTB's schema, read without a network."""
    if not XSD.is_file():
        pytest.skip(f'expected the DCC schema at ROSETTE_DCC_XSD or {XSD}, found none')
    return etree.XMLSchema(etree.parse(XSD, etree.XMLParser(no_network=True)))


@pytest.mark.parametrize('kind', KINDS)
def test_it_is_valid(kind, schema):
    """Clean, two effects, incomplete, joint, simulated, without temperatures, next to nothing stated."""
    schema.assertValid(root_of(kind))


def test_the_schema_sees_what_is_wrong(schema):
    """A coverage probability above one."""
    assert not schema.validate(etree.fromstring(made('clean')[2].replace(b'>0.95<', b'>1.2<')))


@pytest.fixture(scope='module')
def rules():
    """Return PTB's rules beyond the schema, which lie above it or beside it."""
    found = [path for folder in XSD.parents[:2] if (path := folder / 'dcc.sch').is_file()]
    if not found:
        pytest.skip(f'expected the Schematron rules dcc.sch beside {XSD} or in the folder above, found none')
    return Schematron(found[0])


@pytest.mark.parametrize('kind', KINDS)
def test_it_obeys_the_rules_beyond_the_schema(kind, rules):
    """No error and no warning of 47 rules; each result is told to have methods, software and conditions."""
    assert rules.rules >= 47
    told = rules.told(root_of(kind))
    assert [one for one in told if one.role != 'information'] == []
    assert len(told) == 3 * len(made(kind)[1].sets)


def test_the_rules_see_what_is_wrong(rules):
    """Each change of a sound document is told by its rule."""
    document, wanted = made('clean')[2], []
    for old, new, words in (
            (rb'<dcc:release>v', rb'<dcc:release>', 'Invalid release version format'),
            (rb'"en">', rb'"de">', 'Invalid language code'),
            (rb'<dcc:usedMethods>.*</dcc:usedMethods>', rb'', 'Missing measurement methods'),
            (rb'<dcc:usedSoftware>.*</dcc:usedSoftware>', rb'', 'Software information missing'),
            (rb'(<dcc:endPerformanceDate>)2026', rb'\g<1>2025', 'Invalid date range'),
            (rb'(<dcc:countryCodeISO3166_1>)DE', rb'\g<1>XX', 'country code'),
            (rb'<dcc:item>', rb'<dcc:item id="lonely">', 'Unlinked ID'),
            (rb'<dcc:customer>', rb'<dcc:customer refId="nobody">', 'Invalid reference ID'),
            (rb'(<si:valueXMLList>\S+) ', rb'\g<1>  ', 'Invalid list formatting'),
            (rb'(<si:unit>)', rb'\g<1>\\one ', 'Units cannot contain spaces')):
        document, count = re.subn(old, new, document, count=1, flags=re.DOTALL)
        assert count == 1, old
        wanted.append(words)
    told = ' '.join(one.words for one in rules.told(etree.fromstring(document)) if one.role in ('error', 'warning'))
    assert [words for words in wanted if words not in told] == []


@pytest.mark.parametrize('kind', KINDS)
def test_texts_are_whole(kind):
    """None is empty or has space around it; equipment stands in every result; a list of U is as long as its values."""
    root = root_of(kind)
    assert all(words.strip() == words and words for words in texts(root, '//dcc:content'))
    assert all(result.find('dcc:measuringEquipments', NAMES) is not None
               for result in root.iterfind('.//dcc:measurementResult', NAMES))
    for one in root.iterfind('.//si:realListXMLList', NAMES):
        values, spread = (one.findtext(f'.//si:{name}', '', NAMES).split()
                          for name in ('valueXMLList', 'valueExpandedMUXMLList'))
        assert len(spread) in (0, len(values))


@pytest.mark.parametrize('kind', ['clean', 'incomplete', 'simulated'])
def test_curves_are_those_of_the_run(kind):
    """Equal to the last bit, with U (k = 2); angles in degrees."""
    (path,), _, _ = made(kind)
    motions, root = result(open_run(path)).curves.motions, root_of(kind)
    [curves] = root.xpath('//dcc:result[@refType="rosette_curves"]', namespaces=NAMES)

    def numbers(key, name):
        quantity = curves.find(f'.//dcc:quantity[@refType="rosette_{key}"]', NAMES)
        return np.array(quantity.findtext(f'.//si:{name}', '', NAMES).split(), dtype=float)
    assert np.array_equal(numbers('angle', 'valueXMLList'), np.rad2deg(motions.angle))
    for curve in CURVES:
        assert np.abs(numbers(curve, 'valueXMLList') * 1e-6 - motions[curve]).max() < 1e-12
        assert np.abs(numbers(curve, 'valueExpandedMUXMLList') * 1e-6 - 2 * motions.uncertainty(curve)).max() < 1e-12


def test_the_budget_is_that_of_the_run():
    """Its lines add up in squares to u; U of the curves is twice that of each point; inputs have their units."""
    certificate, root = made('budget')[1], root_of('budget')
    [result] = root.xpath('//dcc:result[@refType="rosette_budget"]', namespaces=NAMES)

    def numbers(kind):
        return np.hstack([np.array([one.findtext('.//si:valueXMLList', '', NAMES).split() for one in result.iterfind(
            f'.//dcc:quantity[@refType="rosette_budget_{kind}_{part}"]', NAMES)], dtype=float)
            for part in ('translations', 'rotations')])
    lines, u, expanded = (numbers(kind) for kind in ('contribution', 'u', 'U'))
    names = texts(result, './dcc:data/dcc:list/dcc:name/dcc:content')
    assert names[:-1] == [one.name for one in certificate.budget.contributions] and len(lines) == len(names) - 1 >= 9
    np.testing.assert_allclose((lines**2).sum(axis=0), u[0]**2, rtol=1e-12)
    np.testing.assert_allclose(expanded, 2 * u, rtol=1e-15)
    stated = {name: (float(value), unit) for name, value, unit in zip(names, *(texts(
        result, f'.//dcc:quantity[@refType="rosette_budget_input"]//si:{tag}') for tag in ('value', 'unit')))}
    assert stated['radius'] == (1e-6, r'\metre')
    assert stated['temperature: plate'] == (1e-6, r'\kelvin\tothe{-1}')
    [curve] = root.xpath('//dcc:quantity[@refType="rosette_crz"]', namespaces=NAMES)
    spread = np.array(curve.findtext('.//si:valueExpandedMUXMLList', '', NAMES).split(), dtype=float)
    np.testing.assert_allclose(spread, 2e6 * certificate.budget.combined()[:, 5], rtol=1e-12)
    assert any(words.startswith('U (k = 2, about 95 %) is that of the uncertainty budget')
               for words in texts(root, '//dcc:statement//dcc:content'))


def test_what_was_compensated_has_its_size():
    """The effects in the model, each parameter with U in its unit; without effects there is no such result."""
    certificate, root = made('two_effects')[1], root_of('two_effects')
    [result] = root.xpath('//dcc:result[@refType="rosette_effects"]', namespaces=NAMES)
    assert texts(result, './dcc:data/dcc:list/dcc:name/dcc:content') == [
        'linear probe drift (frame_drift)', 'warping of the plate (plate_warp)']
    for one, told in zip(certificate.compensated, result.iterfind('.//dcc:list', NAMES), strict=True):
        assert texts(told, './dcc:quantity/dcc:name/dcc:content') == [each.name for each in one.parameters]
        for kind, wanted in (('value', [1e6 * each.value for each in one.parameters]),
                             ('valueExpandedMU', [2e6 * each.u for each in one.parameters])):
            np.testing.assert_allclose(np.array(texts(told, f'.//si:{kind}'), dtype=float), wanted, rtol=1e-12)
        assert {*texts(told, './/si:unit')} == {r'\micro\metre\second\tothe{-1}'}
    assert not root_of('clean').xpath('//dcc:result[@refType="rosette_effects"]', namespaces=NAMES)


@pytest.mark.parametrize(('unit', 'wanted'), [
    ('m', (r'\micro\metre', 1e6)), ('rad/K', (r'\micro\radian\kelvin\tothe{-1}', 1e6)), ('s', (r'\second', 1.0)),
    ('m/s^2', (r'\micro\metre\second\tothe{-2}', 1e6)), ('1/K', (r'\kelvin\tothe{-1}', 1.0)), ('', (r'\one', 1.0)),
    ('m/m/K', (r'\micro\metre\metre\tothe{-1}\kelvin\tothe{-1}', 1e6)), ('1', (r'\one', 1.0)),
    ('m/reading', (r'\micro\metre', 1e6)), ('reading', (r'\one', 1.0))])
def test_units_of_parameters(unit, wanted):
    assert unit_of(unit) == wanted


def test_words_of_the_example_go_into_no_certificate():
    """config/budget.yaml, used as it is, would state a Zerodur plate."""
    with pytest.raises(InvalidData, match='b.yaml: expected words that say whence the numbers of this cell are, found '
                                          'those of the example in ball_form, plate_expansion'):
        refuse_examples(read_stated(BUDGET), 'b.yaml')
    refuse_examples(read_stated(own_budget()), 'b.yaml')
    refuse_examples(None, 'b.yaml')


def test_few_readings_do_not_give_95_percent(schema):
    """9 ball centres leave 4 degrees of freedom: U (k = 2) contains the true value with 88 %, by Student's t."""
    path = table('three', n=3, change=lambda run: run.replace(repeatability=None, repeatability_dof=None))
    certificate = state([path], Inputs(parse_identity((FULL + DAYS).encode()), '2026-11-30'))
    root = etree.fromstring(to_xml(certificate))
    schema.assertValid(root)
    [curve] = root.xpath('//dcc:quantity[@refType="rosette_crz"]', namespaces=NAMES)
    assert set(curve.findtext('.//si:coverageProbabilityXMLList', '', NAMES).split()) == {'0.88'}
    assert curve.findtext('.//si:distributionXMLList', '', NAMES) == "Student's t"
    assert any(words.startswith('U (k = 2, about 88 %)') for words in certificate.unknown)


def test_without_inputs_the_budget_says_what_is_not_considered():
    """U is that of evaluate; form of the balls and the like are named as missing; several runs have no budget."""
    words = texts(root_of('clean'), '//dcc:statement//dcc:content')
    assert any('form of the balls (ball_form)' in one for one in words)
    assert root_of('clean').xpath('//dcc:result[@refType="rosette_budget"]', namespaces=NAMES)
    assert not root_of('joint').xpath('//dcc:result[@refType="rosette_budget"]', namespaces=NAMES)
    with pytest.raises(InvalidData, match='the section environment only with several runs as one, found ball_form'):
        state(made('joint')[0], replace(made('joint')[1].inputs, budget=made('budget')[1].inputs.budget))


def test_verdicts_are_as_decided():
    """Conforms, not decidable although beyond the tolerance, no tolerance."""
    root, (curves,) = root_of('clean'), made('clean')[1].sets
    wanted = [{Conformity.CONFORMS: 'pass', Conformity.FAILS: 'fail'}.get(
        line.conformity, 'conditionalPass' if line.range <= line.tolerance else 'conditionalFail')
        for line in curves.lines if line.tolerance]
    assert texts(root, '//dcc:conformity') == wanted and {'pass', 'conditionalFail'} <= {*wanted}
    assert not root.xpath('//dcc:quantity[@refType="rosette_cry_tolerance"]', namespaces=NAMES)
    assert any('guard band U (k = 2)' in words for words in texts(root, '//dcc:statement//dcc:content'))


def test_nothing_is_decided_where_the_model_fails():
    """The run that lacks an effect: no conformity in a word or a field, the reason, and which curves they are."""
    root = root_of('incomplete')
    declared = texts(root, '//dcc:metaData//dcc:content')
    assert texts(root, '//dcc:conformity') == [] and not any('Conformity is decided' in words for words in declared)
    assert any(words.startswith('not stated: the model lacks what was found') for words in declared)
    assert any(words.startswith('all explanations averaged') for words in declared)
    certificate = made('incomplete')[1]
    said, found = dict(certificate.evaluation), result(open_run(made('incomplete')[0][0]))
    assert said['Model'] == model_words(found.curves.fit.model) != model_words(found.fit.model)
    assert said['Residual'] == residual_words(found.curves.fit), 'model and residual are of one fit'
    assert said['Result'].endswith(model_words(found.fit.model)), 'and the model that was given is told'
    assert any(words.startswith('3 missing') for words in texts(root, '//dcc:declaration/dcc:content'))


def test_who_and_what_stand_where_they_belong():
    """Laboratory, customer, signer, table, equipment, place, order number; letters of any kind."""
    root = root_of('clean')
    for path, words in (
            ('//dcc:calibrationLaboratory/dcc:contact/dcc:name/dcc:content', 'Messlabor Süd'),
            ('//dcc:calibrationLaboratoryCode', 'D-K-00000'), ('//dcc:customer/dcc:name/dcc:content', 'Drehtisch AG'),
            ('//dcc:uniqueIdentifier', '2026-0413'), ('//dcc:issueDate', '2026-11-30'),
            ('//dcc:respPerson[dcc:mainSigner="true"]/dcc:person/dcc:name/dcc:content', 'B. Leiter'),
            ('//dcc:item/dcc:identifications/dcc:identification/dcc:value', 'T-0815'),
            ('//dcc:coreData/dcc:identifications/dcc:identification/dcc:value', '4711'),
            ('//dcc:measuringEquipment[dcc:model="T5"]/dcc:manufacturer/dcc:name/dcc:content', 'Taster'),
            ('//dcc:usedMethod/dcc:link', 'https://doi.org/10.1016/j.measurement.2019.107366')):
        assert texts(root, path)[0] == words, path
    assert 'Clamped as in use & <tested>.' in texts(root, '//dcc:declaration/dcc:content')
    assert (texts(root, '//dcc:beginPerformanceDate'), texts(root, '//dcc:endPerformanceDate')) == (
        ['2026-04-12'], ['2026-04-13'])


def test_without_a_radial_place_it_is_that_of_the_balls():
    """In the document as on the pages; what is stated counts."""
    name, place = 'Radial place of the measurement', 'on the circle of the ball centres, R = 182.5 mm'
    said = root_of('clean').xpath(f'//dcc:influenceCondition[dcc:name/dcc:content="{name}"]', namespaces=NAMES)
    assert texts(said[0], './/dcc:data//dcc:content') == [place]
    assert dict(made('clean')[1].conditions)[name] == dict(made('joint')[1].conditions)[name] == place
    stated = parse_identity((FULL + DAYS).replace('conditions: {', 'conditions: {radial: "R = 50 mm", ').encode())
    assert dict(state(made('clean')[0], Inputs(stated, '2026-11-30')).conditions)[name] == 'R = 50 mm'


def test_what_is_missing_is_listed_and_not_made_up():
    """26 of 28 entries; names and numbers are `not stated`."""
    root = root_of('bare')
    stated = texts(root, '//dcc:statement[dcc:name/dcc:content="missing mandatory data (ISO/IEC 17025, 7.8.2)"]'
                   '/dcc:declaration/dcc:content')
    assert len(stated) == 26 and 'serial number of the rotary table: not stated.' in stated
    assert texts(root, '//dcc:item/dcc:identifications/dcc:identification/dcc:value') == ['not stated']
    assert texts(root, '//dcc:customer/dcc:location//dcc:content') == ['address not stated']
    assert texts(root, '//dcc:performanceLocation') == ['other']


@pytest.mark.parametrize('kind', [*KINDS, 'rounded', 'no_fit'])
def test_it_gives_no_advice(kind):
    """A certificate states results: no command, no advice; what the order of measurement cannot show is stated."""
    words = [words for words in texts(root_of(kind), '//dcc:content') if words]
    advice = r'Advice|(?<!-)rosette [a-z]|--[a-z]|(?i:(^|[;:,.] )(add|check|measure|give|diagnose|declare|correct) )'
    assert [one for one in words if re.search(advice, one)] == []
    if kind == 'rounded':
        assert any(one.startswith('This run could not have shown ') for one in words)
        assert 'Readings are rounded to 1 µm, more than the repeatability of 0.10 µm.' in words
    if kind == 'no_fit':
        assert any('one model does not fit' in one for one in words)


def test_a_real_run_does_not_say_that_it_is_simulated():
    """A table without that line in its heading."""
    (path,), certificate, _ = made('clean')
    real = path.with_name('real.csv')
    real.write_text('\n'.join(line for line in path.read_text().splitlines() if 'simulated' not in line))
    assert b'SIMULATED' not in to_xml(state([real], certificate.inputs))


@pytest.mark.parametrize('kind', KINDS)
def test_simulated_runs_say_so(kind):
    """In a statement, the name of the table and of the result; a table of a simulated machine tells it, too."""
    root = root_of(kind)
    assert made(kind)[1].is_simulated
    for path in ('//dcc:statement/dcc:name/dcc:content', '//dcc:item/dcc:name/dcc:content',
                 '//dcc:measurementResult/dcc:name/dcc:content'):
        assert any('SIMULATED' in words for words in texts(root, path))


def test_several_runs_have_one_document():
    """Curves of both senses of turning, conditions of each run, a hash of each file, the asynchronous part."""
    paths, certificate, _ = made('joint')
    root = root_of('joint')
    assert len(root.findall('.//dcc:measurementResult', NAMES)) == len(certificate.sets) == 2
    assert texts(root, '//dcc:metaData[@refType="rosette_file"]/dcc:reference')[:2] == [path.name for path in paths]
    assert root.xpath('//dcc:quantity[@refType="rosette_ctx_asynchronous"]', namespaces=NAMES)
    assert {'Sequence of first', 'Sequence of second'} <= {
        *texts(root, '//dcc:influenceCondition/dcc:name/dcc:content')}


def test_a_tolerance_is_the_decimal_number_that_was_given():
    """In micrometres: 350 nm are 0.35, not the product of binary numbers."""
    given = ('0.35 um', '350 nm', '1.1 um', '70 nm', '0.00007 mm', '123.4567891 nm')
    wanted = ('0.35', '0.35', '1.1', '0.07', '0.07', '0.1234567891')
    for words, number in zip(given, wanted, strict=True):
        text = FULL.replace('EXC: 50 µm', f'EXC: {words}') + DAYS
        stated = state(made('clean')[0], Inputs(parse_identity(text.encode()), '2026-11-30'))
        found = etree.fromstring(to_xml(stated)).xpath(
            '//dcc:quantity[@refType="rosette_ctx_tolerance"]//si:value/text()', namespaces=NAMES)
        assert found == [number]


def test_the_name_of_a_run_is_stated_as_it_is():
    """Also where it begins a sentence."""
    paths = table('straight', 'diagonal', 1, 8), table('turned', 'diagonal', 1, 8, clamping={'plate_turn_deg': 90.0})
    certificate = state(paths, made('joint')[1].inputs)
    words, = (one for one in certificate.unknown if 'the plate was turned' in one)
    assert words == ('turned: the deviations of the balls show that the plate was turned by 90° against straight.')


def test_temperatures_are_conditions_or_said_to_be_missing():
    """Lowest, highest and mean in degrees Celsius, or the words."""
    assert len(root_of('clean').xpath('//si:unit[text()="\\degreecelsius"]', namespaces=NAMES)) == 3
    for kind in ('without_temperatures', 'zero_temperatures'):
        cold = root_of(kind)
        assert not cold.xpath('//si:unit[text()="\\degreecelsius"]', namespaces=NAMES)
        assert 'The temperature was not measured.' in texts(cold, '//dcc:statement//dcc:content')
        assert not any('0 °C' in one for one in texts(cold, '//dcc:content'))


@pytest.mark.parametrize(('text', 'words'), [
    ('operator: A', 'certificate: expected certificate number, country.* of the laboratory, first day of measuring, '
                    'last '
                    'day of measuring, found none; state certificate.number, laboratory.country, measured.begin'),
    ('certificate: {number: X}\nlaboratory: {country: DE}', 'expected first day of measuring'),
    ('certificate: {number: X}\ntolerances: {EXA: 1 um}', 'tolerances: EXA: expected errors of this table')])
def test_what_no_document_can_do_without_is_asked_for(text, words):
    """One line, with the entries to state."""
    with pytest.raises(InvalidData, match=words):
        state(made('clean')[0], Inputs(parse_identity(f'schema: rosette-identity/1\n{text}\n'.encode()), '2026-11-30'))


def test_days_of_the_log_count():
    """An identity file with another one is refused."""
    inputs = Inputs(parse_identity((FULL + 'measured: {begin: 2020-01-01}').encode()),
                    '2026-11-30')
    with pytest.raises(InvalidData, match='measured.begin: the log says 2026-11-22, the identity file 2020-01-01'):
        state(made('simulated')[0], inputs)


def test_a_day_of_issue_comes_after_the_measurement():
    """A day may be of another time zone; two are a mistake."""
    def dated(day):
        identity = FULL.replace('date: 2026-11-30', f'date: {day}') + DAYS
        return state(made('clean')[0], Inputs(parse_identity(identity.encode()), day))
    assert dated('2026-04-12').days == ('2026-04-12', '2026-04-13')
    with pytest.raises(InvalidData, match='certificate.date: expected a day of issue after the measurement, which '
                                          'ended '
                                          '2026-04-13, found 2026-04-11; correct it in the identity file'):
        dated('2026-04-11')
    undated = FULL.replace(', date: 2026-11-30', '') + 'measured: {begin: 2036-11-26, end: 2036-11-26}\n'
    with pytest.raises(InvalidData, match='measured.end: expected a day of measuring before that of issue, 2026-11-30'):
        state(made('clean')[0], Inputs(parse_identity(undated.encode()), '2026-11-30'))


def test_a_wrong_clock_of_the_recorder_is_overruled_by_stated_days():
    """Days of a log after the day of issue; without a statement the certificate says what to do."""
    undated = FULL.replace(', date: 2026-11-30', '')
    days = 'measured: {begin: 2020-01-01, end: 2020-01-02}\n'
    stated = Inputs(parse_identity((undated + days).encode()), '2020-02-01')
    assert state(made('simulated')[0], stated).days == ('2020-01-01', '2020-01-02')
    with pytest.raises(InvalidData, match='was the clock of the recorder wrong. State measured.begin and measured.end'):
        state(made('simulated')[0], Inputs(parse_identity(undated.encode()), '2020-02-01'))


@pytest.mark.parametrize(('version', 'wanted'), [
    ('2.4.6', 'v2.4.6'), ('2.0.0rc1', 'v2.0.0'), ('11', 'v11'), ('1.2.3.4.5', 'v1.2.3.4'), ('unknown', 'v0')])
def test_releases_have_their_form(version, wanted):
    """A letter and at most four groups of digits."""
    assert release(version) == wanted
