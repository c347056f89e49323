# SPDX-License-Identifier: Apache-2.0
"""Touches through a log and back: by the libraries of the format, by the package, and what is wrong with some."""

from copy import deepcopy

import numpy as np
import pytest
from ideal_cell import ideal_cell
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from touched_log import write_touched_log

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import plan
from rosette_ros.io import log_reader
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.log_reader import decoded, read_log
from rosette_ros.io.touch_log import TOUCHES, open_refitted, read_touches, refit_if_touched
from rosette_ros.simulation import Machine, MachineConfig

CELL = MachineConfig().changed(plate={'balls': 4})
ONE_PICOMETRE = 1e-12


@pytest.fixture(scope='module')
def touched(tmp_path_factory):
    """Return (path of a log, its readings)."""
    folder = tmp_path_factory.mktemp('touched') / 'log'
    return folder, write_touched_log(folder, CELL)


def changed_log(tmp_path, change):
    """Return the path of a log whose touches are changed."""
    write_touched_log(tmp_path / 'log', CELL, change=change)
    return tmp_path / 'log'


def test_other_readers_find_every_touch_bit_by_bit(touched):
    """Positions, directions and times of the simulated machine, by the reader and decoder of the format."""
    folder, readings = touched
    with open(next(folder.glob('*.mcap')), 'rb') as stream:
        found = [(channel.topic, message) for _, channel, _, message in make_reader(
            stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()]
    touches = [message for topic, message in found if topic == '/rosette/touches']
    answers = [message for topic, message in found if topic == '/rosette/ball_centre']
    assert len(touches) == len(answers) == readings.size == 16
    for row, (one, answer) in enumerate(zip(touches, answers, strict=True)):
        for name in ('run_id', 'seq', 'table_position', 'ball', 'cmm_position', 'table_angle'):
            assert getattr(one, name) == getattr(answer, name)
        assert (one.header.stamp.nanosec, one.header.frame_id) == (answer.header.stamp.nanosec, 'machine')
        assert (np.array([one.x, one.y, one.z]).T == readings.touch_point[row]).all()
        assert (np.array([one.i, one.j, one.k]).T == readings.touch_normal[row]).all()
        assert (np.array(one.time) == readings.touch_time[row] - readings.time[row]).all()
        assert (one.tip_radius, one.is_compensated) == (2.5e-3, False)
    order = [topic.rpartition('/')[2] for topic, _ in found]
    assert order.index('touches') < order.index('ball_centre'), 'an answer in the log has its touches before it'


def test_fit_of_the_touches_is_what_was_sent(touched):
    """The centres, and with them every number of the run."""
    folder, readings = touched
    run, refit = open_refitted(folder)
    sent = read_log(folder).to_run()
    assert refit.moved.max() < ONE_PICOMETRE
    assert np.abs(run.centre - sent.centre).max() < ONE_PICOMETRE
    assert np.abs(refit.form - readings.form_error).max() < ONE_PICOMETRE
    assert np.abs(refit.radius - 7.5e-3).max() < 1e-6
    assert run.notes[-1] == '16 ball centres recalculated from 320 touches'
    assert run.remarks == sent.remarks


def test_touches_are_not_read_where_nobody_asks(touched, tmp_path, monkeypatch):
    """None is decoded, and a log reads as one without them, bit by bit."""
    def watched(message):
        assert message.type_name != TOUCHES
        return decoded(message)

    monkeypatch.setattr(log_reader, 'decoded', watched)
    with_touches, without = read_log(touched[0]), read_log(changed_log(tmp_path, lambda answer, touches: None))
    assert with_touches.answers == without.answers
    assert with_touches.to_run().centre.tobytes() == without.to_run().centre.tobytes()
    assert with_touches.messages == without.messages + 16


def test_compensated_touches_give_the_same_centre(tmp_path):
    """Points on the ball: the fitted radius is the ball's without taking off the tip."""
    def compensate(answer, touches):
        for axis, normal in zip('xyz', 'ijk', strict=True):
            point = np.array(getattr(touches, axis)) - touches.tip_radius * np.array(getattr(touches, normal))
            setattr(touches, axis, point.tolist())
        touches.is_compensated = True
        return touches

    _, refit = open_refitted(changed_log(tmp_path, compensate))
    # The tip is taken off along the line of approach, 0.3 mm beside the normal: micrometres of the radius.
    assert np.abs(refit.radius - 7.5e-3).max() < 2e-5


def test_balls_without_touches_keep_their_centre(tmp_path):
    """Too few touches, none, of another answer, in another frame, not finite or in a plane: counted, and said."""
    def spoil(answer, touches):
        touches.header = deepcopy(touches.header)
        match answer.seq:
            case 1:
                return None
            case 2:
                touches.header.stamp.sec += 1
            case 3:
                touches.ball = answer.ball % 4 + 1
            case 4:
                touches.header.frame_id = 'table'
            case 5:
                touches.x[7] = float('nan')
            case 6:
                for name in ('x', 'y', 'z', 'i', 'j', 'k', 'time'):
                    setattr(touches, name, getattr(touches, name)[:3])
            case 7:
                touches.z = [0.5] * 20
            case 8:
                for name in ('x', 'y', 'z', 'i', 'j', 'k', 'time'):
                    setattr(touches, name, getattr(touches, name)[:12])
        return touches

    folder = changed_log(tmp_path, spoil)
    run, refit = open_refitted(folder)
    assert run.notes[-1] == (
        '9 ball centres recalculated from 172 touches, as sent: 3 with no touches; 1 with touches in another frame; '
        '1 with touches that are no numbers; 1 with fewer than 4 touches; 1 with touches in a plane')
    assert refit.touched.seq.tolist() == list(range(8, 17))
    sent = read_log(folder).to_run()
    assert (run.centre[:7] == sent.centre[:7]).all()
    assert refit.moved[0] > 1e-8, 'the upper touches give another centre'
    assert refit.moved[1:].max() < ONE_PICOMETRE


def test_outlier_of_the_answer_is_seen_in_the_touches(tmp_path):
    """A centre that was sent and does not belong to its touches: 50 µm are found, and are not in the new run."""
    def displace(answer, touches):
        answer.centre.x += 5e-5 * (answer.seq == 3)
        return touches

    folder = changed_log(tmp_path, displace)
    run, refit = open_refitted(folder)
    assert refit.moved[2] == pytest.approx(5e-5, abs=1e-12)
    assert np.abs(run.centre - read_log(folder).to_run().centre).max() == pytest.approx(5e-5, rel=0.5)


def test_no_touches_is_said_in_one_line(tmp_path):
    """Of a log, of a table, of arrays that do not belong together."""
    folder = changed_log(tmp_path, lambda answer, touches: None)
    with pytest.raises(InvalidData, match=r'log: expected touches to fit the spheres again, found none of run '
                                          r'touched; its '
                       r'CMM publishes none \(topic touches\)$'):
        open_refitted(folder)
    assert refit_if_touched(folder) is None
    table = tmp_path / 'run.csv'
    write_csv(Machine(ideal_cell(plate={'balls': 4})).run(plan(4, 'row')), table)
    with pytest.raises(InvalidData, match=r'run.csv: expected touches to fit the spheres again, found none: a table '
                                          r'holds '
                       'ball centres only; give the log of the run$'):
        open_refitted(table)
    assert refit_if_touched(table) is None


def test_arrays_of_two_lengths_are_refused(tmp_path):
    """With file, topic and message."""
    def shorten(answer, touches):
        touches.k = touches.k[:-1]
        return touches

    with pytest.raises(InvalidData, match=r'log_0.mcap: topic /rosette/touches: message 1: expected x, y, z, i, j, k, '
                       'time of one length, found 20, 20, 20, 20, 20, 19, 20$'):
        read_touches(read_log(changed_log(tmp_path, shorten)))


def test_touches_that_determine_nothing_are_refused(tmp_path):
    """All in a plane."""
    def flatten(answer, touches):
        touches.z = [0.5] * 20
        return touches

    with pytest.raises(InvalidData, match='log: expected touches that determine spheres, found 16 with touches in a '
                                          'plane'):
        open_refitted(changed_log(tmp_path, flatten))
