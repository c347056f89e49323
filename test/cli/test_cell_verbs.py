# SPDX-License-Identifier: Apache-2.0
"""demo, replay and calibrate: the verbs that talk to a cell, over DDS in separate processes."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

from rosette_ros.analysis import judge
from rosette_ros.cli.cell import log_folder
from rosette_ros.core.run.records import CURVES
from rosette_ros.io.log_reader import read_log
from rosette_ros.words.verdict_words import verdict_text

pytestmark = pytest.mark.long

COMMAND = (sys.executable, '-m', 'rosette_ros.cli.main')
TIMEOUT = 300
BALLS, REPEATS = 6, 3
SILENT = {'kind': 'silent', 'at': [REPEATS + 2 * BALLS + 1], 'always': True}
"""The first target of the run has no answer: it is still on when it is cancelled."""


@dataclass(frozen=True)
class Demo:
    """A demo that has run: what it printed, the folder of its run, its domain."""

    out: str
    err: str
    log: Path
    domain: int


def start(*words, **settings):
    """Start a command in a process of its own."""
    return subprocess.Popen([*COMMAND, *map(str, words)], stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True,
                            env={**os.environ, 'PYTHONUNBUFFERED': '1'}, **settings)


IDENTITY = '''schema: rosette-identity/1
certificate: {number: "C-5"}
laboratory: {country: DE}
table: {serial: T-77}
tolerances: {EXC: 1 µm}
'''


@pytest.fixture(scope='module')
def demo(tmp_path_factory, module_domain_id):
    """Run `rosette demo` once for all tests of this file."""
    folder = tmp_path_factory.mktemp('demo')
    (folder / 'who.yaml').write_text(IDENTITY)
    with start('demo', '--balls', 5, '--order', 'random', '--seed', 4, '-o', folder / 'runs', '--identity',
               folder / 'who.yaml',
               '--domain', module_domain_id) as process:
        out, err = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0, err
    [log] = (folder / 'runs').iterdir()
    return Demo(out, err, log, module_domain_id)


def published(log):
    """Return the evaluation's keys with what the evaluator published in a log: curves and u, result and as modelled."""
    found = read_log(log).latest_error_motions()
    keys = {curve: f'{curve}_{"m" if curve.startswith("ct") else "rad"}' for curve in CURVES}
    return [({keys[curve]: motions[curve].tolist() for curve in CURVES},
             {keys[curve]: motions.uncertainty(curve).tolist() for curve in CURVES})
            for motions in (found.motions, found.modelled)]


def test_demo_prints_every_part(demo):
    """Phases, curves, fit, truth, picture, log, what to do next; no colour in a pipe."""
    for words in ('repeatability check', 'table axis and frame', 'run', 'drift check'):
        assert words in demo.err
    assert '25 balls' in demo.err
    for words in ('5 balls on R = 182.5 mm, 25 ball centres', 'EXC', 'expanded uncertainty (k = 2)',
                  'The model fits', 'eccentricity', 'Difference to the truth: rms',
                  'expected 0.', f'rosette evaluate {demo.log}'):
        assert words in demo.out
    assert '\x1b' not in demo.out + demo.err


def test_the_log_says_who_what_and_where(demo, rosette, tmp_path):
    """As the cell was told; info, report and certificate show it."""
    out = rosette('info', demo.log).out
    assert 'Rotary table' in out and 'No. T-77' in out and 'EXC 1 µm' in out
    assert 'No. T-77' in (demo.log / 'report.html').read_text(encoding='utf-8')
    xml = tmp_path / 'cert.xml'
    assert rosette('certificate', demo.log, '-o', xml).code == 0
    assert '>T-77<' in xml.read_text(encoding='utf-8') and 'SIMULATED' in xml.read_text(encoding='utf-8')
    assert rosette('certificate', '--verify', xml, demo.log).code == 0


def test_demo_and_evaluate_print_the_same_verdict(demo, rosette):
    """Decided once, in the same words."""
    verdict = verdict_text(judge(read_log(demo.log).to_run()))
    for out in (demo.out, rosette('evaluate', demo.log).out):
        assert verdict.sentence in ' '.join(out.split())


def test_demo_leaves_log_picture_and_machine(demo):
    """The picture is a PNG of some size, the machine a file that makes the same machine."""
    names = {path.name for path in demo.log.iterdir()}
    assert names == {f'{demo.log.name}_0.mcap', 'metadata.yaml', 'six-curves.png', 'machine.yaml',
                     'report.html'}
    picture = (demo.log / 'six-curves.png').read_bytes()
    assert picture.startswith(b'\x89PNG\r\n')
    assert len(picture) > 50_000
    report = (demo.log / 'report.html').read_text(encoding='utf-8')
    assert f'rosette report {demo.log}' in report
    assert f'{demo.log.name}_0.mcap' in report


def test_demo_agrees_with_the_truth(demo):
    """The rms of 30 normalised errors, 20 of them free, is 1 within four standard deviations."""
    [line] = [line for line in demo.out.splitlines() if 'Difference to the truth: rms' in line]
    rms, low, high = map(float, re.findall(r'\d\.\d+', line))
    assert (1 - low, high - 1) == pytest.approx(2 * (2 / np.sqrt(40),), abs=0.01)
    assert abs(rms - 1) < 2 * (high - 1)


def test_evaluate_equals_what_was_published_bit_for_bit(demo, rosette):
    """Offline and online are one calculation."""
    got = json.loads(rosette('evaluate', demo.log, '--json').out)
    (curves, u), (modelled, u_modelled) = published(demo.log)
    assert {key: got['result'][key] for key in curves} == curves
    assert got['result']['U'] == {key: [2 * one for one in values] for key, values in u.items()}
    assert {key: got[key] for key in modelled} == modelled
    assert got['u'] == u_modelled


def test_info_counts_every_phase(demo, rosette):
    """Ten repeats, two rings for the alignment, n * n, one drift check."""
    [run] = json.loads(rosette('info', demo.log, '--json').out)['runs']
    assert {name: phase['answered'] for name, phase in run['phases'].items()} == {
        'repeatability': 10, 'alignment': 10, 'run': 25, 'drift_check': 1}
    assert run['order'] == 'random'
    assert run['published_curves'] == 1
    assert run['ended'] == 'done: error motions are published'


def test_replay_gives_the_same_numbers_again(demo, rosette):
    """Onto a fresh evaluator, which replay starts itself where there is none."""
    answer = rosette('replay', demo.log, '--domain', demo.domain)
    assert answer.err == ''
    assert answer.code == 0
    assert 'No evaluator in this ROS domain: starting one for this replay.' in answer.out
    assert 'equal to those in the log, bit for bit' in answer.out


def test_replay_publishes_in_another_namespace(demo, rosette):
    """Also the names that all nodes of a domain share; the numbers are the same."""
    answer = rosette('replay', demo.log, '--domain', demo.domain, '--namespace', 'cell2')
    assert (answer.code, answer.err) == (0, '')
    assert 'equal to those in the log, bit for bit' in answer.out


def test_a_trial_of_the_cmm_warns_nobody(domain_id, make_cell, tmp_path, rosette, wait_until):
    """Beside a running cell: the sequencer says what goes on, and that the cell is complete again."""
    with make_cell(domain_id, tmp_path, balls=BALLS) as cell:
        wait_until(lambda: 'the cell is complete' in cell.processes['sequencer'].text())
        assert rosette('check-cmm', '--domain', domain_id, '--repeats', 2).code == 0
        wait_until(lambda: cell.processes['sequencer'].text().count('the cell is complete') == 2)
        assert [name for name, one in cell.processes.items() if '[WARN]' in one.text() or '[ERROR]' in one.text()] == []


def test_calibrate_cancel_and_refusal(domain_id, make_cell, tmp_path, rosette, refused):
    """A run to its end, a refused goal, a replay that is refused beside a live cell, Ctrl-C."""
    with make_cell(domain_id, tmp_path, balls=BALLS) as cell:
        words = ('calibrate', '--domain', domain_id)
        assert 'calibration refused: goal: order: expected one of row, diagonal' in refused(
            *words, '--order', 'zigzag')
        plate = tmp_path / 'plate.yaml'
        plate.write_text('schema: rosette-plate/1\nazimuth_deg: [0, 20, 60, 80, 140, 200, 300]\nradius_mm: 182.5\n')
        assert ('the CMM cannot measure this plan: expected a target for 6 balls on a circle of radius 0.1825 m, '
                'found 18 '
                'balls, 0.1825 m') in refused(*words, '--plate', plate, '--balls', 18)
        assert not cell.log_dir.exists(), 'nothing was begun'
        done = rosette(*words, '--order', 'row', '--options', 'repeats: 4')
        assert done.code == 0
        assert 'expanded uncertainty (k = 2)' in done.out
        [log] = cell.log_dir.iterdir()
        assert f'Log: {log}' in done.out
        assert log.name.endswith('_row')
        verdict = verdict_text(judge(read_log(log).to_run()))
        for out in (done.out, rosette('evaluate', log).out):
            assert verdict.sentence in ' '.join(out.split())
        assert '4 balls' in done.err
        alone = rosette(*words, '--order', 'row', '--joint-with', 'nosuch')
        assert (alone.code, 'expanded uncertainty (k = 2)' in alone.out) == (2, True)
        assert alone.err.splitlines()[-1].startswith(
            'rosette: calibrate: --joint-with: the runs were not evaluated as one: error motions are published; '
            f'jointly with nosuch: run_id: expected one of {log.name}, ')
        assert rosette(*words, '--order', 'row', '--joint-with', log).code == 0
        assert 'a live cell is on this graph' in refused('replay', log, '--domain', domain_id)
        machine = yaml.safe_load(cell.machine.read_text())
        cell.machine.write_text(yaml.safe_dump({**machine, 'faults': [SILENT]}))
        with start(*words, '--order', 'column') as process:
            for line in process.stderr:
                if 'table axis and frame' in line:
                    process.send_signal(signal.SIGINT)
                    break
            _, err = process.communicate(timeout=TIMEOUT)
        assert process.returncode == 130
        assert 'cancelled on request; what was measured is in ' in err
        cell.check()


def test_calibrate_without_a_cell(domain_id, refused):
    """In words, after some seconds."""
    assert 'cell /rosette: expected a sequencer within' in refused(
        'calibrate', '--domain', domain_id)


def test_a_parameter_file_says_where_logs_go(tmp_path):
    """Of the recorder, in whichever namespace; where it says nothing, the usual folder."""
    params = tmp_path / 'cell.yaml'
    for section, folder in (('/**/recorder', '/data/logs'), ('recorder', 'here'), ('/**/sequencer', 'rosette-runs')):
        params.write_text(yaml.safe_dump({section: {'ros__parameters': {'log_dir': folder}}}))
        assert log_folder(str(params)) == folder
    assert log_folder(None) == 'rosette-runs'


@pytest.mark.parametrize('text', [
    'rosette: {recorder: {ros__parameters: {log_dir: /data}}}', 'rosette/recorder: {ros__parameters: {log_dir: /data}}',
    '/**: {ros__parameters: {log_dir: /data}}', '/rosette: {"*": {ros__parameters: {log_dir: /data}}}',
    '/**: {ros__parameters: {log_dir: a}}\n/**/recorder: {ros__parameters: {log_dir: /data}}'])
def test_sections_in_every_form_that_ros_reads(tmp_path, text):
    """Nested, with wildcards; the last one holds, as in ROS."""
    params = tmp_path / 'cell.yaml'
    params.write_text(text)
    assert log_folder(str(params)) == '/data'


def test_a_machine_without_the_places_of_the_plate_is_refused(tmp_path, refused):
    """Before anything is started: 7 balls on 18 places want a machine with 18 places."""
    plate, machine, params = (tmp_path / name for name in ('plate.yaml', 'machine.yaml', 'cell.yaml'))
    plate.write_text('schema: rosette-plate/1\nazimuth_deg: [0, 20, 60, 80, 140, 200, 300]\nradius_mm: 100\n')
    machine.write_text('plate: {balls: 12, circle_radius_mm: 100}\n')
    stated = f'sequencer: {{ros__parameters: {{plate: {{balls: 18, file: {plate}}}}}}}'
    for text in (f'/**/{stated}\n', f'rosette: {{{stated}}}\n'):
        params.write_text(text)
        words = refused('cell', '--machine', machine, '--params', params)
        assert f'{machine}: plate: expected balls: 18 and circle_radius_mm: 100, the places of {plate}' in words
        assert words.strip().endswith('found 12 and 100')
