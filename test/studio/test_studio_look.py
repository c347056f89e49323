# SPDX-License-Identifier: Apache-2.0
"""How the page looks: names, digits, focus, sizes of the screen; measured in a real browser."""

import itertools
import re

import pytest
from page_steps import choose_run, judged, open_path
from playwright.sync_api import expect

from rosette_ros.analysis import summarise
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.plots.plot_style import AFTER, BEFORE
from rosette_ros.presentation.report import report_html
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.effect_words import MEANINGS, words_of

pytestmark = pytest.mark.long

TWO = [{'kind': 'frame_drift', 'rate_um_per_h': [3.0, 0.0, 1.5]}, {'kind': 'table_zero_drift', 'rate_urad_per_h': 30.0}]
BOXES = '''chosen => [...document.querySelectorAll(chosen)]
    .filter(one => one.checkVisibility() && one.textContent.trim())
    .map(one => [one.textContent, one.closest('.js-plotly-plot')?.id, one.getBoundingClientRect()])
    .map(([text, figure, box]) => [text, figure, box.left, box.top, box.right, box.bottom])'''


@pytest.fixture(scope='module')
def twice(tmp_path_factory):
    """Return the path of a run with two effects that the base model does not know."""
    path = tmp_path_factory.mktemp('runs') / 'twice.csv'
    config = MachineConfig().changed(seed=3, plate={'balls': 7}, hidden=TWO)
    write_csv(Machine(config).run(plan(7, 'random')), path)
    return path


@pytest.fixture(scope='module')
def with_both():
    """Return the pages on which both runs are open."""
    return []


@pytest.fixture
def opened(shared_page, twice, with_both):
    """Return a function that shows one of two runs with its verdict, on a page that was loaded in a width."""
    def shown(name='drifting.csv', width=1280):
        if shared_page.viewport_size['width'] != width:
            shared_page.set_viewport_size({'width': width, 'height': 800})
            shared_page.reload()
            expect(shared_page.get_by_test_id('run')).not_to_have_value('')
        if name == twice.name and shared_page not in with_both:
            open_path(shared_page, twice)
            with_both.append(shared_page)
        choose_run(shared_page, name)
        judged(shared_page, 'bad')
        return shared_page
    return shown


def overlapping(boxes):
    """Return the pairs of texts of one figure that overlap by more than a pixel each way."""
    return [(a[0], b[0]) for a, b in itertools.combinations(boxes, 2) if a[1] == b[1]
            and min(a[4], b[4]) - max(a[2], b[2]) > 2 and min(a[5], b[5]) - max(a[3], b[3]) > 3]


def test_every_effect_has_words():
    """Each its own, beside the identifier."""
    words = [one.plain for one in MEANINGS.values()]
    assert all(words) and len(set(words)) == len(words)
    assert words_of('plate_creep') == 'creep of the plate (plate_creep)' and words_of('own') == 'own'


def test_all_missing_effects_are_explained_and_added(opened):
    """Each by its title; one button adds all; their sizes stay in sight, and what to do is said."""
    page = opened('twice.csv')
    for name in ('frame_drift', 'table_zero_drift'):
        for words in (MEANINGS[name].plain, MEANINGS[name].look):
            expect(page.get_by_test_id('verdict-causes')).to_contain_text(words)
    expect(page.get_by_test_id('verdict-add')).to_contain_text('Add all 2')
    page.get_by_test_id('verdict-add').click()
    expect(page.get_by_test_id('verdict')).to_have_class(re.compile(r'\bgood\b'))
    expect(page.get_by_test_id('verdict-action')).to_contain_text(
        'Compensated numerically; the cause remains to be eliminated')
    expect(page.get_by_test_id('size-frame_drift')).to_contain_text('µm/h')
    expect(page.get_by_test_id('size-table_zero_drift')).to_contain_text('µrad/h')
    page.keyboard.press('u')
    judged(page, 'bad')


def test_the_result_is_on_the_first_screen(opened):
    """The six ranges with U, without scrolling."""
    page = opened()
    expect(page.get_by_test_id('errors')).to_contain_text('all explanations averaged')
    box = page.get_by_test_id('errors').get_by_role('table').first.bounding_box()
    assert box['y'] + box['height'] < 800


@pytest.mark.parametrize('width, name', [(1280, 'plate_creep'), (390, 'ball_creep')])
def test_the_answer_of_a_preview_is_in_view(opened, width, name):
    """Wherever it was asked; with a sign while it is calculated; before and after in the colours of the report."""
    page = opened(width=width)
    page.get_by_text('Another effect of the library').click()
    page.get_by_test_id('other-effect').fill(name)
    page.get_by_role('option').first.click()
    page.get_by_test_id('other-preview').scroll_into_view_if_needed()
    page.evaluate('''() => {
        const card = document.querySelector('[data-testid=preview-busy]');
        new MutationObserver(() => { window.busy ||= card.checkVisibility(); })
            .observe(document.body, {subtree: true, attributes: true, childList: true}); }''')
    page.get_by_test_id('other-preview').click()
    expect(page.get_by_test_id('preview-title')).to_have_text(f'Preview: with {words_of(name)}')
    expect(page.get_by_test_id('preview-words')).to_be_in_viewport(ratio=1)
    expect(page.get_by_test_id('preview-add')).to_be_in_viewport(ratio=1)
    expect(page.get_by_test_id('preview-busy')).to_be_hidden()
    assert page.evaluate('window.busy')
    page.wait_for_function('''expected => {
        const lines = [...document.querySelectorAll('[data-testid=curves] .scatterlayer .js-line')];
        return expected.every(colour => lines.some(one => one.style.stroke === colour)); }''', arg=[
        f'rgb{tuple(bytes.fromhex(colour[1:]))}' for colour in (BEFORE, AFTER)])
    page.get_by_test_id('preview-drop').click()
    expect(page.get_by_test_id('preview-words')).to_be_hidden()


def test_the_page_says_what_it_is(opened):
    """To a screen reader: its language, one main part."""
    page = opened()
    assert page.evaluate('document.documentElement.lang').startswith('en')
    assert page.locator('main, [role=main]').count() == 1


def test_the_focus_is_seen(opened):
    """On everything that the Tab key reaches."""
    page = opened()
    seen = []
    for _ in range(25):
        page.keyboard.press('Tab')
        seen.append(page.evaluate('''() => {
            const one = document.activeElement, look = getComputedStyle(one);
            const around = getComputedStyle(one.closest('.q-field__control') || one);
            return [one.outerHTML.slice(0, 80), look.outlineStyle, parseFloat(look.outlineWidth) >= 2]; }'''))
    assert [one for one in seen if one[1:] != ['solid', True] and '<body' not in one[0]] == []


@pytest.mark.parametrize('width', [1280, 768, 390])
def test_nothing_overlaps(opened, width):
    """Neither buttons and headings, nor the texts of a figure; and the page is no wider than the screen."""
    page = opened('twice.csv', width)
    for figure in ('curves', 'maps', 'times'):
        expect(page.locator(f'[data-testid={figure}] .main-svg text').first).to_be_visible()
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    for chosen in ('button, .q-tab, h1, h2', '.js-plotly-plot text'):
        assert overlapping(page.evaluate(BOXES, chosen)) == []


def test_the_report_is_no_wider_than_the_screen(page, drifting, tmp_path):
    """Down to a telephone; wide tables scroll by themselves."""
    (tmp_path / 'report.html').write_text(report_html(summarise(open_run(drifting))), 'utf-8')
    page.goto((tmp_path / 'report.html').as_uri())
    for width in (1280, 739, 600, 390):
        page.set_viewport_size({'width': width, 'height': 800})
        assert page.evaluate('document.documentElement.scrollWidth') <= width


def test_every_model_of_the_ladder_has_its_errors(opened):
    """A row for each, as long as its card."""
    page = opened('twice.csv')
    page.get_by_text('Another effect of the library').click()
    for name in ('asynchronous_motion', 'frame_cycle'):
        page.get_by_test_id('other-effect').fill(name)
        page.get_by_role('option').first.click()
        page.get_by_test_id('other-add').click()
        expect(page.get_by_test_id(f'part-{name}')).to_be_visible()
    ladder = page.get_by_test_id('ladder')
    expect(ladder.get_by_role('row')).to_have_count(6)
    assert ladder.evaluate('one => one.scrollWidth <= one.clientWidth')
    for _ in range(2):
        page.keyboard.press('u')
    expect(page.get_by_test_id('part-asynchronous_motion')).to_be_hidden()
    judged(page, 'bad')


def test_hovering_shows_sensible_digits(opened):
    """The size of a reading is in units of the repeatability, and says so."""
    page = opened()
    cells = page.locator('[data-testid=maps-figure] .hm image').first
    cells.scroll_into_view_if_needed()
    box = cells.bounding_box()
    page.mouse.move(box['x'] + 10, box['y'] + 10)
    tip = page.locator('[data-testid=maps-figure] .hoverlayer').first
    expect(tip).to_contain_text('× the repeatability')
    assert re.search(r'x [+−]\d\.\d{3}, y [+−]\d\.\d{3}, z [+−]\d\.\d{3} µm', tip.text_content())
