# SPDX-License-Identifier: Apache-2.0
"""RUN on the command line: told by its content, not by its name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.ball_centre_table import format_csv
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.open_run import open_run


def test_directory_file_and_table_give_the_same_run(make_cell, tmp_path):
    """Whatever the files are called."""
    log = make_cell().write(tmp_path / 'log')
    run = open_run(log)
    (tmp_path / 'renamed.csv').write_bytes((log / 'log_0.mcap').read_bytes())
    assert open_run(tmp_path / 'renamed.csv').centre.tobytes() == run.centre.tobytes()
    (tmp_path / 'table.txt').write_text(format_csv(run))
    assert abs(open_run(tmp_path / 'table.txt').centre - run.centre).max() <= 1e-15


def test_run_is_chosen_by_its_id(make_cell, tmp_path):
    """In a log of several, and never another one than asked for."""
    cell = make_cell(run_id='a')
    cell.sent += make_cell(run_id='b', begin_s=9e4).sent
    log = cell.write(tmp_path / 'log')
    assert open_run(log, 'b').run_id == 'b'
    (tmp_path / 'table.csv').write_text(format_csv(open_run(log, 'a')))
    assert open_run(tmp_path / 'table.csv', 'a').run_id == 'a'
    with pytest.raises(InvalidData, match="table.csv: expected run 'b', found 'a'"):
        open_run(tmp_path / 'table.csv', 'b')


@pytest.mark.parametrize(('name', 'data', 'words'), [
    ('some.db3', b'SQLite format 3\0...', 'some.db3: is an sqlite3 log; expected MCAP: convert it'),
    ('metadata.yaml', b'rosbag2_bagfile_information:\n', 'metadata.yaml: describes a log; name the folder that it is '
                                                          'in'),
    ('some.mcap.zst', b'\x28\xb5\x2f\xfd\0', 'is a compressed file; unpack it: zstd -d .*some.mcap.zst -o .*some.mcap'),
    ('log.mcap.gz', b'\x1f\x8b\x08\0', r'log.mcap.gz: is a packed file; unpack it: gzip -dk \S+/log.mcap.gz$'),
    ('log.mcap.xz', b'\xfd7zXZ\0\0', r'log.mcap.xz: is a packed file; unpack it: xz -dk \S+/log.mcap.xz$'),
    ('run.csv.bz2', b'BZh91AY', r'run.csv.bz2: is a packed file; unpack it: bzip2 -dk \S+/run.csv.bz2$'),
    ('a b.tar', b'log.mcap' + bytes(249) + b'ustar', r"a b.tar: is a packed file; unpack it: tar -xf '\S+/a b.tar'$"),
    ('ros1.bag', b'#ROSBAG V2.0\n', 'ros1.bag: is a bag of ROS 1; expected MCAP: convert it with `rosbags-convert '
                                    '--src'),
    ('some.csv', b'', 'some.csv: is empty; expected a log directory, an .mcap file or a CSV table'),
    ('some.mcap', b'a,b,c', 'some.mcap: is not an MCAP file'),
    ('some.json', b'{"a": 1}', 'some.json: expected "# schema: rosette-ball-centres/1"'),
    ('some.xlsx', b'PK\x03\x04\0', 'some.xlsx: is a workbook or an archive; expected a table: save it as CSV, UTF-8'),
    ('some.csv', 'seq;ball\n1;1\n'.encode('utf-16'), 'some.csv: is a binary file, or text in UTF-16'),
    ('some.png', b'\x89PNG\r\n\x1a\n\0', 'some.png: is a binary file, or text in UTF-16; expected a table'),
])
def test_other_files_are_refused_with_words(tmp_path, name, data, words):
    """Each is named for what it is."""
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InvalidData, match=words):
        open_run(tmp_path / name)


def test_what_is_not_there_is_refused_with_words(tmp_path):
    """A wrong path, and a folder without a log."""
    with pytest.raises(InvalidData, match='nowhere: expected a log directory, an .mcap file or a CSV '
                       'table that can be read, found No such file'):
        open_run(tmp_path / 'nowhere')
    with pytest.raises(InvalidData, match='expected a log directory with .mcap files, found none'):
        open_run(tmp_path)


def test_logs_are_read_without_ros(make_cell, tmp_path):
    """Where rclpy and every message package are missing."""
    log = make_cell().write(tmp_path / 'log')
    script = (
        'import sys\n'
        'for name in ("rclpy", "rosette_msgs", "rosidl_runtime_py", "std_msgs", "rosbags"):\n'
        '    sys.modules[name] = None\n'
        'from rosette_ros.io.open_run import open_run\n'
        'print(repr(open_run(sys.argv[1]).centre[3, 1].item()))\n')
    done = subprocess.run([sys.executable, '-c', script, str(log)], capture_output=True,
                          text=True, check=True)
    assert float(done.stdout) == read_log(log).to_run().centre[3, 1]


@pytest.mark.parametrize('kind', ['device', 'pipe'])
def test_what_never_ends_is_not_read(tmp_path, kind):
    """A device or a pipe is refused before it is opened."""
    path = Path('/dev/zero')
    if kind == 'pipe':
        path = tmp_path / 'pipe'
        os.mkfifo(path)
    with pytest.raises(InvalidData, match='found a device or a pipe; write it to a file first'):
        open_run(path)


@pytest.mark.parametrize(('name', 'begin', 'words'), [
    ('a.bag', b'#ROSBAG V2.0\n', 'is a bag of ROS 1; expected MCAP: convert it with `rosbags-convert --src BAG'),
    ('a.mcap.gz', b'\x1f\x8b\x08', 'is a packed file; unpack it: gzip -dk '),
    ('a.mcap.xz', b'\xfd7zXZ\x00', 'is a packed file; unpack it: xz -dk '),
    ('a.mcap.bz2', b'BZh9', 'is a packed file; unpack it: bzip2 -dk '),
    ('a.tar', b'\0' * 257 + b'ustar', 'is a packed file; unpack it: tar -xf '),
    ('a.db3', b'SQLite format 3\0', 'is an sqlite3 log; expected MCAP: convert it with `ros2 bag convert`')])
def test_what_is_alone_in_a_folder_is_named_with_the_way_to_convert_it(tmp_path, name, begin, words):
    """As a file is; a ROS 1 bag, packed files, sqlite3."""
    (tmp_path / name).write_bytes(begin + bytes(600))
    (tmp_path / 'readme.txt').write_text('the run of Monday')
    for path in (tmp_path, tmp_path / name):
        with pytest.raises(InvalidData, match=re.escape(f'{tmp_path / name}: {words}')):
            open_run(path)
