# SPDX-License-Identifier: Apache-2.0
"""A table along x over DDS: from the taught axis to curves that are true and have the names of an A axis."""

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import CellClient
from rosette_ros.cli.hidden_demo import compare
from rosette_ros.core.run.axes import axis_rotation
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import Phase
from rosette_ros.simulation import load_machine

pytestmark = pytest.mark.long

N = 6


@pytest.fixture(scope='module')
def cell(module_domain_id, tmp_path_factory, make_cell):
    """Yield a running cell with a table along x."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), N, groups={'placement': {'axis': [1, 0, 0]}},
                   sequencer={'table.axis': [1.0, 0.0, 0.0], 'limits.attempts': 1}) as cell:
        yield cell


def test_curves_of_a_table_along_x(cell, module_domain_id):
    """Messages, log and evaluation agree; the errors are those of noise; the CMM is told from where to probe."""
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate(check=cell.check)
    assert outcome.success, outcome.message
    log = read_log(outcome.log)
    run = log.to_run()
    fit = analyse(run)
    assert np.array_equal(fit.error_motions.values, outcome.error_motions.values)
    assert 0.7 < compare(fit, load_machine(cell.machine), log.frame_of(run.run_id)).rms < 1.3
    assert run.rotation == pytest.approx(axis_rotation([1, 0, 0]), abs=1e-3)
    assert outcome.error_motions.rotation == pytest.approx(run.rotation, abs=1e-12)
    assert outcome.error_motions.iso_names['ctz'] == 'EXA'
    assert {target.pole for target in log.targets if target.phase == Phase.RUN} == {(1.0, 0.0, 0.0)}


def test_an_axis_of_the_other_sense_is_told(cell, module_domain_id):
    """The first ball cannot be probed through the plate: one line says what to check."""
    with CellClient(module_domain_id) as client:
        service = client._node.create_client(SetParameters, 'sequencer/set_parameters')
        assert client._spin_until(service.service_is_ready, 60.0)

        def teach(axis):
            request = SetParameters.Request(parameters=[Parameter('table.axis', value=axis).to_parameter_msg()])
            return client._await(service.call_async(request), 60.0, None).results[0]

        assert 'table.axis: expected a list of 3 numbers' in teach([0.0, 0.0, 0.0]).reason
        assert teach([-1.0, 0.0, 0.0]).successful
        outcome = client.calibrate(check=cell.check)
    assert not outcome.success
    assert ('expected a pole on the free side of the plate, about along (1, 0, 0), found (-1, 0, 0); check the axis '
            'of the '
            'table (table.axis)') in outcome.message
