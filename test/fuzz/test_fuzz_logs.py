# SPDX-License-Identifier: Apache-2.0
"""Logs that were changed: refused in one line, or what is read is what another reader finds."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from made_up import bounded, corpus, tried
from made_up_changes import changed_logs
from made_up_log import CHANNEL, CHUNK, FOOTER, MESSAGE, SCHEMA, parsed, small_log, unparsed
from mcap.records import Message
from mcap.stream_reader import StreamReader

from rosette_ros.cli.info import log_facts, run_rows
from rosette_ros.core.run.errors import RosetteError
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.touch_log import refit_of
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table, spheres_json

pytestmark = pytest.mark.long

DATA = frozenset((FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK))


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder for logs."""
    return str(tmp_path_factory.mktemp('logs'))


class Reader(StreamReader):
    """The other reader: the mcap library from front to back. Indexes and the like are passed by."""

    def _read_record(self, opcode, length):
        if opcode in DATA:
            return super()._read_record(opcode, length)
        self._stream.read(length)
        return None


def count_messages(path):
    """Return (messages, whether it came to the end) as the other reader finds them."""
    count = 0
    try:
        with open(path, 'rb') as stream:
            for record in Reader(stream, validate_crcs=True).records:
                count += isinstance(record, Message)
    except Exception:  # whatever it is that stops the other reader
        return count, False
    return count, True


def check_log(data, folder):
    """Accept or refuse a log; what is accepted has the messages that another reader finds, or says what is wrong."""
    path = Path(folder) / 'some.mcap'
    path.write_bytes(data)
    with bounded():
        log = read_or_refuse(path)
    if log is None:
        return
    with bounded():
        walked = sum(1 for _ in iter_log(path))
        facts = log_facts(path)
        for run in facts['runs']:
            assert all('\n' not in str(words) for words in [run['problem'] or ''])
            run_rows(run)
        json.dumps(facts)
    count, whole = count_messages(path)
    told = bool(log.truncated or log.problems)
    assert told or whole
    assert told or log.messages == count
    assert walked <= log.messages
    assert told or walked == log.messages
    check_run(log)
    assert path.read_bytes() == data


def read_or_refuse(path):
    """Return the LogRun, None where it is refused in one line that names the file."""
    try:
        return read_log(path)
    except RosetteError as error:
        assert path.name in str(error)
        assert '\n' not in str(error)
        return None


def check_run(log):
    """Make a Run of a log: of finite numbers, or refused in one line."""
    for run_id in log.run_ids or (None,):
        try:
            with bounded():
                run = log.to_run(run_id)
        except RosetteError as error:
            assert 'some.mcap' in str(error)
            assert '\n' not in str(error)
            continue
        finally:
            check_touches(log, run_id)
        assert np.isfinite(run.centre).all()
        assert np.isfinite(run.time).all()
        assert 0 < run.completeness <= 1


def check_touches(log, run_id):
    """Fit the spheres of a run again: finite numbers in every table and text, or refused in one line."""
    try:
        with bounded():
            refit = refit_of(log, run_id)
    except RosetteError as error:
        assert 'some.mcap' in str(error)
        assert '\n' not in str(error)
        return
    assert np.isfinite(refit.centre).all()
    assert np.isfinite(refit.residual).all()
    assert all('\n' not in text for row in sphere_rows(refit) for text in row)
    json.dumps(spheres_json(refit), allow_nan=False)
    sphere_table(refit).csv()


def test_what_is_changed_is_sound_itself(folder):
    """Else nothing that is accepted would ever be met."""
    for compression in ('none', 'lz4', 'zstd'):
        data = small_log(compression)
        assert unparsed(parsed(data)) == data
        path = Path(folder, 'sound.mcap')
        path.write_bytes(data)
        log = read_log(path)
        assert not log.problems
        assert log.to_run().size == 9
        assert count_messages(path) == (log.messages, True)


@tried(0.25)
@given(data=changed_logs())
def test_a_log(folder, data):
    """MCAP: bytes, records, lengths, order, schemas, messages."""
    check_log(data, folder)


@pytest.mark.parametrize('data', corpus('mcap'))
def test_a_log_of_the_corpus(data, tmp_path):
    """What once caused a failure."""
    check_log(data, tmp_path)
