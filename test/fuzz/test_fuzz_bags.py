# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml beside a whole log, and files that are uploaded."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import split_bag
import yaml
from hypothesis import given
from hypothesis import strategies as st
from made_up import NASTY, SCALARS, TRICKS, bounded, corpus, dumped, mutated, trees, tried
from made_up_changes import changed_logs
from made_up_log import small_log, write_log
from test_fuzz_inputs import TABLE, cells_changed

from rosette_ros.core.run.errors import RosetteError
from rosette_ros.io.bag_metadata import TOP_KEY
from rosette_ros.io.log_reader import read_log
from rosette_ros.studio.calculations import read_upload
from rosette_ros.studio.panels.open_dialog import safe_name

pytestmark = pytest.mark.long

NAMES = [
    'version', 'storage_identifier', 'relative_file_paths', 'custom_data', 'message_count', 'files', TOP_KEY,
    'duration', 'starting_time', 'topics_with_message_count', 'compression_format', 'compression_mode',
]
VALUES = st.one_of(
    SCALARS,
    trees(st.sampled_from(NAMES)),
    st.lists(
        st.one_of(
            st.sampled_from(
                [
                    'log_0.mcap', 'log_1.mcap', '../log_0.mcap', '/etc/passwd', '.', '..', '', 'log_2.mcap',
                    'x' * 300, 'log_0.mcap/', 'LOG_0.MCAP', 'metadata.yaml', 'folder',
                ]
            ),
            NASTY,
        ),
        max_size=4,
    ),
)


LISTS = st.sampled_from(
    [
        ['log_0.mcap'], ['log_1.mcap'], ['log_1.mcap', 'log_0.mcap'], ['log_0.mcap'] * 2, 'log_0.mcap',
        {'log_0.mcap': 1}, ['folder'], [['log_0.mcap']], ['log_0.mcap', 'metadata.yaml'], [b'log_0.mcap'],
    ]
)


@pytest.fixture(scope='module')
def split(tmp_path_factory):
    """Return a log of two files."""
    home = tmp_path_factory.mktemp('split')
    folder = split_bag.split(write_log(home / 'whole'), home / 'log', 2)
    assert sorted(path.name for path in folder.iterdir()) == ['log_0.mcap', 'log_1.mcap', 'metadata.yaml']
    (folder / 'folder').mkdir()
    return folder


@st.composite
def changed_metadata(draw, original):
    """Return the text of a metadata.yaml: bytes changed, or values of the tree, or YAML that is none."""
    how = draw(st.sampled_from(['tree', 'tree', 'tree', 'bytes', 'trick', 'other']))
    if how == 'bytes':
        return draw(mutated(original))
    if how == 'other':
        return draw(st.one_of(VALUES.map(dumped), st.binary(max_size=50)))
    bag = yaml.safe_load(original)[TOP_KEY]
    if how == 'trick':
        text = yaml.safe_dump({TOP_KEY: {**bag, draw(st.sampled_from(NAMES)): 'HERE'}})
        return text.replace('HERE', draw(TRICKS)).encode('utf-8', 'surrogatepass')
    if draw(st.booleans()):
        bag['relative_file_paths'] = draw(LISTS)
    for name in draw(st.sets(st.sampled_from(NAMES), min_size=1, max_size=2)):
        bag[name] = draw(VALUES)
    if draw(st.booleans()):
        bag.pop(draw(st.sampled_from(NAMES)), None)
    return dumped({TOP_KEY: bag})


def check_metadata(data, folder):
    """Refuse a description in one line, or read the files that a plain YAML reader finds in it."""
    path = folder / 'metadata.yaml'
    before = path.read_bytes()
    try:
        path.write_bytes(data)
        with bounded():
            log = read_log(folder)
    except RosetteError as error:
        assert str(folder) in str(error)
        assert '\n' not in str(error)
        assert len(str(error)) < 2000
        return
    finally:
        path.write_bytes(before)
    bag = yaml.safe_load(data)[TOP_KEY]
    assert [one.name for one in log.files] == bag['relative_file_paths']
    assert len(log.files) == 2 or log.problems
    if bag.get('custom_data'):
        named = {str(key): str(value) for key, value in bag['custom_data'].items() if key != 'rosette.checksum'}
        assert log.custom_data == named or any('its checksum is wrong' in one for one in log.problems)
    assert log.messages > 0
    try:
        assert np.isfinite(log.to_run().centre).all()
    except RosetteError as error:
        assert str(folder) in str(error)


@tried(0.12)
@given(data=st.data())
def test_a_description(split, data):
    """metadata.yaml: text, trees, names of files."""
    check_metadata(data.draw(changed_metadata((split / 'metadata.yaml').read_bytes())), split)


@pytest.mark.parametrize('data', corpus('metadata'))
def test_a_description_of_the_corpus(data, split):
    """What once caused a failure."""
    check_metadata(data, split)


FILE_NAMES = st.one_of(
    st.text(max_size=300),
    NASTY,
    st.sampled_from(
        [
            '..', '.', '/', '../../x.mcap', 'C:\\x.mcap', 'a/b.mcap', '\U0001f600' * 120, 'ü' * 200 + '.csv',
            'x' * 300 + '.mcap', '.mcap', 'a\0b', '\ud800.csv', 'con', ' ', '-rf',
        ]
    ),
)


def check_upload(name, data, folder):
    """Refuse a file in one line that names it as the person knows it, or read it as a run."""
    plain = safe_name(name)
    assert plain == Path(plain).name
    assert plain not in ('', '.', '..')
    path = folder / plain
    path.write_bytes(data)
    assert os.listdir(folder) == [plain]
    try:
        with bounded():
            run, source = read_upload(path)
    except RosetteError as error:
        assert '\n' not in str(error)
        assert str(folder) not in str(error)
        return
    finally:
        path.unlink()
    assert run.source == source.path == plain
    assert np.isfinite(run.centre).all()


@tried(0.2)
@given(
    FILE_NAMES,
    st.one_of(
        changed_logs(),
        mutated(TABLE),
        cells_changed(),
        mutated(small_log('lz4')),
        st.binary(max_size=60),
        st.sampled_from([b'SQLite format 3\0', b'\x28\xb5\x2f\xfd', b'', TABLE]),
    ),
)
def test_an_upload(tmp_path_factory, name, data):
    """Any name, any bytes."""
    folder = tmp_path_factory.getbasetemp() / 'upload'
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    check_upload(name, data, folder)
