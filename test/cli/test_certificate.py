# SPDX-License-Identifier: Apache-2.0
"""rosette certificate: written, checked, refused; nothing is overwritten."""

import json

import pytest

IDENTITY = '''schema: rosette-identity/1
certificate: {number: "7", date: 2026-11-30}
laboratory: {name: L, country: DE}
measured: {begin: 2026-04-12}
tolerances: {EXC: 500 µm, EAC: 0.3 arcsec}
'''


@pytest.fixture
def identity(tmp_path):
    """Return the path of an identity file."""
    path = tmp_path / 'identity.yaml'
    path.write_text(IDENTITY)
    return path


def test_a_certificate_is_written_and_agrees_with_its_run(rosette, refused, make_table, identity, tmp_path):
    """XML and PDF; what it lacks is said; --verify as words and as JSON; a second time needs --force."""
    table, xml, pdf = make_table(), tmp_path / 'cert.xml', tmp_path / 'cert.pdf'
    command = 'certificate', table, '--identity', identity, '-o', xml, '--pdf', pdf
    answer = rosette(*command)
    out = ' '.join(answer.out.split())
    assert answer.code == 0, answer.err
    for words in ('ctx (EXC) / µm', 'Missing mandatory data (ISO/IEC 17025, 7.8.2): city of the laboratory, name '
                  'of the customer', str(xml), str(pdf)):
        assert words in out
    assert pdf.read_bytes().startswith(b'%PDF')
    assert f'{xml} is the certificate of {table}: the hash of the data is right' in rosette(
        'certificate', '--verify', xml, table).out
    found = json.loads(rosette('certificate', '--json', '--verify', xml, table).out)
    assert found == {'schema': 'rosette-certificate-check/1', 'verified': True, 'largest_difference': 0.0,
                     'signed': False, 'programs': ''}
    assert f'{xml}: exists already; take another name or use --force' in refused(*command)
    assert rosette(*command, '--force').code == 0
    xml.write_bytes(xml.read_bytes().replace(b'2026-11-30', b'2026-04-16', 1))
    assert 'found that it is not: its content was changed after it was made' in refused(
        'certificate', '--verify', xml, table)


def test_what_does_not_go_together_is_refused(refused, make_table, identity, tmp_path):
    """In one line."""
    table = make_table()
    assert '--identity: does not go with --verify' in refused(
        'certificate', '--verify', 'x.xml', table, '--identity', identity)
    for option in (('--run-id', 'a'), ('--joint',), ('--force',)):
        assert f'{option[0]}: does not go with --verify' in refused('certificate', '--verify', 'x.xml', table, *option)
    assert '--json: expected it with --verify' in refused('certificate', table, '--json')
    line = refused('certificate', table, '-o', tmp_path / 'a.xml')
    assert 'expected certificate number, country (two letters of ISO 3166-1) of the laboratory, first day' in line
    assert 'in the identity file (--identity FILE; fill in a copy of config/identity.yaml)' in line
    for word, name, ending in (('-o', 'a.pdf', '.xml'), ('--pdf', 'a.xml', '.pdf')):
        line = refused('certificate', table, '--identity', identity, word, name)
        assert (f"{word}: expected a name that ends in {ending}, found '{name}'; -o names the XML, --pdf the pages"
                in line)
    assert 'expected one RUN, found 2; --joint evaluates several as one' in refused(
        'certificate', table, table, '--identity', identity, '-o', tmp_path / 'a.xml')
    assert 'expected a certificate that can be read' in refused('certificate', '--verify', tmp_path / 'none.xml', table)
    assert 'expected a name in a folder that exists' in refused(
        'certificate', table, '--identity', identity, '-o', tmp_path / 'a.xml', '--pdf', tmp_path / 'no' / 'a.pdf')
    assert not (tmp_path / 'a.xml').exists()


def test_inputs_of_the_budget_make_its_uncertainty_that_of_the_certificate(rosette, refused, make_table, identity,
                                                                           tmp_path):
    """U of the lines grows by what is stated; --verify makes it again from the certificate alone."""
    table, xml, inputs = make_table(), tmp_path / 'cert.xml', tmp_path / 'budget.yaml'
    inputs.write_text('schema: rosette-budget/1\nball_form: {form_um: 0.5}\n')
    out = ' '.join(rosette('certificate', table, '--identity', identity, '--inputs', inputs, '-o', xml).out.split())
    assert 'Uncertainty budget (GUM)' in out and 'form of the balls' in out
    inputs.unlink()
    assert 'is the certificate of' in rosette('certificate', '--verify', xml, table).out
    assert '--inputs: does not go with --verify' in refused('certificate', '--verify', xml, table, '--inputs', inputs)


@pytest.mark.usefixtures('sketched')
def test_evaluate_and_report_take_the_tolerances(rosette, make_table, identity, tmp_path):
    """The table of the six errors says whether they conform; JSON too; the report says who and what."""
    table = make_table()
    assert 'ISO 14253-1' in rosette('evaluate', table, '--identity', identity).out
    found = json.loads(rosette('evaluate', table, '--identity', identity, '--json').out)['iso_230_7']
    assert found['errors'][3]['tolerance'] == pytest.approx(1.454441e-6)  # JSON is in SI units
    assert '0.3 arcsec' in rosette('evaluate', table, '--identity', identity).out, 'as stated'
    assert ' 0.3 ' in rosette('evaluate', table, '--identity', identity, '--angle-unit', 'arcsec').out
    assert [one['iso_name'] for one in found['errors']] == ['EXC', 'EYC', 'EZC', 'EAC', 'EBC', 'ECC']
    assert found['errors'][0]['conformity'] and found['errors'][1]['conformity'] is None
    page = tmp_path / 'page.html'
    assert rosette('report', table, '--identity', identity, '-o', page).code == 0
    html = page.read_text()
    assert '>0.3 arcsec<' in html
    assert 'Who, what, where' in html and 'ISO 14253-1' in html and 'serial number of the rotary table' in html
