# SPDX-License-Identifier: Apache-2.0
"""The page of a run: its parts, in which order, and that it needs nothing else."""

import hashlib
import re
from dataclasses import replace

import pytest
from page_reader import Page
from summaries import summary_of

from rosette_ros.analysis import Summary, summarise
from rosette_ros.core.diagnosis.run_result import RunResult
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.io.text_file import write_text
from rosette_ros.presentation.plots.result_plots import Series
from rosette_ros.presentation.report import Source, open_source, report_html
from rosette_ros.presentation.report.run_page import COLUMNS
from rosette_ros.presentation.report.verification import verification_html, verify
from rosette_ros.presentation.tables import tables_of
from rosette_ros.words.verdict_words import verdict_text

pytestmark = pytest.mark.long

ORDER = ['verdict', 'curves', 'fails', 'seen', 'measured', 'uncertainty', 'unknown', 'values', 'deviations',
         'residuals', 'ladder', 'candidates', 'visibility', 'conditions']
FIGURES = ['curves', 'residual_maps', 'polar', 'budget', 'deviations', 'residuals_against', 'histogram', 'noise',
           'ladder', 'candidates', 'shapes', 'pairs', 'visibility']


def renamed(summary, run_id):
    """Return a summary whose run has another name."""
    run = summary.run.replace(run_id=run_id)
    return Summary(replace(summary.fit, run=run), summary.comparison, summary.diagnosis, summary.ladder, summary.advice)


@pytest.fixture(scope='module')
def drift_page():
    """The page of a run with a hidden drift, and its annex."""
    return report_html(summary_of('drift'), command='rosette report drift.csv', annexed=True)


@pytest.fixture(scope='module')
def clean_page():
    """The page of a run that hides nothing."""
    return report_html(summary_of('clean'))


@pytest.fixture(scope='module', params=['drift', 'clean', 'verification'])
def page(request, drift_page, clean_page):
    """One page of each kind."""
    if request.param == 'verification':
        summary = summary_of('clean')
        return verification_html(verify([(RunResult(summary.fit), Source('<b>', ()))] * 4), annexed=True)
    return drift_page if request.param == 'drift' else clean_page


def test_sections_stand_in_the_order_in_which_a_person_asks(drift_page):
    """Verdict first, what is needed to repeat it last; the figures in between, in order."""
    read = Page(drift_page)
    assert read.sections == ORDER
    figures = [found['id'].removeprefix('figure-') for tag, found in read.elements if tag == 'figure']
    assert figures == FIGURES


def test_the_annex_is_made_on_demand(monkeypatch):
    """Nothing of it is drawn or calculated before; the page says how to get it, and how it is repeated."""
    monkeypatch.setattr('rosette_ros.analysis.ladder', None)
    monkeypatch.setattr('rosette_ros.presentation.report.run_page.polar_motions', None)
    summary = summarise(summary_of('drift').run, has_ladder=False)
    read = Page(report_html(summary, command='rosette report drift.csv'))
    assert read.sections == [*ORDER[:7], 'conditions']
    assert [found['id'] for tag, found in read.elements if tag == 'figure'] == ['figure-curves', 'figure-residual_maps']
    assert 'rosette report drift.csv --annex' in read.texts['']
    linked = {found['href'] for tag, found in read.elements if tag == 'a'}
    assert linked == {f'#{one}' for one in read.sections} - {'#curves'}


def test_the_verdict_says_what_is_wrong_and_what_to_do(drift_page):
    """One sentence, one action, where to look; the level is given in words, not in colour alone."""
    summary, text = summary_of('drift'), ' '.join(Page(drift_page).texts['verdict'].split())
    assert summary.diagnosis.missing == ('frame_drift',)
    stated = verdict_text(summary.verdict)
    for words in (stated.sentence, stated.action, 'SYSTEMATIC EFFECT FOUND, NOT IN THE MODEL', 'What to do:',
                  'possible origin', 'The probe moves with time', 'the probe moves by',
                  'linear probe drift', 'all explanations averaged'):
        assert words in text
    assert 'as modelled' not in text and 'as modelled' in Page(drift_page).texts['fails']


def test_a_run_that_fits_says_so(clean_page):
    """And claims nothing."""
    read = Page(clean_page)
    assert 'THE MODEL FITS The model fits' in ' '.join(read.texts['verdict'].split())
    assert 'What is missing' not in read.texts['verdict']


def test_both_names_of_each_curve_are_shown(drift_page):
    """VDI/VDE 2617 and ISO 230-7, in the picture and in the table of the six errors."""
    text = Page(drift_page).texts['curves']
    for name in ('ctx (EXC)', 'cty (EYC)', 'ctz (EZC)', 'crx (EAC)', 'cry (EBC)', 'crz (ECC)'):
        assert text.count(name) == 1
        assert name in Page(drift_page).texts['verdict']


def test_what_cannot_be_known_is_said(drift_page):
    """All parts of the gauge."""
    for words in summary_of('drift').fit.gauge:
        assert words in Page(drift_page).texts['unknown']


def test_conditions_hold_what_is_needed_to_repeat_the_report(tmp_path):
    """Order, start, temperature, repeatability, model, software, command, and the hash of the file."""
    path = tmp_path / 'run.csv'
    write_csv(summary_of('drift').run, path)
    _, source = open_source(path)
    page = report_html(summary_of('drift'), source, 'rosette report run.csv')
    texts = Page(page).texts
    text = (texts['measured'] + texts['conditions']).replace('\u00a0', ' ')
    for words in (hashlib.sha256(path.read_bytes()).hexdigest(), '8 balls on R = 182.5 mm', 'random',
                  'degrees of freedom', '°C at the start', 'Table anglesnominal', 'schema: rosette-model/1',
                  '- frame_drift',
                  'rosette report run.csv', 'numpy ', 'scipy ', 'Python ', 'rosette_ros '):
        assert words in text


def test_tables_of_the_page_name_what_their_rows_are_of():
    """The candidates have their effect; no column is chosen that its table does not have, if it must."""
    tables = {one.name: one for one in tables_of(summary_of('drift'))}
    assert tables['candidates'].select(*COLUMNS['candidates']).shown[0].head == 'effect'
    for name in ('causes', 'candidates', 'visibility'):
        assert {*COLUMNS[name]} <= {one.key for one in tables[name].columns}, name
    head = tables['visibility'].select(*COLUMNS['visibility'])
    assert 'sensitivity, typical' in [one.head for one in head.shown] and 'not absorbed' in head.note


def test_nothing_on_a_page_comes_from_elsewhere(page):
    """No script, no handler, no link, no picture, no font that is not on the page itself; its script is its own."""
    read = Page(page)
    tags = {tag for tag, _ in read.elements}
    assert [found for tag, found in read.elements if tag == 'script'] in ([], [{}])
    assert not tags & {'link', 'iframe', 'object', 'embed', 'img', 'base', 'form'}
    for value in read.values('src', 'href', 'xlink:href', 'srcset', 'action'):
        assert value.startswith(('#', 'data:image/png;base64,'))
    assert not any(name.startswith('on') for _, found in read.elements for name in found)
    for address in re.findall(r'url\(([^)]*)\)', page):
        assert address.startswith('#')
    assert '@import' not in read.styles and 'http' not in page


def test_every_reference_finds_its_place_and_no_two_are_alike(page):
    """Clip paths and markers of one picture do not reach into another."""
    read = Page(page)
    ids = read.values('id')
    assert len(ids) == len(set(ids))
    inside = {value[1:] for value in read.values('href') if value.startswith('#')}
    assert (inside | set(re.findall(r'url\(#([^)]*)\)', page))) - set(ids) == set()


def test_pictures_can_be_read_aloud_and_searched(drift_page):
    """Each has a description; its text is text."""
    read = Page(drift_page)
    pictures = [found for tag, found in read.elements if found.get('role') == 'img']
    assert len(pictures) == len(FIGURES)
    assert all(found['aria-label'] for found in pictures)
    assert 'table angle in degrees' in read.texts['curves']


@pytest.mark.parametrize('kind', ['table', 'card'])
def test_what_scrolls_is_reached_by_the_keyboard(drift_page, kind):
    """Tables and pictures do, on a telephone; each says what it is."""
    places = [found for tag, found in Page(drift_page).elements if kind in found.get('class', '').split()]
    assert places and all(found['tabindex'] == '0' and found['aria-label'] for found in places)


def test_twelve_balls_stay_below_five_megabytes():
    """The whole page."""
    assert len(report_html(summary_of('drift', 12), annexed=True).encode()) < 5e6


def test_the_same_summary_gives_the_same_page(drift_page):
    """To the last byte: a report can be repeated and compared."""
    assert report_html(summary_of('drift'), command='rosette report drift.csv', annexed=True) == drift_page


@pytest.mark.parametrize('name', ['<script>alert(1)</script>', '_"><img src=x onerror=alert(1)> $\\frac{1}$ & y'])
def test_a_name_is_a_name_whatever_stands_in_it(name):
    """HTML in the name of a run stays text, and so do formulas; in legends, too."""
    summary = renamed(summary_of('clean'), name)
    page = report_html(summary, overlays=(Series(name, summary.fit.error_motions),))
    read = Page(page)
    assert name in read.texts['']
    assert name in read.texts['conditions']
    tags = [tag for tag, _ in read.elements]
    assert tags.count('script') == 1 and 'img' not in tags and 'alert(1)' not in page.rpartition('<script>')[2]


def test_a_report_that_cannot_be_written(tmp_path):
    """In words; with --force what stands there is replaced."""
    write_text(tmp_path / 'a.html', 'one')
    write_text(tmp_path / 'a.html', 'two', force=True)
    assert (tmp_path / 'a.html').read_text() == 'two'
    with pytest.raises(InvalidData, match='cannot be written: No such file or directory'):
        write_text(tmp_path / 'nowhere' / 'report.html', 'text')


def test_runs_without_repeatability_temperature_or_complete_grid_are_reported_too():
    """What is not known is said to be not known."""
    run = summary_of('clean').run.replace(repeatability=None, repeatability_dof=None,
                                    temperature=[float('nan')] * summary_of('clean').run.size)
    summary = summarise(run.take(slice(0, -3)))
    text = ' '.join(Page(report_html(summary)).texts['measured'].split())
    assert 'Repeatabilitynot known' in text
    assert 'Temperaturenot recorded' in text
    assert '61 of 64 ball centres' in text


def test_points_of_the_curves_say_their_values():
    """Angle, value and U of each of n + 1 points of six curves, as titles, which need no script."""
    summary = summary_of('clean')
    page = report_html(summary)
    titles = re.findall(r'<use [^>]*><title>([^<]*)</title></use>', page)
    assert len(titles) == 6 * (summary.run.n + 1)
    motions = summary.fit.error_motions
    first = next(one for one in titles if ': ctx at 0°: ' in one)
    value, u = (float(one.replace('−', '-')) for one in re.search(r': (\S+) µm, U (\S+) µm', first).groups())
    assert abs(value - 1e6 * motions['ctx'][0]) < 0.01 and abs(u - 2e6 * motions.uncertainty('ctx')[0]) < 0.01


def test_the_first_page_says_of_which_table_it_is():
    """With laboratory and customer, and each decision on a tolerance in its colour."""
    identity = parse_identity(b'schema: rosette-identity/1\ntable: {maker: M, model: RT, serial: "7"}\n'
                              b'laboratory: {name: L}\ncustomer: {name: C}\n'
                              b'tolerances: {EXC: 50 um, EYC: 1 nm, EZC: 0.6 um}')
    page = report_html(summary_of('clean'), Source('', (), identity=identity))
    assert '<b>Rotary table M RT, No. 7; laboratory L; customer C</b>' in page
    rows = re.findall(r'<tr class="row (\w+)"><td>(\w+) ', page.partition('id="table-errors"')[2])
    assert ('good', 'ctx') in rows and 'not decidable' in page, 'as in every interface'
    assert 'U: k = 2; residual' in ' '.join(page.replace('\u00a0', ' ').split()), 'of the columns of the page alone'
    assert '#table-errors tr.row td:last-child { color: var(--level)' in page
    assert 'dotted: tolerances' in page and 'dotted' not in report_html(summary_of('clean'))
