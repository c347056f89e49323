# SPDX-License-Identifier: Apache-2.0
"""A Run into a log and back: `rosette import` and `rosette export`."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from rosette_ros.cli.runs import run_facts
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.remarks import RemarkKind
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import format_csv, parse_csv
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.log_writer import whole_log
from rosette_ros.io.messages import Phase
from rosette_ros.io.run_to_log import LATCHED, write_log
from rosette_ros.presentation.formatting import instant
from rosette_ros.presentation.report.provenance import open_source


def make_run(n=4, seed=0, **options):
    """Return a run with actual angles and some unknown temperatures, times in ns."""
    rng = np.random.default_rng(seed)
    scheme = plan(n, 'random', seed)
    time = np.cumsum(rng.integers(1, 10**11, n * n)) * 1e-9
    temperature = np.where(rng.random(n * n) < 0.3, np.nan, 20 + rng.random(n * n))
    return Run(
        n, 0.1825, scheme.table_position, scheme.ball,
        scheme.centres(0.1825) + 1e-6 * rng.standard_normal((n * n, 3)),
        table_angle=scheme.table_angle + 1e-6 * rng.standard_normal(n * n), time=time - time[0],
        temperature=temperature, approach=scheme.approach, run_id='some_run', **options)


def test_the_day_goes_from_a_log_into_a_table_and_back(library, tmp_path):
    """To the microsecond; a run whose times count from 0 has none, and a date before this program is refused."""
    begun = 1795680083.123456
    log = write_log(make_run(begun=begun), tmp_path / 'dated', library)
    text = format_csv(read_log(log).to_run())
    assert '# first_reading_at: 2026-11-26T08:01:23.123456+00:00\n' in text
    assert parse_csv(text.encode()).begun == begun
    undated = write_log(make_run(), tmp_path / 'undated', library)
    assert read_log(undated).to_run().begun is None and 'first_reading_at' not in format_csv(read_log(undated).to_run())
    for stated, seconds in (('2026-11-26T09:01:23.123456+01:00', begun), ('2026-11-26 08:01:23', begun // 1)):
        assert parse_csv(text.replace('2026-11-26T08:01:23.123456+00:00', stated).encode()).begun == seconds
    for bad in ('yesterday', '1970-01-01T00:00:00Z', '9999-13-01'):
        with pytest.raises(InvalidData, match='first_reading_at: a date such as 2026-11-27T08:00:34Z, found'):
            parse_csv(text.replace('2026-11-26T08:01:23.123456+00:00', bad).encode())


def test_the_day_of_a_table_with_an_axis_goes_into_its_log(library, tmp_path):
    """The transform of the axis is no message of 1970."""
    begun = 1795680083.0
    log = read_log(write_log(make_run(begun=begun, rotation=np.eye(3)), tmp_path / 'log', library))
    assert log.to_run().begun == begun and log.start_ns == begun * 1e9


def test_runs_of_one_log_have_each_its_own_day(library, tmp_path):
    """Not the day on which the log begins."""
    days = {'some_run': 1795680083.0, 'next_week': 1795680083.0 + 7 * 86400}
    logs = [write_log(make_run(begun=begun).replace(run_id=name), tmp_path / name, library)
            for name, begun in days.items()]
    with whole_log(tmp_path / 'both', 'both') as writer:
        for topic in read_log(logs[0]).topics:
            writer.add_topic(topic.name, library.definition(topic.type_name), (LATCHED,))
        for message in itertools.chain(*map(iter_log, logs)):
            writer.write(message.topic, message.data, message.log_time, message.publish_time)
    for name, begun in days.items():
        run, source = open_source(tmp_path / 'both', name)
        assert run.begun == begun
        assert source.begun == instant(round(1e9 * begun))
        assert source.ended == instant(round(1e9 * (begun + np.ptp(run.time))))


def test_a_run_begins_with_its_first_reading():
    """Alignment and repeatability were measured before it, from 2 min on after the begin of the log."""
    path = Path(__file__).parents[1] / 'golden' / 'logs' / 'log_clean_n6_diagonal'
    log = read_log(path)
    run, source = open_source(path)
    first = min(one.stamp_ns for one in log.answers if log.runs[run.run_id].last_target(one.seq).phase == Phase.RUN)
    assert 0.0 <= run.begun - 1e-9 * first < 20.0, "a simulated clock goes on with the next reading"
    assert 1e9 * run.begun > log.start_ns + 120e9
    assert source.begun == instant(round(1e9 * run.begun)) and run_facts(path)['measured'] == source.begun[:16]


@settings(max_examples=20, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(n=st.integers(3, 6), seed=st.integers(0, 1000), sigma=st.none() | st.floats(1e-9, 1e-5))
def test_log_gives_the_run_back_to_the_last_bit(tmp_path_factory, library, n, seed, sigma):
    """Everything is kept; the repeatability goes along though it was not measured there."""
    axes = sigma and (1e-7, 1 / 3e6, 2e-7)
    run = make_run(n, seed, repeatability=sigma, repeatability_dof=sigma and 27.0, repeatability_axes=axes)
    path = write_log(run, tmp_path_factory.mktemp('logs') / 'log', library)
    back = read_log(path).to_run()
    for name in ('table_position', 'ball', 'centre', 'table_angle', 'temperature', 'approach',
                 'table_travel'):
        assert getattr(back, name).tobytes() == getattr(run, name).tobytes(), name
    np.testing.assert_allclose(back.time, run.time, rtol=1e-15, atol=1e-12)
    assert (back.n, back.radius, back.run_id) == (run.n, run.radius, run.run_id)
    assert (back.repeatability, back.repeatability_dof, back.repeatability_axes) == (sigma, sigma and 27.0, axes)


def test_bare_file_of_the_log_tells_the_repeatability_too(library, tmp_path):
    """custom_data stands in the .mcap as well: metadata.yaml need not travel."""
    run = make_run(repeatability=1.5e-7, repeatability_dof=6.0)
    path = write_log(run, tmp_path / 'log', library)
    back = read_log(path / 'log_0.mcap').to_run()
    assert (back.repeatability, back.repeatability_dof) == (1.5e-7, 6.0)


@pytest.mark.parametrize(('sigma', 'kinds'), [(1e-7, []), (1e-9, [RemarkKind.ROUNDED])])
def test_rounding_is_judged_alike_in_a_table_and_in_a_log(library, tmp_path, sigma, kinds):
    """By the repeatability that goes along: steps of 10 nm beside 0.1 um are nothing to remark on."""
    run = make_run(repeatability=sigma)
    table = parse_csv(format_csv(run.replace(centre=np.round(run.centre, 8))).encode())
    back = read_log(write_log(table, tmp_path / 'log', library)).to_run()
    for one in (table, back):
        assert [remark.kind for remark in one.remarks if remark.kind is RemarkKind.ROUNDED] == kinds


def test_rosbags_decodes_the_log(library, tmp_path):
    """Types, hashes and values by a reader that is not ours."""
    run = make_run()
    with AnyReader([write_log(run, tmp_path / 'log', library)]) as reader:
        read = [reader.deserialize(data, connection.msgtype)
                for connection, _, data in reader.messages()]
    targets, answers = read[::2], read[1::2]
    assert [answer.centre.y for answer in answers] == run.centre[:, 1].tolist()
    assert [target.ball for target in targets] == run.ball.tolist()
    assert {answer.header.frame_id for answer in answers} == {'table'}
    assert answers[3].table_travel == run.table_travel[3]


def test_export_and_import_change_nothing(library, tmp_path):
    """Log to CSV to log: coordinates to 1e-15 m, angles to the last bit, the time exactly."""
    run = read_log(write_log(make_run(), tmp_path / 'one', library)).to_run()
    table = parse_csv(format_csv(run).encode())
    back = read_log(write_log(table, tmp_path / 'two', library)).to_run()
    assert np.abs(back.centre - run.centre).max() <= 1e-15
    assert np.abs(back.table_angle - run.table_angle).max() <= 1e-15
    assert back.time.tobytes() == run.time.tobytes()


def test_planned_repeats_go_along(library, tmp_path):
    """A pair that stands twice on purpose is no mistake after the import either."""
    run = make_run(repeats=True)
    twice = run.take([*range(16), 15])
    back = read_log(write_log(twice, tmp_path / 'log', library)).to_run()
    assert (back.size, back.repeats) == (17, True)


def test_simulated_readings_stay_simulated(library, tmp_path):
    """In a table and in the log made of it; nothing else says so of a run."""
    run = parse_csv(format_csv(make_run(simulated=True)).encode())
    assert run.simulated and '# simulated: yes\n' in format_csv(run)
    assert read_log(write_log(run, tmp_path / 'log', library)).to_run().simulated
    assert not parse_csv(format_csv(make_run()).encode()).simulated
    assert not read_log(write_log(make_run(), tmp_path / 'other', library)).to_run().simulated


def test_run_longer_than_stamps_is_refused_with_words(library, tmp_path):
    """Seconds in a stamp end in 2038; nothing is wrapped around in silence."""
    run = make_run()
    run = run.replace(time=1e8 * run.time)
    with pytest.raises(InvalidData, match='time: expected a run of less than 2147483648 s, found'):
        write_log(run, tmp_path / 'log', library)


def test_no_log_is_overwritten(library, tmp_path):
    """A folder with a log stays as it is."""
    write_log(make_run(), tmp_path / 'log', library)
    with pytest.raises(InvalidData, match='holds a log already'):
        write_log(make_run(), tmp_path / 'log', library)


@pytest.mark.parametrize('run_id', ['a\x1b[31mb', 'a\x1b]0;title\x07b', 'a\x9b31mb\u202e'])
def test_control_characters_of_a_run_id_reach_no_screen(library, tmp_path, run_id):
    """Of a log and of a table; what a terminal would obey becomes spaces."""
    run = replace(make_run(), run_id=run_id)
    log = read_log(write_log(run, tmp_path / 'log', library))
    ids = [*log.runs, log.to_run().run_id, parse_csv(format_csv(run).encode()).run_id]
    assert all(one.isprintable() and one.startswith('a ') for one in ids), ids
