# SPDX-License-Identifier: Apache-2.0
"""The disk does not hold what the recorder has written, or takes nothing more."""

import errno
import shutil

import pytest
from recordings import measure, receive, start, stop
from rosette_msgs.msg import (
    CalibrationEvent,
    RunState,
    Touches,
)
from rosette_msgs.srv import Diagnose, Recorded
from service_msgs.msg import ServiceEventInfo

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.nodes.interfaces import decoded
from rosette_ros.nodes.log_session import iter_copied

QUESTION = Diagnose.Event(info=ServiceEventInfo(event_type=ServiceEventInfo.REQUEST_RECEIVED))
DONE = RunState(run_id='run', phase=RunState.PHASE_DONE)


def overwrite(path):
    """Change a byte in the middle of what was written."""
    with open(path, 'r+b') as stream:
        stream.seek(path.stat().st_size // 2)
        stream.write(b'\xff\x00\xff')


def replace(path):
    """Put a copy in the place of the file."""
    shutil.copy(path, path.with_suffix('.copy'))
    path.with_suffix('.copy').rename(path)


DAMAGES = {
    'was deleted': lambda path: path.unlink(),
    'was deleted with its folder': lambda path: shutil.rmtree(path.parent),
    'was replaced by another file': replace,
    'has 0 bytes, ': lambda path: path.write_bytes(b''),
    'has 100 bytes, ': lambda path: path.write_bytes(path.read_bytes()[:100]),
    'holds other bytes than were written': overwrite,
}


@pytest.mark.parametrize('damage', DAMAGES)
@pytest.mark.parametrize('later', [(), (3,)], ids=['at once', 'after another ball'])
def test_a_log_that_is_gone_is_continued_in_a_new_one(recorder, tmp_path, damage, later):
    """What is reported as recorded is on the disk: the new log begins with every answer, and ends the run."""
    assert start(recorder, 'run').success
    measure(recorder, 1, 2)
    receive(recorder, 'calibration_event', CalibrationEvent(run_id='run', kind=1, settings='balls: 3'))
    recorder._session.flush()
    DAMAGES[damage](tmp_path / 'run' / 'run_0.mcap')
    measure(recorder, *later)
    response = recorder._on_recorded(Recorded.Request(run_id='run'), Recorded.Response())
    assert response.success
    assert sorted(recorder._contents.answers._answered) == [1, 2, *later]
    assert recorder._session.directory.name == 'run_part2'
    assert not recorder._session.failure
    on_disk = read_log(tmp_path / 'run_part2')
    assert [answer.seq for answer in on_disk.answers] == [1, 2, *later]
    assert [event.settings for event in on_disk.events] == ['balls: 3']
    measure(recorder, 4)
    receive(recorder, 'run_state', DONE)
    receive(recorder, 'calibration_event', CalibrationEvent(run_id='run', kind=CalibrationEvent.SUCCEEDED))
    response = stop(recorder, 'run', RunState.PHASE_DONE)
    assert (response.success, response.log) == (True, str(tmp_path / 'run_part2'))
    whole = read_log(tmp_path / 'run_part2')
    assert [answer.seq for answer in whole.answers] == [1, 2, *later, 4]
    assert (whole.problems, whole.custom_data['rosette.resumes']) == ((), 'run')
    copied = [decoded(one.data, Touches) for name, one in iter_copied(tmp_path / 'run_part2') if name == 'touches']
    assert copied[-1].seq == 4, 'those before are in the damaged log'


def test_a_deleted_log_is_noticed_by_the_clock_alone(recorder, tmp_path, capfd):
    """No message has to arrive; it is told which file, and where the run continues."""
    assert start(recorder, 'run').success
    measure(recorder, 1)
    (tmp_path / 'run' / 'run_0.mcap').unlink()
    recorder.wake()
    assert (f'the log {tmp_path}/run is damaged: run_0.mcap was deleted; it continues in {tmp_path}/run_part2'
            in capfd.readouterr().err)
    recorder._session.flush()
    assert [answer.seq for answer in read_log(tmp_path / 'run_part2').answers] == [1]


def test_a_deleted_log_without_room_for_another_is_no_success(recorder, tmp_path, monkeypatch):
    """The status says why, the answers are not reported as recorded, and closing does not succeed."""
    assert start(recorder, 'run').success
    measure(recorder, 1)
    shutil.rmtree(tmp_path / 'run')
    monkeypatch.setattr(LogWriter, '_prepare_directory', lambda self: (_ for _ in ()).throw(InvalidData('no room')))
    recorder.wake()
    words = f'the log {tmp_path}/run is damaged: run_0.mcap was deleted; no room'
    assert recorder.status._problem == words
    assert not recorder._on_recorded(Recorded.Request(run_id='run'), Recorded.Response()).success
    response = stop(recorder, 'run', RunState.PHASE_DONE)
    assert (response.success, response.message) == (False, words)


def test_a_log_that_is_damaged_as_it_is_closed_is_no_success(recorder, tmp_path, monkeypatch):
    """After the last look at its bytes."""
    assert start(recorder, 'run').success
    measure(recorder, 1)
    close = LogWriter.close
    monkeypatch.setattr(LogWriter, 'close', lambda self: (close(self), overwrite(tmp_path / 'run' / 'run_0.mcap')))
    response = stop(recorder, 'run')
    assert not response.success
    assert response.message == f'{tmp_path}/run: run_0.mcap holds other bytes than were written'


@pytest.mark.parametrize('step', ['os.open', 'os.fsync', 'os.link', 'pathlib.Path.mkdir'])
def test_a_disk_without_inodes_refuses_a_log_and_nothing_is_left(recorder, tmp_path, monkeypatch, step):
    """Whatever fails: the node lives, says why, and the next log is opened under the same name."""
    def refuse(*_, **__):
        raise OSError(errno.ENOSPC, 'No space left on device')

    with monkeypatch.context() as patch:
        patch.setattr(step, refuse)
        response = start(recorder, 'run')
        receive(recorder, 'evaluator/diagnose/_service_event', QUESTION)
        recorder.wake()
    assert not response.success
    assert 'No space left on device' in response.message
    assert list(tmp_path.rglob('*')) == []
    assert start(recorder, 'run').success
