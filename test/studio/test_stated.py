# SPDX-License-Identifier: Apache-2.0
"""What is stated of a run in the studio: from files, from a form, in the result, in the certificate."""

import numpy as np
import pytest
import yaml

from rosette_ros.analysis import summarise
from rosette_ros.api.evaluating import JudgedRun, corrected, correction_of
from rosette_ros.api.measurement import read
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.report import open_source
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.calculations import certified, read_upload
from rosette_ros.studio.stated import OF_FILE, Stated
from rosette_ros.studio.studio_session import Session

IDENTITY = b'schema: rosette-identity/1\ntable: {serial: RT-7}\ntolerances: {EXC: 1 \xc2\xb5m}\n'
INPUTS = b'schema: rosette-budget/1\nradius: {u_um: 1.0, words: MPE}\nenvironment: {class: laboratory}\n'
OF_CELL = b'schema: rosette-budget/1\nenvironment: {machine: {um: 0.2, words: drift test}}\n'


@pytest.fixture(scope='module')
def table(tmp_path_factory):
    """Return the path of a table of a clean run of six balls."""
    path = tmp_path_factory.mktemp('runs') / 'clean.csv'
    write_csv(Machine(MachineConfig().changed(plate={'balls': 6})).run(plan(6, 'random')), path)
    return path


@pytest.fixture
def session(table):
    """Return a session with the run and its summary."""
    made = Session()
    run, source = open_source(table)
    opened = made.open(run, table.name, source)
    made.keep(made.ticket, summary=summarise(opened.run))
    return made


def test_a_file_is_told_by_its_schema():
    """Identity and inputs in either order; anything else is refused by name."""
    made = Stated().with_file(INPUTS, 'inputs.yaml').with_file(IDENTITY, 'identity.yaml', '/lab')
    assert made.identity['table.serial'] == 'RT-7' and made.folder == '/lab'
    assert made.environment == 'laboratory' and made.inputs.values['radius']['u_um'] == 1e-6
    with pytest.raises(InvalidData, match='^x.yaml: expected "schema: rosette-identity/1" or "schema: rosette-budget/1"'
                                          ', found rosette-model/1$'):
        made.with_file(b'schema: rosette-model/1', 'x.yaml')


def test_a_form_states_what_a_file_would():
    """Empty fields state nothing; numbers of the cell stay; words of errors are those of a file."""
    made = Stated().with_file(OF_CELL, 'cell.yaml')
    assert made.environment == OF_FILE
    made = made.with_inputs({'radius': {'u_um': 1.0, 'dof': None, 'words': ''}, 'alignment': {'tilt_urad': None}},
                            OF_FILE)
    assert yaml.safe_load(made.inputs_text) == {
        'schema': 'rosette-budget/1', 'radius': {'u_um': 1.0}, 'environment': yaml.safe_load(OF_CELL)['environment']}
    assert made.with_inputs({}, '').inputs is None
    made = made.with_identity({'table.serial': ' RT-7 ', 'table.maker': ''}, {'EXC': '1 µm', 'EYC': ''})
    assert yaml.safe_load(made.identity_text) == yaml.safe_load(IDENTITY)
    with pytest.raises(InvalidData, match='^form: tolerances: EXC: expected a positive length with its unit'):
        made.with_identity({}, {'EXC': '1'})


def test_the_result_is_that_of_the_command_line(session, table, tmp_path):
    """U with an environment and inputs equals that of `evaluate --inputs`, and the correction takes the same curves."""
    bare = session.results.result.curves.motions
    stated = Stated().with_file(IDENTITY, 'identity.yaml').with_file(INPUTS, 'inputs.yaml')
    session.state(stated)
    inputs = tmp_path / 'inputs.yaml'
    inputs.write_bytes(INPUTS)
    judged = JudgedRun(read(table), inputs=inputs)
    shown = session.results.result
    np.testing.assert_allclose(shown.curves.motions.u, judged.motions.u, rtol=1e-6)
    assert np.all(shown.curves.motions.u > bare.u)
    assert session.results is session.results and session.current.source.identity['table.serial'] == 'RT-7'
    made = correction_of(session.current.run, shown, 'RT-7', ('crz',))
    np.testing.assert_allclose(made.correction.forward.values, corrected(judged, ('crz',)).correction.forward.values,
                               rtol=1e-6, atol=1e-12)
    session.state(Stated())
    np.testing.assert_array_equal(session.results.result.curves.motions.u, bare.u)


def test_a_tolerance_of_another_axis_is_refused(session):
    """Before it counts."""
    with pytest.raises(InvalidData, match='found one of another axis'):
        session.state(Stated().with_identity({}, {'EXA': '1 µm'}))
    assert not session.current.stated.identity.tolerances


def test_a_certificate_needs_the_file_of_the_run(table, tmp_path):
    """Its hash is stated: a run that was uploaded, or a file that has changed, has none."""
    stated = Stated().with_identity({'certificate.number': 'K-1', 'laboratory.country': 'DE',
                                     'measured.begin': '2026-03-01', 'measured.end': '2026-03-01'}, {})
    made = certified(*open_source(table), Model(), stated)
    assert made.xml.startswith(b'<?xml') and made.pages.startswith(b'%PDF') and made.name == 'clean'
    assert made.level == 'good' and 'operator' in made.missing
    copy = tmp_path / 'uploaded.csv'
    copy.write_bytes(table.read_bytes())
    with pytest.raises(InvalidData, match='expected the file of the run as it was opened'):
        certified(*read_upload(copy), Model(), stated)
    with pytest.raises(InvalidData, match='^certificate: expected certificate number'):
        certified(open_run(table), open_source(table)[1], Model(), Stated())
