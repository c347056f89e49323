# SPDX-License-Identifier: Apache-2.0
"""rosette demo --hidden: the analysis of a run, and the envelope beside the answer."""

import contextlib
import io
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from rich.console import Console
from terminal import Terminal

from rosette_ros.analysis import analyse, diagnose
from rosette_ros.cli.hidden_demo import answer, content, show_envelope, visible_strengths, wrongly_named
from rosette_ros.cli.main import main, parse
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.model_file import read_model
from rosette_ros.simulation import Machine, MachineConfig, load_machine
from rosette_ros.simulation.envelope import open_envelope

pytestmark = pytest.mark.long

SEED, BALLS = 3, 6


@pytest.fixture(scope='module')
def shown(tmp_path_factory, module_domain_id):
    """Run the demo once; return what it printed and the folder of its log."""
    runs = tmp_path_factory.mktemp('hidden') / 'runs'
    out = []
    demo = ['demo', '--hidden', SEED, '--balls', BALLS, '-o', runs, '--domain', module_domain_id, '--until', 0.95]
    for words in (demo, ['envelope', '--all']):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert main([*map(str, words), *(map(str, runs.iterdir()) if out else ())]) == 0
        out.append(printed.getvalue())
    return *out, *runs.iterdir()


def test_the_envelope_stays_shut_until_it_is_asked_for(shown):
    """The demo names nothing that is hidden, only how to find it; a person can solve it."""
    out, _, log = shown
    hidden = {one['kind'] for one in open_envelope(log / 'envelope.json').hidden}
    assert hidden
    assert not any(kind in out for kind in (*hidden, *diagnose(read_log(log).to_run()).missing))
    assert 'Blind test sealed. To find out what is hidden:' in out
    assert f'demo --hidden {SEED} --seed 1 --balls {BALLS} --order interleaved --axis 0 0 1' in ' '.join(out.split())
    for verb in ('compare', 'diagnose', 'envelope'):
        assert re.search(rf'^  \S*rosette {verb} {re.escape(str(log))}$', out, re.MULTILINE)
    assert f'sha256 {open_envelope(log / "envelope.json").digest}' in out


def test_the_cell_measures_on_until_the_cause_is_settled(shown):
    """What was added is told, in readings and time."""
    out, _, log = shown
    settled = read_log(log).states[-1].text.removeprefix('error motions are published; ')
    assert settled.startswith('settled: ')
    added, text = read_log(log).to_run().size - BALLS**2, ' '.join(out.split())
    assert (f'After the {BALLS**2} readings of the plan, none was added: {settled}' if not added else
            f'After the {BALLS**2} readings of the plan, {added} were added (') in text


def test_a_key_opens_the_envelope_and_another_leaves_it_shut(tmp_path, module_domain_id):
    """On a terminal: Enter tells the whole story; Ctrl-C ends with the envelope shut."""
    demo = [sys.executable, '-m', 'rosette_ros.cli.main', 'demo', '--hidden', SEED, '--balls', BALLS, '-o', tmp_path,
            '--domain', module_domain_id]
    with Terminal(*demo) as screen:
        assert 'Blind test: hidden' not in screen.wait_for('Press Enter to open it now')
        screen.type('\r')
        screen.wait_for('Blind test: hidden and found effects')
        assert screen.end() == 0
    with Terminal(*demo) as screen:
        screen.wait_for('or Ctrl-C to leave it shut')
        assert screen.end('\x03') == 130
    assert 'Blind test: hidden' not in screen.screen and 'Traceback' not in screen.screen


def test_a_run_without_an_envelope_is_refused(refused, make_table):
    """In words."""
    words = refused('envelope', make_table())
    assert 'expected the log of `rosette demo --hidden`, found none with envelope.json' in words


def test_sections_in_order(shown):
    """The answer first, then how it is found, in order; no colour in a pipe."""
    demo, out, log = shown
    heads = re.findall(r'^(\d)  (\w+)', out, re.MULTILINE)
    assert heads == [('1', 'evaluate'), ('2', 'compare'), ('3', 'diagnose'), ('4', 'add'), ('5', 'advise')]
    assert out.index('Blind test: hidden') < out.index('1  evaluate')
    digests = re.findall(r'sha256 ([0-9a-f]{64})', out)
    assert digests == [open_envelope(log / 'envelope.json').digest]
    assert f'rosette demo --hidden {SEED}' in demo
    assert f'{BALLS} balls, order interleaved' in demo
    assert '\x1b' not in out


def test_what_is_shown_is_in_the_files(shown):
    """The envelope holds what the machine file draws; the model is what the log's run lacks."""
    _, out, log = shown
    written = yaml.safe_load((log / 'machine.yaml').read_text())
    assert written['hidden']['seed'] == SEED
    machine = Machine(load_machine(log / 'machine.yaml'))
    envelope = open_envelope(log / 'envelope.json')
    assert [hidden['kind'] for hidden in envelope.hidden] == [
        effect.kind for effect in machine.hidden]
    found = diagnose(read_log(log).to_run())
    assert set(found.missing) <= set(read_model(log / 'model.yaml').names)
    last = out.split('Blind test: hidden and found effects')[1].split('1  evaluate')[0]
    for hidden in envelope.hidden:
        line = next(line for line in last.splitlines() if line.startswith(hidden['kind']))
        assert ('named' in line) or ('too small' in line) or ('cannot show it' in line)


def test_the_ladder_is_that_of_the_model(shown):
    """Base model first, then what was added."""
    _, out, log = shown
    ladder = out.split('4  add')[1].split('5  advise')[0]
    added = [line.split()[1] for line in ladder.splitlines() if line.startswith('+ ')]
    assert added == [term.name for term in read_model(log / 'model.yaml').terms]
    run = read_log(log).to_run()
    assert f'{1e6 * analyse(run).rms:.3f}' in ladder


def test_a_drawn_seed_is_not_the_same_twice():
    """Without a seed the machine is new each time."""
    assert len({parse(['demo', '--hidden']).hidden for _ in range(20)}) > 15
    assert parse(['demo', '--hidden', '7']).hidden == 7


def test_visible_strength_is_that_of_the_machine_alone():
    """A drift along z, in σ: of 36 heights the base model takes up 5 n - 6 = 24, evenly."""
    config = MachineConfig().changed(seed=1, plate={'balls': 6})
    run = Machine(config).run(plan(6, 'random', 1))
    drift = {'kind': 'frame_drift', 'rate_um_per_h': [0.0, 0.0, 3.0]}
    begin, (one, two) = visible_strengths(config, run, (drift, {**drift, 'rate_um_per_h': [0, 0, 6.0]}))
    assert 600 < begin < 1000  # 22 balls are measured before, some 35 s each
    hours = (run.time - run.time.mean()) / 3600
    assert two == pytest.approx(2 * one, rel=0.02)
    whole = 3.0 / 0.1 * np.linalg.norm(hours)
    assert one / whole == pytest.approx(np.sqrt(12 / 36), rel=0.15)


@pytest.mark.parametrize(('kind', 'strength', 'words'), [
    ('frame_drift', 30.0, 'named'), ('frame_warmup', 30.0, 'named as frame_drift'),
    ('table_backlash', 0.1, 'this order cannot show it'), ('plate_warp', 5.0, 'too small to be named'),
    ('plate_creep', 40.0, 'not named'),
])
def test_answers(kind, strength, words):
    """Each way in which a diagnosis can be right or wrong has its words."""
    claimed = SimpleNamespace(name='frame_drift', claimed=True, look_alikes=('frame_warmup',))
    found = SimpleNamespace(missing=('frame_drift',), candidates=(claimed,),
                            invisible=('table_backlash',), unexplained=False)
    assert words in answer(kind, strength, found, found.missing)[0]
    wrong = [] if kind in ('frame_drift', 'frame_warmup') else ['frame_drift']
    assert wrongly_named([kind], found, found.missing) == wrong


def test_the_model_of_the_user_is_judged(shown, tmp_path, rosette):
    """The answer first: what it found, what it lacks, what it has too much; the long list only on request."""
    *_, log = shown
    kinds = [one['kind'] for one in open_envelope(log / 'envelope.json').hidden]
    (tmp_path / 'mine.yaml').write_text(f'effects: [{kinds[0]}, plate_creep]\n')
    lines = rosette('envelope', log, '--model', tmp_path / 'mine.yaml').out.splitlines()
    said = ' '.join(lines[2:6])
    assert said.startswith('The model of ') and ' found: ' in said and ' superfluous: ' in said
    assert len(lines) < 40
    (tmp_path / 'all.yaml').write_text(f'effects: [{", ".join(kinds)}]\n')
    assert 'superfluous' not in rosette('envelope', log, '--model', tmp_path / 'all.yaml').out


def test_content_is_short():
    """Three decimals, vectors in brackets."""
    assert content({'kind': 'frame_step', 'at_h': 0.82612, 'step_um': (0.5, -0.25, 0.0)}, 0.0) == (
        'at 49.6 min, step_um (0.5, −0.25, 0)')


def test_times_count_from_the_first_reading():
    """A step 49.6 min after the machine was switched on is 34.6 min after a run that began 15 min after that."""
    assert content({'kind': 'frame_step', 'at_h': 0.82612}, 900.0) == 'at 34.6 min'


def test_what_was_over_before_a_run_is_not_missed_in_it(rosette, tmp_path):
    """Seed 11 shakes one reading of run 1; a diagnosis that names nothing has missed it there, but not in run 2."""
    made = rosette('demo', '--offline', '--hidden', 11, '--balls', 6, '--runs', 2, '--output', tmp_path)
    assert made.code == 0, made.err
    assert 'beside what is found in run 1 alone' in made.out
    nothing = SimpleNamespace(candidates=(), invisible=(), unexplained=False)
    told = []
    for log in sorted(tmp_path.iterdir()):
        with io.StringIO() as screen:
            show_envelope(Console(file=screen, width=120), load_machine(log / 'machine.yaml'), log,
                          read_log(log).to_run(), nothing, ())
            told.append(' '.join(screen.getvalue().split()))
    assert 'The diagnosis: missed: ' in told[0] and re.search(r'at 11[.]6 min, .* 25[.]9 σ not named', told[0])
    assert 'The diagnosis: not to be seen in this run: ' in told[1]
    assert re.search(r'at −21[.]3 min, .* 0 σ too small to be named', told[1])


def test_the_strength_is_that_in_the_readings_of_the_run():
    """What warms up is strong in the first run, nearly over in the second: equal to the machine without its noise."""
    hidden = {'kind': 'table_warmup', 'growth_um': 2.0, 'scale_turns': 3.0}
    config = MachineConfig().changed(seed=2, plate={'balls': 6})
    machine = Machine(config.changed(hidden=[hidden]))
    strengths = []
    for seed in (1, 2):
        state = machine.state
        run, _, readings = machine.calibrate(plan(6, 'interleaved', seed))
        begin, (strength,) = visible_strengths(config, run, (hidden,), state)
        assert begin == pytest.approx(readings.time[0], abs=1e-3)
        strengths.append(strength)
    assert strengths[0] > 20 * strengths[1]
