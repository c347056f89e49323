# SPDX-License-Identifier: Apache-2.0
"""The table of made-up records, and the command that prints, writes and compares it."""

import json
from types import SimpleNamespace

import pytest

from benchmarks.blind import Trial, command
from benchmarks.blind.command import BEGIN, END, main, work, write_page
from benchmarks.blind.table import interval, table


def record(name, judged, kind='white', strength=0.0, probability=None, true=True, covered=0.95, **more):
    """Return a record."""
    claims = [] if probability is None else [{'probability': probability, 'true': true}]
    return {'trial': name, 'set': name.split()[0], 'judged': judged, 'noise': kind, 'strength': strength,
            'claims': claims, 'covered': [covered] * 6, 'order': 'row', **more}


def level(probability, true, law_true=None, certain=False):
    """Return a level as a record has it after it was judged."""
    return {'probability': probability, 'true': true, 'complete': bool(law_true), 'law_true': law_true,
            'law_certain': certain}


RECORDS = [
    record('white 1', 'right'), record('white 2', 'wrong name', probability=0.6, true=False),
    record('noise 1', 'right', 'ar_0.3', covered=1.0), record('library 1', 'right', strength=12.0, probability=0.99),
    record('open 1', 'wrong name', strength=16.0, probability=0.98, true=False),
    record('open 2', 'right variable', strength=40.0), record('open 3', 'fair name', strength=40.0, probability=1.0)]


def test_the_interval_is_exact():
    """Clopper-Pearson: none of 100 gives 0 to 1 − 0.025^(1/100) = 3.6 %; all of 10 0.025^(1/10) = 69.2 % to 1."""
    assert interval(0, 100) == '0.0–3.6 %' and interval(10, 10) == '69.2–100.0 %' and interval(0, 0) == ''


def test_the_table_counts_what_is_asked():
    """False names, right ones, what is known of the open world, coverage and calibration; no line for what was not."""
    text = table(RECORDS)
    for line in ('white noise: false names | at most 1 % | 1 of 2 (50.0 %) | 1.3–98.7 % |',
                 'one effect of 12 σ: right | at least 97 % at 12 σ | 1 of 1 (100.0 %) |',
                 'open world, all: wrong names | at most 5 % | 1 of 3 (33.3 %) |',
                 'open world, all: known | at least 65 % | 2 of 3 (66.7 %) |',
                 '| ar_0.3 | 0 of 1 (0.0 %) |', '| all | 1 of 3 (33.3 %) | 0.8–90.6 % | 96.7 ± 3.3 % |',
                 '| all sets | 0.97–1 | 0.990 | 2 of 3 (66.7 %) |', '| open world | 0.97–1 | 0.990 | 1 of 2 (50.0 %) |',
                 '| all sets | 0.5–0.7 | 0.600 | 0 of 1 (0.0 %) |'):
        assert line in text
    assert '6 σ' not in text.replace('16 σ', '') and '0.7–0.9' not in text and 'before' not in text


LEVELS = [
    record('crossed 1', 'right variable', order='row', levels=[level(0.98, True), level(0.8, False)], regret=0.25),
    record('crossed 2', 'fair name', order='row', levels=[level(0.8, True, True, True)], regret=0.05),
    record('crossed 3', 'wrong name', order='column', levels=[level(0.9, True, False, True)], regret=-3.0),
    record('crossed 4', 'nothing', order='column', levels=[], regret=None),
    record('left_out 1', 'other', order='there_and_back', levels=[level(0.6, True, False, False)]),
    record('library 1', 'right', order='row')]


def test_levels_are_counted_by_order():
    """Levels that are found count, each by itself; a law is wrong where it is certain; regret counts where known."""
    text = table(LEVELS)
    for line in ('| crossed | row | 1 of 1 (100.0 %) | 2.5–100.0 % | 0 of 1 (0.0 %) | 0.0–97.5 % | '
                 '0 of 2 (0.0 %) | 0.0–84.2 % | '
                 '2 of 2 (100.0 %) | 15.8–100.0 % | 1 of 2 (50.0 %) | 1.3–98.7 % | 0.3 |',
                 '| crossed | column | 1 of 1 (100.0 %) | 2.5–100.0 % | 0 of 1 (0.0 %) | 0.0–97.5 % | '
                 '1 of 2 (50.0 %) | 1.3–98.7 % | '
                 '0 of 2 (0.0 %) | 0.0–84.2 % | 0 of 1 (0.0 %) | 0.0–97.5 % | 0.0 |',
                 '| crossed | all | 2 of 2 (100.0 %)', '| 1 of 3 (33.3 %) | 0.8–90.6 % | 0.3 |',
                 '| left_out | there_and_back |  |  |  |  | 0 of 1 (0.0 %) | 0.0–97.5 % | '
                 '0 of 1 (0.0 %) | 0.0–97.5 % |  |  |  |',
                 'open world in each order, all: wrong names |  | 1 of 4 (25.0 %)',
                 'an effect left out of the library, all: known |  | 0 of 1 (0.0 %)',
                 '| level 1, all sets | 0.7–0.9 | 0.800 | 1 of 2 (50.0 %) |',
                 '| level 1, open world | 0.9–0.97 | 0.900 | 1 of 1 (100.0 %) |',
                 '| level 1, left out | 0.5–0.7 | 0.600 | 1 of 1 (100.0 %) |'):
        assert line in text
    assert '| library |' not in text and '| left_out | row |' not in text
    head = next(line for line in table(LEVELS, LEVELS).splitlines() if line.startswith('| set |'))
    assert head.endswith('| sum of regret, before |') and head.count('before') == 11


def test_what_is_left_out_is_left_out_of_the_diagnosis(monkeypatch):
    """The diagnosis gets the name that its library is to lack; other runs do without, and hidden ones are skipped."""
    asked = []
    monkeypatch.setattr(command, 'diagnose', lambda run, **what: asked.append(what) or SimpleNamespace())
    monkeypatch.setattr(Trial, 'judge', lambda trial, found, truth: {'judged': 'right'})
    drift = Trial('left_out', 1, ('frame_drift',), 16.0, orders=('random',), n=8, left_out='frame_drift')
    assert work(drift)['judged'] == work(Trial('white', 1, orders=('row',), n=8))['judged'] == 'right'
    assert asked == [{'without': 'frame_drift'}, {'without': ''}]
    told = work(Trial('left_out', 1, ('frame_drift',), 16.0, orders=('row',), n=8, left_out='frame_drift'))
    assert 'expected an order that shows it, found visible shares' in told['skipped'] and len(asked) == 2


def test_old_and_new_are_compared_on_the_same_runs():
    """Runs that one of them does not have do not count."""
    old = [record('white 1', 'wrong name'), record('white 2', 'wrong name'), record('white 3', 'right')]
    text = table(RECORDS, old)
    assert '2 runs that both versions diagnosed.' in text
    assert '1 of 2 (50.0 %) | 1.3–98.7 % | 2 of 2 (100.0 %) | 15.8–100.0 % |' in text and 'open world' not in text


def test_the_command_writes_compares_and_fills_a_page(tmp_path, capsys):
    """Two short runs; then the same compared with themselves."""
    file, page = tmp_path / 'blind.json', tmp_path / 'page.md'
    page.write_text(f'before\n{BEGIN}\nold\n{END}\nafter\n')
    asked = ['--sets', 'white', '--seeds', '1', '--share', '1/5', '--balls', '6', '--jobs', '1']
    assert main([*asked, '--json', str(file), '--page', str(page)]) == 0
    written = json.loads(file.read_text())
    assert [one['judged'] for one in written] == ['right', 'right'] and written[0]['trial'].startswith('white white')
    text = page.read_text()
    assert text.startswith(f'before\n{BEGIN}\n2 runs of 6 balls') and text.endswith(f'|\n{END}\nafter\n')
    assert 'old' not in text and 'white noise: false names | at most 1 % | 0 of 2' in capsys.readouterr().out
    assert main([*asked, '--compare', str(file)]) == 0
    assert '2 runs that both versions diagnosed.' in capsys.readouterr().out


def test_runs_that_would_not_show_it_are_counted(monkeypatch, capsys):
    """They are neither failed nor diagnosed."""
    monkeypatch.setattr(command, 'trials', lambda *what: [
        Trial('left_out', seed, ('frame_drift',), 16.0, orders=('row',), n=8, left_out='frame_drift')
        for seed in (1, 2)])
    assert main(['--jobs', '1']) == 0
    assert '0 runs of 12 balls' in (told := capsys.readouterr().out) and '2 more would not show what they hide.' in told


@pytest.mark.parametrize('share', ['0/2', '3/2', 'half'])
def test_shares_are_checked(share, capsys):
    """A part of the runs is one of so many."""
    with pytest.raises(SystemExit):
        main(['--share', share])
    assert f'expected K/M with 1 ≤ K ≤ M, found {share}' in capsys.readouterr().err


def test_a_page_without_marks_is_refused(tmp_path):
    """It stays as it is."""
    page = tmp_path / 'page.md'
    page.write_text('text\n')
    with pytest.raises(ValueError, match='between which the table is written'):
        write_page(page, 'table')
    assert page.read_text() == 'text\n'
