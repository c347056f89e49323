# SPDX-License-Identifier: Apache-2.0
"""rosette dme check, path and dry-run: what they print, and what they refuse."""

import argparse
import csv
import io
import json
import math
import os
import re
import signal

import numpy as np
import pytest
import yaml
from faulty_proxy import spoiling
from matplotlib.patches import Circle

from rosette_ros.cli import dme
from rosette_ros.cli.main import main
from rosette_ros.core.run.errors import CellError
from rosette_ros.dme.dme_server import ServeSettings, serving
from rosette_ros.dme.dme_settings import client_settings
from rosette_ros.dme.stop_mark import StopMark
from rosette_ros.presentation.plots.touch_plots import probe_path
from rosette_ros.simulation import MachineConfig

pytestmark = pytest.mark.long

CONFIG = MachineConfig().changed(plate={'balls': 4})


@pytest.fixture
def settings(tmp_path):
    """Return a function that writes the settings file for a port, changed in single groups."""

    def write(port=1294, **changes):
        values = client_settings(CONFIG, port)
        values |= {key: {**values.get(key, {}), **value} for key, value in changes.items()}
        path = tmp_path / 'dme.yaml'
        path.write_text(yaml.safe_dump(values), encoding='utf-8')
        return str(path)

    return write


def test_a_server_is_looked_at(settings, capfd):
    """What it says, as JSON; nothing moves, and nothing is changed."""
    with serving(CONFIG, ServeSettings(dialect='2.x')) as (port, server):
        assert main(['dme', 'check', f'localhost:{port}', '--json']) == 0
        found = json.loads(capfd.readouterr().out)
        assert found['passed']
        said = {one['name']: one['text'] for one in found['checks']}
        assert 'DMEVersion("2.5")' in said['version']
        assert '"Probe1"' in said['tools']
        assert said['homed'] == 'yes'
        assert said['Tool.GoToPar.Speed'] == '60, least 1, most 500'
        assert 'Temperature(20' in said['temperatures / °C']
        assert main(['dme', 'check', '--settings', settings(port), '--trace']) == 0
        out, err = capfd.readouterr()
        assert 'those at 4 places are safe' in out
        assert '> 00001 StartSession()\n< 00001 &\n< 00001 %\n' in err
        assert server.commands.cmm.moved == 0


@pytest.mark.parametrize(('text', 'address'), [
    ('localhost', ('localhost', 1294)), ('127.0.0.1:1', ('127.0.0.1', 1)), ('[::1]', ('::1', 1294)),
    ('[::1]:65535', ('::1', 65535)), ('[fe80::1%lo]:7', ('fe80::1%lo', 7))])
def test_an_address_of_a_server(monkeypatch, text, address):
    """A name or an address with or without a port, IPv6 in brackets."""
    async def looked(host, port, settings, trace):
        raise CellError(f'asked {(host, port)}')

    monkeypatch.setattr(dme, '_looked', looked)
    with pytest.raises(CellError, match=re.escape(f'asked {address}')):
        dme.check(argparse.Namespace(server=text, settings=None, trace=False, json=False))


def test_a_machine_that_is_not_ready(settings, capfd):
    """Exit code 2, with the checks that are not passed."""
    with serving(CONFIG) as (port, server):
        server.commands.cmm.is_homed = False
        path = settings(port, path={'stand_off_mm': 40.0, 'clearance_mm': 80.0})
        assert main(['dme', 'check', '--settings', path]) == 2
    out, err = capfd.readouterr()
    assert 'no: home it at the machine' in out
    assert 'expected a homed machine, found IsHomed(0)' in ' '.join(out.split())
    assert err == 'rosette: dme check: not passed: homed, settings, paths (docs/real-cmm.md)\n'


def test_a_tool_that_will_be_changed_for(settings, capfd):
    """That is no reason not to pass: it is said when it is done."""
    with serving(CONFIG) as (port, server):
        server.commands.tool = 'RefTool'
        assert main(['dme', 'check', '--settings', settings(port, tool={'change': True})]) == 0
        assert 'before the first ball' in ' '.join(capfd.readouterr().out.split())
        assert server.commands.cmm.moved == 0


def test_a_dry_run_touches_nothing(settings, capfd):
    """All balls are gone around, above them; no mark is left."""
    with serving(CONFIG) as (port, _):
        assert main(['dme', 'dry-run', settings(port), '--trace']) == 0
        assert not StopMark(settings(port)).path.exists()
        out, err = capfd.readouterr()
        assert 'The ways at 4 places are safe' in out
        assert [line.partition(':')[0] for line in out.splitlines()[1:]] == [f'ball {k}' for k in range(1, 5)]
        assert 'PtMeas(' not in err
        assert 'GoTo(' in err


def test_an_ended_dry_run_aborts_the_move(settings, capfd):
    """SIGTERM: AbortE is sent and its answer read, without a word of an emergency stop."""
    lines = []

    def told(line):
        lines.append(line)
        if 'GoTo(' in line:
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    try:
        with serving(CONFIG, ServeSettings(speed=1.0), say=told) as (port, _), pytest.raises(SystemExit) as end:
            main(['dme', 'dry-run', settings(port)])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert end.value.code == 128 + signal.SIGTERM
    assert [line.split()[2] for line in lines if line.startswith('<')][-2:] == ['AbortE()', 'EndSession()']
    assert not capfd.readouterr().err
    assert not StopMark(settings()).path.exists()


@pytest.mark.parametrize(('fault', 'words', 'more'), [
    ('collision:at=8', 'error 2504 (severity 3): Collision; a person has to look', ()),
    ('emergency_stop:at=8', 'error 0500 (severity 3): Emergency stop; a person has to look', ()),
    ('abort_ignored', 'AbortE was not answered within 0.5 s: the machine may still move', ('GoTo(',)),
])
def test_a_dry_run_that_is_stopped(settings, capfd, fault, words, more):
    """A person is wanted, over the end of the program: neither dry run nor cell moves before the mark is removed."""
    def told(line):
        if line.startswith('<') and any(word in line for word in more):
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    try:
        with serving(CONFIG, ServeSettings(speed=1000.0)) as (behind, server), \
                spoiling(behind, fault, say=told) as (port, _):
            path = settings(port, timeouts={'abort_s': 0.5})
            assert main(['dme', 'dry-run', path]) == 2
            said = capfd.readouterr().err
            assert words in said
            assert f'check-cmm --recover beside the cell, or remove {path}.stopped' in said
            assert words in StopMark(path).read()
            moved = server.commands.cmm.moved
            assert main(['dme', 'dry-run', path]) == 2
            assert words in capfd.readouterr().err
            assert server.commands.cmm.moved == moved
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_dry_run_that_does_not_begin(settings, capfd):
    """Nobody listens: said in one line; nothing has moved, so no person is wanted."""
    assert main(['dme', 'dry-run', settings(1)]) == 2
    assert 'is the I++ server started' in capfd.readouterr().err
    assert not StopMark(settings()).path.exists()


def test_the_path_as_table_and_picture(settings, tmp_path, capfd):
    """20 touches, each as far from the ball centre as ball and tip are large."""
    picture = tmp_path / 'path.png'
    assert main(['dme', 'path', settings(), '--csv', '--figure', str(picture)]) == 0
    rows = list(csv.DictReader(io.StringIO(capfd.readouterr().out)))
    touched = [row for row in rows if row['why'].startswith('touch ')]
    assert len(touched) == 20
    for row in touched:
        off = [float(row[f'{axis}_mm']) - at for axis, at in zip('xyz', (532.5, 260.0, -300.0))]
        assert math.hypot(*off) == pytest.approx(10.0, abs=1e-9)
    assert picture.read_bytes().startswith(b'\x89PNG')


def test_a_path_is_summed_up(settings, capfd):
    """Two lines unless the steps are asked for."""
    assert main(['dme', 'path', settings()]) == 0
    first, last = capfd.readouterr().out.splitlines()
    assert first.startswith('Ball 1 at table position 1: 20 touches, 78 steps (--steps lists them), 1275 mm; tip ')
    assert first.endswith('in machine coordinates: x 512.6 to 552.4, y 240.1 to 279.9, z −302.7 to −240.0 mm.')
    assert last == 'The ways at all 4 places are safe.'
    assert main(['dme', 'path', settings(), '--steps']) == 0
    out = capfd.readouterr().out
    assert out.startswith('Ball 1') and 'stand-off of touch 1 ' in out and len(out.splitlines()) > 78


@pytest.mark.parametrize('count', [4, 12])
def test_the_picture_of_a_path_is_true(count):
    """Both neighbours are wholly in both views, at their places and to one scale; balls behind the ball in none."""
    angle = 2 * np.pi * np.arange(count) / count
    balls = 182.5 * np.stack([np.cos(angle) - 1, np.sin(angle), 0 * angle], axis=1)
    way = np.array([[0, 0, 60.0], [20, 0, 0], [-20, 0, 0], [0, 0, 60]])
    made = probe_path(way, np.array([False, True, True, False]), 7.5, (2.5, 30.0), balls[1:])
    for view, up in zip(made.axes, (0, 2), strict=True):
        circles = [one for one in view.patches if isinstance(one, Circle)]
        assert np.allclose([one.center for one in circles], [[balls[k, 1], balls[k, up]] for k in (0, -1, 1)])
        for one in circles:
            low, high = view.transData.inverted().transform(view.bbox.get_points())
            assert (np.minimum(low, high) < np.array(one.center) - 7.5).all()
            assert (np.maximum(low, high) > np.array(one.center) + 7.5).all()
        wide, tall = np.abs(np.diff(view.transData.transform([[0, 0], [1, 1]]), axis=0)[0])
        assert wide == pytest.approx(tall, rel=1e-6)
        assert [one.get_text() for one in view.texts] == [f'{np.linalg.norm(balls[1]):.0f} mm away'] * 2
    assert [one.get_text() for one in made.legends[0].get_texts()] == [
        'ball', 'neighbours', 'way of the tip centre', 'touches']


@pytest.mark.parametrize(('changes', 'arguments', 'words'), [
    ({'path': {'stand_off_mm': 40.0, 'clearance_mm': 80.0}}, [], 'expected at least 20 mm between tip and'),
    ({}, ['--ball', '9'], 'dme path: --ball: expected 1 .. 4, found 9'),
    ({'table': {'azimuths_deg': [0.0, 90.0, 180.0]}}, ['--ball', '4'], 'dme path: --ball: expected 1 .. 3, found 4'),
    ({}, ['--position', '5'], 'dme path: --position: expected 1 .. 4, found 5'),
])
def test_paths_that_are_refused(settings, capfd, changes, arguments, words):
    """In one line."""
    assert main(['dme', 'path', settings(**changes), *arguments]) == 2
    assert words in capfd.readouterr().err


@pytest.mark.parametrize(('arguments', 'words'), [
    ([], 'expected HOST[:PORT] or --settings FILE, one of the two'),
    (['a:b:c'], "expected HOST or HOST:PORT, found 'a:b:c'"),
    (['::1'], "expected HOST or HOST:PORT, found '::1'; an IPv6 address stands in brackets, as [::1]:1294"),
    (['[::1'], "expected HOST or HOST:PORT, found '[::1'"),
    (['[::1]1294'], "expected HOST or HOST:PORT, found '[::1]1294'"),
    (['localhost:65536'], "expected HOST or HOST:PORT, found 'localhost:65536'"),
    (['localhost:'], "expected HOST or HOST:PORT, found 'localhost:'"),
    (['[::1]:1'], 'rosette: [::1]:1: expected a connection, found '),
    (['127.0.0.1:1'], 'is the I++ server started, and is host:port right?'),
    (['--settings', '/nowhere.yaml'], '/nowhere.yaml: expected a settings file of an I++ CMM that can be read'),
])
def test_checks_that_are_refused(capfd, arguments, words):
    """In one line."""
    assert main(['dme', 'check', *arguments]) == 2
    assert words in capfd.readouterr().err


@pytest.mark.parametrize(('arguments', 'words'), [
    (['--cmm', 'dme'], 'cell: expected --cmm dme and --settings FILE together'),
    (['--settings', 'x.yaml'], 'cell: expected --cmm dme and --settings FILE together'),
    (['--cmm', 'dme', '--settings', 'dme.yaml', '--machine', 'dme.yaml'], 'cell: --machine describes a simulated CMM'),
    (['--cmm', 'dme', '--settings', 'dme.yaml', '--no-simulation'], 'cell: --cmm dme starts a CMM'),
])
def test_cells_that_are_refused(settings, tmp_path, monkeypatch, capfd, arguments, words):
    """Before a node is started."""
    settings()
    monkeypatch.chdir(tmp_path)
    assert main(['cell', *arguments]) == 2
    assert words in capfd.readouterr().err
