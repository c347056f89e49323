# SPDX-License-Identifier: Apache-2.0
"""All tables of an archive: conformity of the last result, when a calibration is due, the most urgent first."""

import datetime
import json

import pytest

from benchmarks.ageing import years
from rosette_ros.analysis import RunResult, analyse, find
from rosette_ros.archive.plant import plant_of
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import decided_by, evaluation_row, heading
from rosette_ros.cli.main import main
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.uncertainty.error_summary import Conformity, doubt_of
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.simulation import Machine, MachineConfig

START = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
SETTINGS = {'plate': {'balls': 5}, 'table': {'translation_um': 0.5, 'rotation_urad': 5.0}}
MONTH = datetime.timedelta(days=30)


def row_of(serial, when, tolerance, run):
    """Return the row of a run of a table, under a tolerance of crz."""
    identity = parse_identity(f'schema: rosette-identity/1\ntable: {{serial: {serial}}}\n{tolerance}'.encode())
    return {**heading(f'{serial}{when}', '/logs/one', '', Model(), START, f'run of {serial}'),
            **evaluation_row(analyse(run), identity=identity), 'measured_at': when}


@pytest.fixture(scope='module')
def archive(tmp_path_factory):
    """Return an archive: a table out of its tolerance, one within it for nine months, one without a tolerance."""
    made = RunArchive(tmp_path_factory.mktemp('plant') / 'plant', make=True)
    runs = [run for _, run in years(lambda day: SETTINGS, 9, every_days=30.0)]
    made.add([row_of('OUT', START, 'tolerances: {crz: 0.1 urad}\n', runs[0]), row_of('NONE', START, '', runs[0]),
              *(row_of('KEPT', START + place * MONTH, 'tolerances: {crz: 1 mrad}\n', run)
                for place, run in enumerate(runs))])
    return made


def test_the_most_urgent_table_stands_first(archive, capsys):
    """What does not conform, then what nothing is stated of, then what is kept; the interval is at most twice 30 d."""
    last = START + 8 * MONTH
    out, unknown, kept = plant_of(archive, last + datetime.timedelta(days=1))
    assert [one.serial for one in (out, unknown, kept)] == ['OUT', 'NONE', 'KEPT']
    assert (out.conformity, out.level, out.reasons) == ('does not conform', 'bad', ('crz does not conform',))
    assert (unknown.conformity, unknown.level, unknown.due) == (None, '', None)
    assert (kept.conformity, kept.level, kept.runs, kept.is_due) == ('conforms', 'good', 9, False)
    assert last + MONTH / 2 <= kept.due <= last + 2 * MONTH
    assert main(['archive', 'plant', str(archive.folder), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found['schema'], [one['table'] for one in found['tables']][:1]) == ('rosette-plant/1', ['OUT'])
    assert main(['archive', 'plant', str(archive.folder)]) == 0
    assert 'the most urgent first' in capsys.readouterr().out


def test_what_the_order_hides_is_decided_by_no_interface(tmp_path):
    """In the order row without an environment U lacks what it hides: a wide tolerance is not said to be kept."""
    run = Machine(MachineConfig().changed(seed=1, plate={'balls': 6})).run(plan(6, 'row', 1), run_id='row')
    found, wide = find(run), 'tolerances: {crz: 1 mrad, ctx: 0.5 mm}\n'
    identity = parse_identity(f'schema: rosette-identity/1\ntable: {{serial: ROW}}\n{wide}'.encode())
    row = {**heading('row', '/logs/row', '', Model(), START, 'row'), **evaluation_row(
        found.fit, found, identity=identity), 'measured_at': START}
    limits = identity.limits(run.rotation)
    assert doubt_of(found.verdict) == row['doubt'] != ''
    assert {line.conformity for line in RunResult(found.fit, found).curves.lines(limits) if line.tolerance} == {
        Conformity.UNDECIDED}
    assert decided_by(row, limits) == {'ctx': Conformity.UNDECIDED, 'crz': Conformity.UNDECIDED}
    assert decided_by({**row, 'doubt': None}, limits) == decided_by(row, limits), 'a row that does not know it'
    made = RunArchive(tmp_path / 'plant', make=True)
    made.add([row])
    assert [one.conformity for one in plant_of(made, START)] == [Conformity.UNDECIDED]


def test_a_calibration_that_is_due_is_urgent(archive):
    """A year later."""
    states = {one.serial: one for one in plant_of(archive, START + 24 * MONTH)}
    assert states['KEPT'].is_due and states['KEPT'].level == 'bad' and 'calibration due' in states['KEPT'].reasons


def test_an_archive_without_serial_numbers_says_what_is_wanted(tmp_path):
    """Runs of no table are no plant."""
    made = RunArchive(tmp_path / 'plant', make=True)
    with pytest.raises(InvalidData, match='expected dated runs that state the serial number of their table'):
        plant_of(made, START)
