# SPDX-License-Identifier: Apache-2.0
"""Every field of what the simulated CMM, the studio and a client hear."""

import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from made_up import bounded, tried
from made_up_log import BALLS, RADIUS
from made_up_messages import TEXTS, changed, is_plain, messages
from mute import FIELDS, SAID, Mute, check_words, heard
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import BallCentre, ProbeTarget

from rosette_ros.cell.client import outcome_of
from rosette_ros.core.run.errors import RosetteError
from rosette_ros.nodes.simulated_cmm import SimulatedCmm
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.cell_watcher import CellWatcher
from rosette_ros.studio.figures import filling_figure
from rosette_ros.studio.live_state import CellState

pytestmark = pytest.mark.long

# The simulated CMM, the studio, the client --------------------------------------------------------


class MuteCmm(Mute, SimulatedCmm):
    """A simulated CMM without a graph."""

    def __init__(self, machine):
        """Have measured nothing."""
        Mute.__init__(
            self,
            parameters={'answer_s': 0.0, 'clock_rate_hz': 4.0},
            _machine=machine,
            _run_id=None,
            _file=Path('/nowhere/machine.yaml'),
            _switched_on=0,
            measured=0,
            failed=0,
            _struck=0,
            _last_answer=None,
            _set_back=0.0,
            _newest=0,
            _clock_out=self,
            answers=self,
            touches=self,
        )


CMM_CONFIG = MachineConfig().changed(plate={'balls': BALLS, 'circle_radius_mm': 1e3 * RADIUS})
TARGETS = [message for topic, message, _ in SAID if topic == 'probe_target']


@tried(0.2)
@given(
    st.lists(
        st.one_of(messages(ProbeTarget, **FIELDS), *[changed(one, **FIELDS) for one in TARGETS[3:6]]),
        min_size=1,
        max_size=4,
    )
)
def test_what_the_simulated_cmm_hears(targets):
    """Every target is answered, with a ball centre or with words."""
    node = MuteCmm(Machine(CMM_CONFIG))
    with bounded():
        for target in targets:
            node.on_target(target)
        node.wake()
        node.health()
    given_back = [one for one in node.published if isinstance(one, BallCentre)]
    assert len(given_back) == len(targets)
    for target, answer in zip(targets, given_back, strict=True):
        assert (answer.run_id, answer.seq) == (target.run_id, target.seq)
        assert is_plain(answer.text)
        if answer.status == BallCentre.STATUS_OK:
            assert np.isfinite([answer.centre.x, answer.centre.y, answer.centre.z, answer.table_travel]).all()
        else:
            assert answer.text
    check_words(node.words)


class MuteWatcher(Mute, CellWatcher):
    """The studio's watcher of a cell without a graph."""

    def __init__(self):
        """Have received nothing."""
        node = SimpleNamespace(get_namespace=lambda: '/rosette')
        Mute.__init__(self, state=CellState(), lock=threading.Lock(), _node=node, _where='/rosette')


@tried(0.12)
@given(
    heard('probe_target', 'ball_centre', 'run_state', 'tf_static', 'error_motions', 'calibration_event', 'diagnosis'),
    messages(DiagnosticArray, hardware_id=st.one_of(st.just('rosette'), TEXTS)),
)
def test_what_the_studio_receives(said, health):
    """From a running cell: whatever it is, the page has something that it can draw."""
    watch = MuteWatcher()
    with bounded():
        watch._receive('diagnostics', health)
        for topic, message in said:
            watch._receive(topic, message)
        state = watch.state
        state.health(1.0)
        if state.balls:
            filling_figure(state.balls, state.cells)
        try:
            run = state.part_of_run()
        except RosetteError as error:
            check_words([str(error)])
            return
    assert np.isfinite(run.centre).all()


@tried(0.2)
@given(messages(Calibrate.Result, lists=2), st.integers(0, 6))
def test_results_and_states_that_a_client_hears(result, status):
    """How a calibration ended, and where it stands."""
    with bounded():
        try:
            outcome = outcome_of(SimpleNamespace(result=result, status=status))
        except RosetteError as error:
            check_words([str(error)])
            return
    assert outcome.success == result.success
    if outcome.error_motions is not None:
        assert (
            outcome.error_motions.values.shape == outcome.error_motions.u.shape == (len(result.error_motions.angle), 6)
        )
