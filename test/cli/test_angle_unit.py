# SPDX-License-Identifier: Apache-2.0
"""--angle-unit arcsec: every angle of every verb in one unit, JSON untouched, nothing of it left for the next one."""

import csv
import json

import pytest
from pypdf import PdfReader
from simulated import simulated_table
from test_certificate import IDENTITY

from rosette_ros.core.run.number_words import ANGLES, angle_unit, show_angles
from rosette_ros.presentation.formatting import clamping_words, curve_units
from rosette_ros.words.effect_words import scale_of

ARCSEC = '--angle-unit', 'arcsec'
IN_ARCSEC = 0.20626480624709636  # arc seconds of one µrad


@pytest.fixture
def arcsec():
    """Show angles in arc seconds within a test."""
    show_angles('arcsec')
    yield
    show_angles('urad')


VERBS = {
    'evaluate': ('evaluate', '{run}', '--environment', 'laboratory'), 'joint': ('evaluate', '{back}', '--joint'),
    'budget': ('budget', '{run}'), 'compare': ('compare', '{run}'), 'correct': ('correct', '{run}', '-o', '{made}'),
    'plan': ('plan', '--balls', '6', '--radius-mm', '100', '--order', 'random', '--sigma-um', '0.1'),
    'advise': ('advise', '--balls', '6', '--radius-mm', '100', '--order', 'row', '--environment', 'laboratory')}


@pytest.mark.parametrize('verb', VERBS)
def test_no_angle_is_left_in_microradians(rosette, make_table, tmp_path, verb):
    """What a verb prints names the chosen unit where it names an angle at all, and no other one."""
    paths = {'run': make_table(order='random'), 'back': simulated_table(order='there_and_back', n=6),
             'made': tmp_path / 'c.yaml'}
    words = [one.format(**paths) for one in VERBS[verb]]
    before = rosette(*words).out
    (tmp_path / 'c.yaml').unlink(missing_ok=True)
    after = rosette(*words, *ARCSEC).out
    assert 'µrad' in before and 'arcsec' not in before
    assert 'arcsec' in after and 'µrad' not in after
    assert angle_unit() == 'arcsec'
    rosette('plan', '--balls', '6', '--radius-mm', '100', '--order', 'row')
    assert angle_unit() == 'urad'  # of one command alone


@pytest.mark.usefixtures('sketched')
def test_pages_and_their_pictures_follow(rosette, make_table, tmp_path):
    """A report has no µrad, in its text, tables and pictures."""
    page = tmp_path / 'page.html'
    assert rosette('report', make_table(order='random'), '--annex', '-o', page, *ARCSEC).code == 0
    assert 'arcsec' in page.read_text() and 'rad<' not in page.read_text() and 'µrad' not in page.read_text()


def test_pages_of_a_certificate_follow_its_document_does_not(rosette, make_table, tmp_path):
    """D-SI has no arc second: the XML keeps microradians, and agrees with its run in either unit; the PDF has none."""
    xml, pdf, identity, table = *(tmp_path / f'a.{end}' for end in ('xml', 'pdf', 'yaml')), make_table(order='random')
    identity.write_text(IDENTITY)
    told = rosette('certificate', table, '--identity', identity, '-o', xml, '--pdf', pdf, *ARCSEC)
    assert told.code == 0 and 'arcsec' in told.out and 'µrad' not in told.out
    assert r'\micro\radian' in xml.read_text() and r'\arcsec' not in xml.read_text()
    text = ' '.join(page.extract_text() for page in PdfReader(pdf).pages)
    assert 'arcsec' in text and 'µrad' not in text
    assert rosette('certificate', '--verify', xml, table).code == 0


def test_csv_says_its_unit_and_json_stays(rosette, make_table):
    """The columns of angles are named by their unit, the numbers are those of µrad times 0.206; JSON is SI."""
    table = make_table(order='random')
    one, other = ([*csv.DictReader(line for line in rosette('evaluate', table, '--csv', *more).out.splitlines()
                                   if not line.startswith('#'))]
                  for more in ((), ARCSEC))
    for here, there in zip(one, other, strict=True):
        assert here['ctx_um'] == there['ctx_um'] and 'crz_urad' not in there
        assert float(there['crz_arcsec']) == pytest.approx(IN_ARCSEC * float(here['crz_urad']), rel=1e-12)
        assert float(there['u_crx_arcsec']) == pytest.approx(IN_ARCSEC * float(here['u_crx_urad']), rel=1e-12)
    json_of = [json.loads(rosette('evaluate', table, '--json', *more).out) for more in ((), ARCSEC)]
    assert json_of[0] == json_of[1]


def test_a_wrong_unit_is_told(refused, make_table):
    """The names of the units are said."""
    assert 'urad' in refused('evaluate', make_table(), '--angle-unit', 'grad')


def test_all_units_of_angles_follow(arcsec):
    """Rates and sensitivities, too: per hour, per kelvin, per reading."""
    found = {unit: scale_of(unit) for unit in ('rad', 'rad/s', 'rad/K', 'rad/reading')}
    assert {unit: one.unit for unit, one in found.items()} == {
        'rad': 'arcsec', 'rad/s': 'arcsec/h', 'rad/K': 'arcsec/K', 'rad/reading': 'arcsec/reading'}
    assert found['rad/s'].factor == pytest.approx(3600 * ANGLES['arcsec'].factor)
    assert curve_units() == ('µm',) * 3 + ('arcsec',) * 3
    assert 'tilt 2.06 arcsec, turn 0.00 arcsec' in clamping_words((0.0, 0.0, 0.0), (1e-5, 0.0, 0.0))
