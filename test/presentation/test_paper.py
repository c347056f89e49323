# SPDX-License-Identifier: Apache-2.0
"""The reports on paper: printed by a real browser, the PDF measured."""

import ctypes
import functools
import re
from collections import Counter
from typing import NamedTuple

import numpy as np
import pypdfium2
import pytest
from pypdfium2 import raw
from summaries import summary_of

from rosette_ros.analysis import RunResult, summarise
from rosette_ros.core.run.remarks import RemarkKind, remark
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.presentation.report import Source, report_html
from rosette_ros.presentation.report.provenance import FileDigest
from rosette_ros.presentation.report.verification import verification_html, verify
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.effect_words import MEANINGS

pytestmark = pytest.mark.long

PAPER = {'A4': (595.3, 841.9), 'Letter': (612.0, 792.0)}
"""Width and height in points."""
SIDE, BODY, SMALLEST = 13 / 25.4 * 72, 9.0, 8.0
"""Margin at the side, size of running text and of the smallest text, points, as the style sheet has them."""
ROUNDING = 0.05
NAME = 'Prüfung "7" \\ </style><b>&_'
KINDS = ('clean', 'identified', 'three', 'annexed', 'wrong', 'verification')
IDENTITY = '''schema: rosette-identity/1
certificate: {number: "2026-0413", remarks: "Clamped as in use."}
laboratory: {name: Messlabor Süd, street: Ring 1, postcode: "80331", city: München, country: DE}
customer: {name: Drehtisch AG, street: Weg 2, postcode: "8000", city: Zürich, country: CH, order: "4711"}
place: {name: Room 3}
operator: A. Messer
signer: {name: B. Leiter, role: head of laboratory}
table: {maker: Tischbau, model: RT 400, serial: "T-0815"}
cmm: {maker: Koordinat, model: CMM 9, serial: "C-77", calibration: "2026-K-113"}
probe: {maker: Taster, model: T5, serial: "P-3"}
plate: {maker: Kugel, model: KP 12, serial: "KP-1"}
thermometer: {maker: Thermo, model: Pt100, serial: "TH-9"}
tolerances: {EXC: 50 µm, EYC: 0.1 µm, EZC: 1 nm, EAC: 0.3 arcsec, EBC: 9 arcsec, ECC: 0.01 urad}
'''


class Sheet(NamedTuple):
    """A printed page: its texts in and above the foot, sizes of letters, their left, bottom, right and top, points."""

    size: tuple[float, float]
    foot: str
    text: str
    sizes: Counter
    boxes: np.ndarray


@functools.cache
def html_of(kind):
    """Return the report of a run without and with one and three causes, of one with gaps and wrong readings, or of a
    verification."""
    if kind == 'verification':
        found = RunResult(summary_of('drift').fit)
        return verification_html(verify([(found, Source(f'{run}.csv', ())) for run in range(6)]))
    if kind == 'annexed':
        path = f'/a/path/{"of_a_long_name" * 12}.csv'
        source = Source(path, (FileDigest(path, 12, 'ab' * 32),))
        return report_html(summary_of('drift'), source, f'rosette report {path}', annexed=True)
    if kind != 'wrong':
        summary = summary_of('drift' if kind == 'identified' else kind, 12)
        identity = parse_identity(IDENTITY.encode() if kind != 'clean' else b'schema: rosette-identity/1')
        return report_html(summary, Source('', (), identity=identity))
    run = Machine(MachineConfig().changed(seed=2, plate={'balls': 8})).run(plan(8, 'random'), run_id=NAME)
    centre = run.centre.copy()
    centre[[9, 30]] += [[4e-6, 2e-6, 0], [0, -3e-6, -5e-6]]
    damaged = remark(RemarkKind.LOG_DAMAGED, problem='cut short', others=0)
    return report_html(summarise(run.replace(
        centre=centre, simulated=False, remarks=(damaged,)).take(slice(0, -3))))


@pytest.fixture(scope='module')
def tab(chromium):
    """Yield a tab of the browser."""
    tab = chromium.new_page()
    yield tab
    tab.close()


@pytest.fixture(scope='module', params=KINDS)
def opened(request, tab, tmp_path_factory):
    """Open a report in the browser; the kind, the tab."""
    path = tmp_path_factory.mktemp('paper') / 'report.html'
    path.write_text(html_of(request.param), 'utf-8')
    tab.goto(path.as_uri())
    return request.param, tab


@pytest.fixture(scope='module', params=PAPER)
def printed(request, opened):
    """Print a report: kind, paper, Sheets."""
    kind, tab = opened
    document = pypdfium2.PdfDocument(tab.pdf(format=request.param, print_background=True))
    return kind, request.param, [sheet_of(page) for page in document]


def sheet_of(page):
    """Measure a page."""
    texts, sizes, boxes = page.get_textpage(), Counter(), []
    for place in range(texts.count_chars()):
        letter = chr(raw.FPDFText_GetUnicode(texts, place))
        if raw.FPDFText_IsGenerated(texts, place) or letter.isspace():
            continue
        matrix = raw.FS_MATRIX()
        raw.FPDFText_GetMatrix(texts, place, ctypes.byref(matrix))
        sizes[round(raw.FPDFText_GetFontSize(texts, place) * np.hypot(matrix.b, matrix.d), 2)] += 1
        boxes.append(texts.get_charbox(place))
    width, height = page.get_size()
    foot = texts.get_text_bounded(0, 0, width, 17 / 25.4 * 72)
    return Sheet((width, height), foot, ' '.join(texts.get_text_bounded().split()), sizes, np.array(boxes))


def test_paper_is_as_chosen_and_nothing_is_scaled(printed):
    """The sheet has the size that the reader chose; running text has the size that the style sheet gives it."""
    _, paper, sheets = printed
    for sheet in sheets:
        assert sheet.size == pytest.approx(PAPER[paper], abs=1.5)
    assert sum(sheet.sizes[BODY] for sheet in sheets) > 500


def test_everything_can_be_read(printed):
    """No letter is smaller than 8 pt, those in figures neither; none is beyond the margin."""
    _, _, sheets = printed
    for sheet in sheets:
        assert min(sheet.sizes) >= SMALLEST - ROUNDING
        left, bottom, right, top = sheet.boxes.T
        assert left.min() >= SIDE - 1 and right.max() <= sheet.size[0] - SIDE + 1
        assert bottom.min() > 12 and top.max() < sheet.size[1] - 12


def test_every_page_says_what_it_belongs_to(printed):
    """Run, page and number of pages; that the run is simulated."""
    kind, _, sheets = printed
    name = {'clean': 'clean_12 (SIMULATED)', 'identified': 'drift_12 (SIMULATED)',
            'three': 'three_12 (SIMULATED)', 'annexed': 'drift_8 (SIMULATED)', 'wrong': NAME,
            'verification': 'Verification, 6 runs, the first drift_8 (SIMULATED)'}[kind]
    for number, sheet in enumerate(sheets, 1):
        assert name in sheet.foot
        assert f'page {number} of {len(sheets)}' in sheet.foot


def test_the_report_is_three_pages(printed):
    """Verdict, six curves and what to do; where the model fails and what would be seen; conditions and the unknown."""
    kind, _, sheets = printed
    if kind in ('verification', 'wrong'):
        return
    assert (len(sheets) == 3) == (kind != 'annexed')
    curves = [f'{curve} (' for curve in ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')]
    simulated = ['no real table was measured']
    pages = (
        [*simulated, 'VDI/VDE 2617', 'What to do:', 'U: k = 2', 'Figure 1.', *(2 * curves), 'bands: U (k = 2)'],
        ['Figure 2.', 'Residual by group', 'What this run could have shown', 'Order random'],
        ['Measurement: method and conditions', 'Three-rosette method', 'Repeatability', 'Temperature',
         'First reading', 'Sequence', 'Model', 'Uncertainty budget (GUM)', 'No value is stated for',
         'Limitations and conditions of', 'once-per-turn part of (ctx, cty)',
         'Software rosette_ros'])
    if kind in ('identified', 'three'):
        pages[0].extend(['tolerance', 'not stated', 'Decision rule: ISO 14253-1'])
        pages[2].extend(['Messlabor Süd, Ring 1', 'No. T-0815', 'EXC 50 µm', 'place, date', 'signature',
                         'B. Leiter, head of laboratory'])
    if kind != 'clean':
        pages[0].extend(['SYSTEMATIC EFFECT FOUND', MEANINGS['frame_drift'].look, 'all explanations averaged'])
    for sheet, wanted in zip(sheets, pages, strict=False):
        squeezed = re.sub(r'\s', '', sheet.text).lower()
        assert [one for one in wanted if re.sub(r'\s', '', one).lower() not in squeezed] == []
    for key in ('Repeatability', 'Uncertainties', 'Software'):
        assert re.search(rf'\b{key}\b', sheets[2].text), f'{key} is broken within the word'
    assert [number for number, sheet in enumerate(sheets, 1) if 'Annex A:' in sheet.text] == [4] * (kind == 'annexed')


def test_figures_are_seen_closer_where_scripts_run(tab, tmp_path):
    """By a double click, moved by dragging, whole again by another one and on paper."""
    (tmp_path / 'report.html').write_text(html_of('three'), 'utf-8')
    tab.goto((tmp_path / 'report.html').as_uri())
    assert 'A double click' in tab.inner_text('header')

    def box():
        return [float(one) for one in tab.get_attribute('#figure-curves svg', 'viewBox').split()]
    whole = box()
    paper = 'dispatchEvent(new Event("beforeprint"))'
    ends = [lambda: tab.dblclick('#figure-curves svg'), lambda: tab.evaluate(paper)]
    for end in ends:
        tab.dblclick('#figure-curves svg')
        closer = box()
        assert abs(closer[2] - whole[2] / 3) < 0.1 and closer[0] > whole[0] and closer[1] > whole[1]
        end()
        assert box() == whole
    tab.dblclick('#figure-curves svg')
    before, middle = box(), tab.locator('#figure-curves svg').bounding_box()
    tab.mouse.move(middle['x'] + 200, middle['y'] + 100)
    tab.mouse.down()
    tab.mouse.move(middle['x'] + 100, middle['y'] + 100)
    tab.mouse.up()
    assert box()[0] > before[0] and box()[2] == before[2]


def test_other_pages_stand_alone_too(printed):
    """A run with gaps and wrong readings, and a verification."""
    kind, _, sheets = printed
    wanted = {'verification': ['no real table was measured', 'Reproducibility', 'VDI/VDE 2617', 'Figure 1.'],
              'wrong': ['3 missing: ', 'nothing in the data says that it is simulated', 'log is damaged: cut short.',
                        'single wrong reading']}.get(kind, [])
    text = re.sub(r'\s', '', ' '.join(sheet.text for sheet in sheets)).lower()
    assert [one for one in wanted if re.sub(r'\s', '', one).lower() not in text] == []


def test_figures_are_numbered_in_order(printed):
    """1, 2, 3 ..., each with a caption; the text refers to figures that exist."""
    text = ' '.join(sheet.text for sheet in printed[2])
    captions = [int(number) for number in re.findall(r'Figure (\d+)\. [A-Z]', text)]
    assert captions == list(range(1, len(captions) + 1)) and captions
    assert {int(number) for number in re.findall(r'Figure (\d+)(?!\.| of the paper)', text)} <= {*captions}
    tables = [int(number) for number in re.findall(r'Table (\d+)\. [A-Z]', text)]
    assert tables == list(range(1, len(tables) + 1)) and len(tables) >= 2


def test_no_page_is_half_empty(printed):
    """But the last one."""
    _, _, sheets = printed
    for number, sheet in enumerate(sheets[:-1], 1):
        lowest = min(bottom for _, bottom, _, _ in sheet.boxes if bottom > 60)
        assert lowest < 0.5 * sheet.size[1], number


@pytest.mark.parametrize('width', [390, 739])
def test_on_a_small_screen_wide_tables_scroll_by_themselves(opened, width):
    """The page is no wider than the screen."""
    _, tab = opened
    tab.set_viewport_size({'width': width, 'height': 800})
    assert tab.evaluate('document.documentElement.scrollWidth') <= width
