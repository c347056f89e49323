# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: verdict, add and remove, save, upload of what is broken."""

import yaml
from page_steps import choose, choose_run, judged, open_path
from playwright.sync_api import expect

from rosette_ros.cli.main import main
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig

BROKEN = 'seq,table_position\n1,2\n'


def number(page, mark):
    """Return a number that the page shows, µm."""
    return float(page.get_by_test_id(mark).inner_text())


def test_add_the_missing_effect_and_take_it_out_again(shared_page):
    """Verdict, first candidate, error down to the noise, undo by removing."""
    page = shared_page
    expect(page.get_by_test_id('verdict-sentence')).to_contain_text('linear probe drift')
    expect(page.get_by_test_id('simulated')).to_contain_text('SIMULATED: the readings are those of a simulated CMM')
    before, noise = number(page, 'rms-fit'), number(page, 'rms-noise')
    assert before > 1.5 * noise

    page.get_by_test_id('verdict-preview').click()
    expect(page.get_by_test_id('preview-words')).to_contain_text('It helps')
    assert number(page, 'rms-fit') == before

    page.get_by_test_id('preview-add').click()
    page.wait_for_function(f'Number(document.querySelector("[data-testid=rms-fit]").innerText) < {before}')
    assert number(page, 'rms-fit') < 1.3 * noise
    judged(page, 'good')
    assert number(page, 'rms-cross-validation') < 1.3 * noise

    page.get_by_test_id('remove-frame_drift').click()
    judged(page, 'bad')
    assert number(page, 'rms-fit') == before


def test_several_runs_as_one(page, tmp_path, start_studio):
    """Two opened runs are evaluated as one; what they share is tested, both senses of turning give a reversal."""
    machine = Machine(MachineConfig().changed(plate={'balls': 6}))
    paths = [tmp_path / f'{order}.csv' for order in ('there_and_back', 'diagonal')]
    for path in paths:
        write_csv(machine.run(plan(6, path.stem)), path)
    with start_studio(tmp_path, *paths) as studio:
        page.goto(studio.address)
        judged(page, 'good')
        page.get_by_test_id('joint').click()
        page.get_by_test_id('joint-go').click()
        expect(page.get_by_test_id('joint-verdict')).to_contain_text('The 2 runs fit one model')
        result = page.get_by_test_id('joint-result')
        expect(result).to_contain_text('the reversal of all six curves, with its means')
        expect(result).to_contain_text('used; the readings agree with it')
        expect(result.locator('.js-plotly-plot')).to_have_count(2)
        page.close()  # before its studio ends, which it would complain of


def test_the_budget_is_calculated_on_request(shared_page, tmp_path):
    """Contributions, bars and what is not considered; a file of inputs adds lines, a wrong one is refused in words."""
    page = shared_page
    page.get_by_test_id('budget').get_by_text('Uncertainty budget').click()
    result, go = page.get_by_test_id('budget-result'), page.get_by_test_id('budget-go')
    go.click()
    expect(result).to_contain_text('repeatability x')
    expect(result).to_contain_text('form of the balls (ball_form)')
    expect(result.get_by_test_id('budget-figure').locator('svg')).to_be_visible()
    inputs = tmp_path / 'inputs.yaml'
    inputs.write_text('schema: rosette-budget/1\nradius: {u_um: 1.0, words: MPE}\n')
    page.get_by_test_id('state').click()
    page.get_by_test_id('state-path').fill(str(tmp_path / 'none.yaml'))
    page.get_by_test_id('state-take').click()
    expect(page.get_by_test_id('state-error')).to_contain_text('none.yaml: expected')
    page.get_by_test_id('state-path').fill(str(inputs))
    page.get_by_test_id('state-take').click()
    page.get_by_test_id('state-inputs').get_by_text('Environment and inputs of U').click()
    expect(page.get_by_test_id('input-radius-u_um')).to_have_value('1')
    page.get_by_test_id('state-apply').click()
    expect(result).not_to_contain_text('repeatability x')  # that of other inputs
    go.click()
    expect(result.locator('td', has_text='radius').first).to_be_visible()
    page.get_by_test_id('state').click()
    page.get_by_test_id('state-inputs').get_by_text('Environment and inputs of U').click()
    page.get_by_test_id('input-radius-u_um').fill('')
    page.get_by_test_id('input-radius-words').fill('')
    choose(page, 'state-environment', 'laboratory')
    page.get_by_test_id('state-apply').click()
    go.click()
    expect(result).to_contain_text('What this order cannot show, in U (environment: laboratory)')
    page.get_by_test_id('state').click()
    page.get_by_test_id('state-inputs').get_by_text('Environment and inputs of U').click()
    choose(page, 'state-environment', 'none stated')
    page.get_by_test_id('state-apply').click()
    expect(page.get_by_test_id('state-apply')).to_be_hidden()


def test_who_what_where_makes_a_certificate_and_a_correction(page, studio, tmp_path):
    """Stated in a form: tolerances in the result, what lacks by name, files to save; a correction is seen before."""
    page.goto(studio.address)
    judged(page, 'bad')
    page.get_by_test_id('certificate').click()
    page.get_by_test_id('certificate-make').click()
    expect(page.get_by_test_id('certificate-error')).to_contain_text('expected certificate number')
    page.get_by_test_id('certificate-state').click()
    page.get_by_test_id('state-table-serial').fill('RT-7')
    page.get_by_test_id('tolerance-ctx').fill('1 mrad')
    for heading, mark in (('Certificate and signature', 'state-certificate'), ('Laboratory', 'state-laboratory'),
                          ('Conditions and days', 'state-conditions')):
        page.get_by_test_id(mark).get_by_text(heading, exact=True).click()
    for mark, words in (('certificate-number', 'K-1'), ('laboratory-country', 'DE'), ('measured-begin', '2026-03-01'),
                        ('measured-end', '2026-03-01')):
        page.get_by_test_id(f'state-{mark}').fill(words)
    page.get_by_test_id('state-apply').click()
    expect(page.get_by_test_id('state-error')).to_contain_text('EXC: expected a positive length with its unit')
    page.get_by_test_id('tolerance-ctx').fill('1 µm')
    with page.expect_download() as coming:
        page.get_by_test_id('state-save-identity').click()
    coming.value.save_as(tmp_path / 'identity.yaml')
    assert yaml.safe_load((tmp_path / 'identity.yaml').read_text())['tolerances'] == {'EXC': '1 µm'}
    page.get_by_test_id('state-apply').click()
    expect(page.get_by_test_id('errors').locator('th', has_text='tolerance')).to_have_count(1)
    page.get_by_test_id('certificate-make').click()
    expect(page.get_by_test_id('certificate-preview')).to_contain_text('Error motions of the table')
    for mark, begin in (('xml', b'<?xml'), ('pdf', b'%PDF')):
        with page.expect_download() as coming:
            page.get_by_test_id(f'certificate-{mark}').click()
        coming.value.save_as(tmp_path / mark)
        assert (tmp_path / mark).read_bytes().startswith(begin)
    page.get_by_test_id('certificate-close').click()

    page.get_by_test_id('correction').click()
    expect(page.get_by_test_id('correction-text')).to_contain_text('table: RT-7')
    expect(page.get_by_test_id('correction-figure').locator('.js-line').first).to_be_attached()
    choose(page, 'correction-target', 'HEIDENHAIN')
    expect(page.get_by_test_id('correction-text')).to_contain_text('AXISPOS')
    expect(page.get_by_test_id('correction-preview')).to_contain_text('miss crz by at most')
    with page.expect_download() as coming:
        page.get_by_test_id('correction-save').click()
    coming.value.save_as(tmp_path / 'crz.com')
    assert (tmp_path / 'crz.com').read_text().startswith('BEGIN')


def test_orders_are_compared_with_the_u_that_each_would_give(shared_page):
    """Without an environment sensitivities and times; in one U of both kinds of curves, too."""
    page = shared_page
    page.get_by_test_id('orders').get_by_text('Orders for the next run').click()
    result, go = page.get_by_test_id('orders-result'), page.get_by_test_id('orders-go')
    go.click()
    expect(result).to_contain_text('interleaved')
    expect(result).not_to_contain_text('U ct')
    choose(page, 'orders-environment', 'laboratory')
    go.click()
    expect(result.locator('th', has_text='µrad')).to_have_count(1)
    expect(result.locator('th')).to_have_count(8)  # a column for each effect would break words


def test_touches_are_shown_where_the_log_has_them(shared_page):
    """A table of ball centres has none: the words of the report."""
    page = shared_page
    page.get_by_test_id('touches').get_by_text('Touches').click()
    page.get_by_test_id('touches-go').click()
    expect(page.get_by_test_id('touches-result')).to_contain_text('Single touches are not recorded')


def test_save_model_and_report(shared_page, tmp_path):
    """The model file that the command line reads, and the report."""
    page = shared_page
    page.get_by_test_id('add-frame_drift').click()
    judged(page, 'good')
    with page.expect_download() as coming:
        page.get_by_test_id('save-model').click()
    coming.value.save_as(tmp_path / 'model.yaml')
    model = yaml.safe_load((tmp_path / 'model.yaml').read_text())
    assert model['effects'] == ['frame_drift']
    with page.expect_download() as coming:
        page.get_by_test_id('save-report').click()
    coming.value.save_as(tmp_path / 'report.html')
    text = (tmp_path / 'report.html').read_text()
    assert text.lower().lstrip().startswith('<!doctype html')
    assert 'frame_drift' in text
    page.get_by_test_id('remove-frame_drift').click()
    judged(page, 'bad')


def test_a_broken_upload_is_refused_as_by_the_command_line(shared_page, tmp_path, monkeypatch, capsys):
    """Word for word, up to the name of the program; and a path that does not exist in the words of the command line."""
    broken = tmp_path / 'broken.csv'
    broken.write_text(BROKEN)
    monkeypatch.chdir(tmp_path)
    assert main(['evaluate', 'broken.csv']) == 2
    words = capsys.readouterr().err.strip().removeprefix('rosette: ')
    page = shared_page
    page.get_by_test_id('open').click()
    page.locator('input[type=file]').set_input_files(broken)
    expect(page.get_by_test_id('open-error')).to_have_text(words)
    page.get_by_test_id('open-path').fill(str(tmp_path / 'nothing.csv'))
    page.get_by_test_id('open-go').click()
    expect(page.get_by_test_id('open-error')).to_contain_text('expected a log directory, an .mcap file or a CSV table')
    page.keyboard.press('Escape')
    expect(page.get_by_test_id('open-path')).to_be_hidden()


def test_a_chosen_reading_is_seen_everywhere(shared_page):
    """By a click into a map or by its number: framed there, a line in time and curves, its values in a table."""
    page = shared_page
    maps, times, curves = (page.get_by_test_id(f'{name}-figure') for name in ('maps', 'times', 'curves'))
    expect(curves.locator('.scatterlayer .trace').nth(11)).to_be_attached()
    expect(page.get_by_test_id('polar-figure').locator('svg')).to_be_attached()
    page.get_by_text('Ball plate and CMM', exact=True).click()
    expect(page.get_by_test_id('plate-figure')).to_contain_text('Removed from the plate: eccentricity')
    lines, framed = times.locator('.shapelayer path').count(), maps.locator('.shapelayer path')
    expect(framed).to_have_count(0)
    maps.locator('.draglayer .nsewdrag').first.click()
    expect(framed).to_have_count(3)
    expect(times.locator('.shapelayer path')).to_have_count(lines + 3)
    expect(curves.locator('.shapelayer path')).to_have_count(6)
    facts, chosen = page.get_by_test_id('reading-facts'), page.get_by_test_id('reading')
    expect(facts).to_contain_text('table position')
    number = chosen.input_value()
    chosen.fill('36')
    expect(facts.locator('td').first).to_have_text('36')
    assert number not in ('', '36')
    chosen.fill('')
    expect(framed).to_have_count(0)


def test_errors_of_a_custom_term_are_shown_while_it_is_written(shared_page):
    """In the words of the core; a good one can be added; undo and redo by keyboard."""
    page = shared_page
    page.get_by_text('Custom term', exact=True).click()
    page.get_by_test_id('custom-expression').fill('t*cos(3*gamma)')
    expect(page.get_by_test_id('custom-error')).to_contain_text("found 'gamma'")
    expect(page.get_by_test_id('custom-add')).to_be_disabled()
    page.get_by_test_id('custom-expression').fill('t')
    page.get_by_test_id('custom-name').fill('sinking')
    expect(page.get_by_test_id('custom-error')).to_be_hidden()
    page.get_by_test_id('custom-add').click()
    expect(page.get_by_test_id('part-sinking')).to_be_visible()
    page.get_by_test_id('tab-run').focus()
    page.keyboard.press('u')
    expect(page.get_by_test_id('part-sinking')).to_be_hidden()
    page.keyboard.press('r')
    expect(page.get_by_test_id('part-sinking')).to_be_visible()
    page.keyboard.press('u')
    judged(page, 'bad')


def test_the_keyboard_reaches_the_same(shared_page):
    """Preview, add what is previewed, drop a preview, open and close the list of keys; in a field they are text."""
    page = shared_page
    page.get_by_test_id('tab-run').focus()
    page.keyboard.press('p')
    expect(page.get_by_test_id('preview-words')).to_be_visible()
    page.keyboard.press('Escape')
    expect(page.get_by_test_id('preview-words')).to_be_hidden()
    page.keyboard.press('p')
    expect(page.get_by_test_id('preview-words')).to_be_visible()
    page.keyboard.press('a')
    judged(page, 'good')
    page.keyboard.press('?')
    page.get_by_test_id('help-close').click()
    expect(page.get_by_test_id('help-close')).to_be_hidden()
    page.keyboard.press('u')
    judged(page, 'bad')


def test_a_second_run_is_uploaded_laid_over_and_checked(page, studio, second):
    """Under its own name; curves and differences with U of both runs; what is found in it is confirmed by the first."""
    page.goto(studio.address)
    judged(page, 'bad')
    page.get_by_test_id('open').click()
    page.locator('input[type=file]').set_input_files(second)
    expect(page.get_by_test_id('run')).to_have_value('second.csv')
    judged(page, 'bad')
    page.get_by_test_id('overlay').get_by_text('Runs laid over').click()
    page.get_by_test_id('overlay-go').click()
    expect(page.get_by_test_id('overlay-figure').locator('.scatterlayer .trace')).to_have_count(24)
    expect(page.get_by_test_id('overlay-differences').locator('.scatterlayer .trace')).to_have_count(12)
    expect(page.get_by_test_id('overlay-result')).to_contain_text('with U (k = 2) of both runs')
    page.get_by_text('Check on a second run').click()
    page.get_by_test_id('check-go').click()
    expect(page.get_by_test_id('check-result')).to_contain_text('Linear probe drift is confirmed')


def test_a_run_is_opened_by_its_path_and_another_is_chosen(shared_page, second):
    """The verdict is that of the run that is shown."""
    page = shared_page
    open_path(page, second)
    judged(page, 'bad')
    choose_run(page, 'drifting.csv')
    judged(page, 'bad')
