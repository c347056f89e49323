# SPDX-License-Identifier: Apache-2.0
"""A run that is measured and cannot be evaluated, in a whole cell."""

from rosette_ros.cell.client import CellClient
from rosette_ros.core.model.model import Model
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.model_file import write_model


def test_a_model_that_the_order_cannot_determine_ends_the_run_at_once(cell_of, domain_id, tmp_path):
    """The sequencer waited 120 s for error motions; the reason stood in the output of the evaluator alone.

    The cell goes on: the next run, in an order that determines the model, succeeds."""
    model = tmp_path / 'model.yaml'
    write_model(Model().with_effect('table_backlash'), model)
    with cell_of(params={'evaluator': {'model': str(model)}}) as cell, CellClient(domain_id) as client:
        failed = client.calibrate('column', check=cell.check)
        assert not failed.success
        assert ': table_backlash cannot be seen in this order of measurement' in failed.message
        outcome = client.calibrate('there_and_back', check=cell.check)
        assert outcome.success, outcome.message
    logs = [read_log(path) for path in sorted((tmp_path / 'runs').iterdir())]
    assert [log.problems for log in logs] == [(), ()]
