# SPDX-License-Identifier: Apache-2.0
"""How the table stands in the machine travels with a run: table, log, joint evaluation."""

import re

import numpy as np
import pytest
from test_run_to_log import make_run

from rosette_ros.core.run.axes import axis_rotation, taught_frame
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.ball_centre_table import format_csv, parse_csv
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.open_run import open_readings
from rosette_ros.io.run_to_log import write_log

OBLIQUE = taught_frame([0, 0, 0], [0.2, 0.9, -0.3], 0.7).rotation


@pytest.mark.parametrize('rotation', [None, axis_rotation([1, 0, 0]), OBLIQUE, np.eye(3)])
def test_a_table_tells_it(rotation):
    """Axis and x stand in the heading, to the last digit; nothing stands there where it is not known."""
    run = make_run(5, rotation=rotation)
    text = format_csv(run)
    back = parse_csv(text.encode())
    if rotation is None:
        assert back.rotation is None and 'table_axis' not in text
        return
    assert re.search('^# table_axis: .*\n# table_x: ', text, re.MULTILINE)
    assert back.rotation == pytest.approx(rotation, abs=1e-15)
    assert np.array_equal(back.cmm_sense, run.cmm_sense)
    assert format_csv(parse_csv(format_csv(back).encode())).count('\n') == text.count('\n')


def test_senses_of_a_part_are_those_of_the_axes_that_move():
    """About y of the machine x and z go to and fro."""
    run = make_run(6, rotation=axis_rotation([0, 1, 0]))
    part = run.take(np.arange(run.size) % 5 != 2)
    text = format_csv(part)
    assert 'cmm_sense_x,cmm_sense_z' in text
    back = parse_csv(text.encode())
    assert np.array_equal(back.cmm_sense, part.cmm_sense)
    assert back.unrecorded == ()


@pytest.mark.parametrize('rotation', [None, OBLIQUE])
def test_a_log_tells_it(rotation, library, tmp_path):
    """On /tf_static; it is no place of the table, which nobody knows."""
    path = write_log(make_run(4, rotation=rotation), tmp_path / 'log', library)
    log = read_log(path)
    run = log.to_run()
    if rotation is None:
        assert run.rotation is None
    else:
        assert run.rotation == pytest.approx(rotation, abs=1e-15)
    assert log.frame_of(run.run_id) is None
    readings = open_readings(path)
    assert readings.frame is None
    assert (readings.rotation is None) == (rotation is None)


def table(*lines):
    """Return a table as bytes with more lines in its heading."""
    return format_csv(make_run(4)).replace('\n', ''.join(f'\n# {line}' for line in lines) + '\n', 1).encode()


@pytest.mark.parametrize(('lines', 'words'), [
    (['table_axis: 0, 0, 0'], r'line 2: expected table_axis: 3 numbers that are not all 0, the direction of the table '
                              r"axis in the machine, found '0, 0, 0'"),
    (['table_axis: 1, 0'], "found '1, 0'"), (['table_axis: nan, 0, 1'], "found 'nan, 0, 1'"),
    (['table_axis: x'], "found 'x'"),
    (['table_axis: inf, 0, 1'], 'inf'), (['table_x: 1, 0, 0'], 'expected table_axis beside table_x, found table_x '
                                                               'alone'),
    (['table_axis: 0, 0, 1', 'table_x: 0, 1, 1'], 'line 3: table_x: expected x perpendicular to the axis, found 45.00 '
                                                  'deg'),
    (['table_axs: 0, 0, 1'], 'expected the key table_axis')])
def test_a_bad_axis_is_refused_in_one_line(lines, words):
    """With its line."""
    with pytest.raises(InvalidData, match=words) as caught:
        parse_csv(table(*lines), 'some.csv')
    assert str(caught.value).startswith('some.csv: ') and '\n' not in str(caught.value)


def test_an_axis_alone_counts_ball_1_from_azimuth_0():
    """Spaces or semicolons, of any length."""
    for text in ('5 0 0', '0.5; 0; 0', '1,0,0'):
        assert np.array_equal(parse_csv(table(f'table_axis: {text}')).rotation, axis_rotation([1, 0, 0]))


def in_machine(frame, heading=''):
    """Return a table of machine coordinates of a table at a Frame."""
    run = make_run(5)
    text = format_csv(run.replace(centre=frame.to_outer(run.centre)))
    return text.replace('\n', f'\n# frame: machine\n{heading}', 1).encode()


def test_machine_coordinates_tell_it_themselves():
    """The frame that is fitted to all readings is the run's; a heading that contradicts it is refused."""
    frame = taught_frame([0.3, 0.2, 0.1], [1, 0.1, 0], 0.3)
    assert parse_csv(in_machine(frame)).rotation == pytest.approx(frame.rotation, abs=1e-5)
    assert parse_csv(in_machine(frame, '# table_axis: 1, 0, 0\n')).rotation == pytest.approx(frame.rotation, abs=1e-5)
    with pytest.raises(InvalidData, match=r'table_axis: expected \(0.995, 0.0995, .*\), about which the ball centres '
                                          r'turn'
                                          r', found \(0, 0, 1\), 90 deg off; correct it, or leave it out'):
        parse_csv(in_machine(frame, '# table_axis: 0, 0, 1\n'))
