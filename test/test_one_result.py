# SPDX-License-Identifier: Apache-2.0
"""One run, one result: every interface gives the same six ranges with the same U."""

import csv
import io
import json
import re
from html import unescape

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from lxml import etree
from test_one_verdict import studio_words, table_of

from rosette_ros.analysis import RunResult, Which, result, summarise
from rosette_ros.certificate.dcc import DCC, SI, to_xml
from rosette_ros.certificate.statements import Inputs, state
from rosette_ros.cli.main import main
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import CURVES, SI_UNITS
from rosette_ros.core.uncertainty.error_summary import peak_to_valley
from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.io.open_run import open_run
from rosette_ros.io.qif_results import NAMESPACE
from rosette_ros.nodes.conversions import error_motions_message
from rosette_ros.nodes.evaluation import ModelInUse
from rosette_ros.presentation.error_results import errors_of
from rosette_ros.presentation.report.run_page import report_html

IDENTITY = '''schema: rosette-identity/1
certificate: {number: "7", date: 2026-11-30}
laboratory: {name: L, country: DE}
measured: {begin: 2026-04-12}
tolerances: {EXC: 500 µm}
'''
EXPECTED = {'clean': Which.MODELLED, 'hidden effect': Which.AVERAGED, 'no repeatability': Which.MODELLED}
LACKS = 3


@pytest.fixture(params=EXPECTED)
def run_file(request):
    """Return the path of the table of a run, its result, and whether something is missing."""
    path = table_of(request.param)
    found = result(open_run(path))
    assert found.curves.which is EXPECTED[request.param]
    return path, found, found.beside is not None


@pytest.fixture
def rosette(capsys):
    """Return a function that runs `rosette ...` and returns its exit code, stdout and stderr."""
    def run(*words):
        capsys.readouterr()
        code = main([str(word) for word in words])
        return code, *capsys.readouterr()
    return run


def shown(found):
    """Return the rows of the table of errors as people see them, and the exact ranges with U, (6,), m and rad."""
    lines = found.curves.lines()
    rows = errors_of(found)[0].select('error', 'range_in_unit', 'U_range_in_unit').rows
    return rows, np.array([line.range for line in lines]), np.array([line.expanded for line in lines])


def of_dcc(document, curve):
    """Return the range of a curve and its U in a certificate, m or rad."""
    places = {'dcc': DCC, 'si': SI}
    real, = document.iterfind(f'.//dcc:quantity[@refType="rosette_{curve}_range"]/si:real', places)
    return [1e-6 * float(real.find(f'.//si:{name}', places).text) for name in ('value', 'valueExpandedMU')]


@pytest.mark.usefixtures('sketched')
def test_every_interface_gives_one_result(run_file, rosette, tmp_path):
    """Terminal, JSON, CSV, QIF, Q-DAS, message, report, studio, certificate and correction."""
    path, found, lacks = run_file
    rows, ranges, expanded = shown(found)
    keys = [f'{curve}_{unit}' for curve, unit in SI_UNITS.items()]

    text = ' '.join(rosette('evaluate', path)[1].split())
    page = ' '.join(re.sub(r'<[^>]*>', ' ', unescape(report_html(summarise(open_run(path), has_ladder=False)))).split())
    studio = ' '.join(' '.join(studio_words(open_run(path))).split())
    for row in rows:
        assert all(' '.join(row) in words for words in (text, page, studio)), row
    for words in (text, page, studio):  # the result stands first, and the other has its name
        assert words.index(' '.join(rows[0])) == words.index('ctx (EXC) / µm')
        assert (', all explanations averaged' in words and ', as modelled' in words) == lacks

    for verb in ('evaluate', 'diagnose'):
        one = json.loads(rosette(verb, path, '--json')[1])['result']
        assert one['which'] == found.curves.which
        np.testing.assert_allclose([one[key] for key in keys], found.curves.motions.values.T, rtol=1e-12)
        np.testing.assert_allclose([one['U'][key] for key in keys], 2 * found.curves.motions.u.T, rtol=1e-12)
        every = one['iso_230_7']['errors']
        np.testing.assert_allclose([[line['range'], line['U_range']] for line in every],
                                   np.transpose([ranges, expanded]), rtol=1e-12)

    lines = rosette('evaluate', path, '--csv')[1].splitlines()
    head = dict(line[2:].split(': ', 1) for line in lines if line.startswith('# '))
    table = list(csv.DictReader(io.StringIO('\n'.join(line for line in lines if not line.startswith('#')))))
    assert (head['result'], head['outcome']) == (found.curves.which, found.verdict.outcome)
    for place, curve in enumerate(CURVES):
        key = f'{curve}_{"um" if place < 3 else "urad"}'
        np.testing.assert_allclose([1e-6 * float(head[f'{one}_{key}']) for one in ('range', 'U_range')],
                                   [ranges[place], expanded[place]], rtol=1e-12)
        np.testing.assert_allclose([1e-6 * float(row[key]) for row in table], found.curves.motions.values[:, place],
                                   atol=1e-18)

    spc = tmp_path / 'spc.qif', tmp_path / 'spc.dfq'
    assert rosette('evaluate', path, '--qif', spc[0], '--dfq', spc[1])[0] == 0
    root = etree.parse(spc[0]).getroot()
    values = [1e-6 * float(one.text) for one in root.iterfind(f'.//{{{NAMESPACE}}}Value')]
    np.testing.assert_allclose(values, np.transpose([ranges, expanded]).ravel(), rtol=1e-8)
    values = [1e-6 * float(line.split()[1]) for line in spc[1].read_text().splitlines() if line.startswith('K0001/')]
    np.testing.assert_allclose(values, np.transpose([ranges, expanded]).ravel(), rtol=1e-8)

    document = etree.fromstring(to_xml(state([path], Inputs(parse_identity(IDENTITY.encode()), '2026-11-30'))))
    np.testing.assert_allclose([of_dcc(document, curve) for curve in CURVES], np.transpose([ranges, expanded]),
                               rtol=1e-6)

    in_use = ModelInUse(Model())
    fitted = in_use.evaluate(open_run(path))
    message = error_motions_message(RunResult(fitted, in_use.diagnose()[1]), Time(), 'table')
    assert message.which == found.curves.which
    for of, wanted in ((message, found.curves), (message.modelled, found.modelled)):
        assert list(of.range) == [line.range for line in wanted.lines()]
        assert list(of.expanded_range) == [line.expanded for line in wanted.lines()]
        for curve in CURVES:
            assert np.array_equal(getattr(of, curve), wanted.motions[curve])
            assert np.array_equal(getattr(of, f'u_{curve}'), wanted.motions.uncertainty(curve))

    assert rosette('correct', path, '-o', tmp_path / 'table.yaml')[0] == 0
    correction = read_correction(tmp_path / 'table.yaml')[0].forward
    np.testing.assert_allclose(peak_to_valley(correction.values), ranges, rtol=1e-12)
    np.testing.assert_allclose(correction.u, found.curves.motions.u, rtol=1e-12)


def test_a_run_that_lacks_something_says_so_where_nobody_looks(run_file, rosette):
    """Exit code 3 with --check; a line on stderr where the output is no terminal."""
    path, _, lacks = run_file
    for option in ([], ['--csv'], ['--json']):
        code, plain, said = rosette('evaluate', path, *option)
        checked, *same = rosette('evaluate', path, *option, '--check')
        assert (code, checked) == (0, LACKS if lacks else 0) and same == [plain, said]
        assert ('The probe moves with time' in said) == lacks
