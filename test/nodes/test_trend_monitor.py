# SPDX-License-Identifier: Apache-2.0
"""A cell that calibrates itself: on time or on request, into its archive, never while it is held; the trend."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from rosette_msgs.msg import Trend

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.cell.supervisor import MODULES, OPTIONAL
from rosette_ros.core.errors import CellError
from rosette_ros.nodes import names

IDENTITY = 'schema: rosette-identity/1\ntable: {serial: RT-7}\ntolerances: {crz: 20 µrad, ctz: 0.001 µm}\n'


@pytest.fixture
def watched(cell_of, tmp_path):
    """Return a function that makes a cell of three balls which keeps an archive; every: s."""
    def make(every=0.0):
        (tmp_path / 'identity.yaml').write_text(IDENTITY, encoding='utf-8')
        monitor = {'archive': str(tmp_path / 'archive'), 'every_s': every, 'table': 'RT-7'}
        return cell_of(balls=3, sequencer={'identity': str(tmp_path / 'identity.yaml')}, nodes=(*MODULES, *OPTIONAL),
                       params={'trend_monitor': monitor})
    return make


def rows(folder):
    """Return the rows of the archive."""
    return RunArchive(folder / 'archive').read_rows(('run_id', 'table_serial', 'cell', 'problem')).to_pylist()


def health(peer):
    """Return the last status of the trend monitor, None before the first."""
    found = [one for data in peer.heard['/diagnostics'] for one in deserialize_message(data, DiagnosticArray).status
             if one.name.endswith('trend_monitor')]
    return found[-1] if found else None


def test_a_cell_calibrates_itself_and_tells_the_trend(watched, peer, client, trigger, tmp_path, wait_until):
    """The first one is due at once, the next after the interval; a tolerance that is not kept is an error."""
    with watched(every=3600.0) as cell:
        peer.listen('trend', 'rosette_msgs/msg/Trend')
        peer.listen('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        peer.start()
        wait_until(lambda: rows(tmp_path) and health(peer).values[4].value)
        [row] = rows(tmp_path)
        assert (row['table_serial'], row['cell'], row['problem']) == ('RT-7', 'rosette', '')
        assert trigger(client, names.CALIBRATE_NOW)[0]
        wait_until(lambda: len(rows(tmp_path)) == 2 and '2 runs' in health(peer).values[4].value
                   and peer.heard['trend'])
        trend = deserialize_message(peer.heard['trend'][-1], Trend)
        assert (trend.table, trend.level, trend.changes) == ('RT-7', 'bad', [])
        assert {one.error: one.tolerance for one in trend.forecasts} == pytest.approx({'crz': 2e-5, 'ctz': 1e-9})
        assert [words.split(' ')[0] for words in trend.warnings] == ['ctz']
        assert 'its tolerance of 0.001 µm' in trend.warnings[0]
        status = health(peer)
        assert status.level == status.ERROR
        assert trend.warnings[0].partition(' ')[0] in status.message
        assert 'next calibration on' in status.message
        cell.check()


def test_nobody_is_disturbed(watched, peer, client, trigger, tmp_path, wait_until):
    """While the cell is held nothing begins, and it says who holds it; a restart forgets neither hold nor schedule."""
    with watched() as cell:
        assert client.hold('Ada', 'cleans the balls')[0]
        assert client.hold('', '')[2] == 'Ada'
        done, words, _ = client.hold('night job', 'other plate')
        assert not done and words.startswith('Ada holds the cell since') and words.endswith('Ada has to release it')
        done, words = trigger(client, names.CALIBRATE_NOW)
        assert not done and 'Ada holds the cell since' in words and words.endswith('cleans the balls')
    with watched(every=1.0) as cell:
        peer.listen('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        peer.start()
        wait_until(lambda: health(peer) and 'due, and does not begin: Ada holds the cell' in health(peer).message)
        assert health(peer).level == health(peer).WARN
        assert client.hold('night job', '', release=True)[0] is False
        assert rows(tmp_path) == []
        assert client.hold('Ada', '', release=True) == (True, 'nobody holds the cell', '')
        wait_until(lambda: len(rows(tmp_path)) >= 1)
        cell.check()


def test_what_the_sequencer_refuses_is_told(cell_of, peer, client, tmp_path, wait_until):
    """In its words, as it refuses while another calibration is running; the archive stays empty."""
    with cell_of(balls=3, nodes=('recorder', 'cmm', 'sequencer', 'trend_monitor'),
                 params={'trend_monitor': {'archive': str(tmp_path / 'archive'), 'every_s': 1.0}}) as cell:
        peer.listen('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        peer.start()
        wait_until(lambda: health(peer) and 'no evaluator: wanted one that publishes' in health(peer).message)
        assert rows(tmp_path) == []
        cell.check()


def test_a_cell_without_an_archive_cannot_be_held(client):
    """It says what is wanted."""
    with pytest.raises(CellError, match='wanted a cell that calibrates itself'):
        client.hold('', '')
