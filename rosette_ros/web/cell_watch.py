# SPDX-License-Identifier: Apache-2.0
"""Listens to a running cell in a thread of its own, and asks it for calibrations in another."""

import os
import threading
import time
import uuid
from concurrent.futures import ThreadPoolExecutor

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rosette_msgs.msg import BallCentre, CalibrationEvent, ErrorMotions, ProbeTarget, RunState
from tf2_msgs.msg import TFMessage

from rosette_ros.core.errors import CellError, RosetteError
from rosette_ros.data.assemble import TABLE_FRAME
from rosette_ros.nodes import convert, environment, names, qos
from rosette_ros.nodes.client import CellClient
from rosette_ros.nodes.ears import Ears
from rosette_ros.nodes.programme import phase_name
from rosette_ros.nodes.sequence import short_frame
from rosette_ros.web.cell_state import CellState, Progress

_PERIOD = 0.1
_PAUSE = 0.02
"""Messages are let gather for so long: taking many at once costs less, s."""


class CellWatch:
    """Hears a cell and can calibrate it; `lock` guards `state`.

    domain_id: ROS domain, None for that of the environment; namespace: of the cell; outcome: of the
    last calibration asked for here, None before; problem: words of what failed, '' if nothing did.

    Raises CellError where the domain cannot be joined.
    """

    def __init__(self, domain_id=None, namespace=names.NAMESPACE):
        """Join the graph and listen."""
        os.environ.update(environment.added(os.environ))
        self.lock, self.state = threading.Lock(), CellState()
        self.outcome, self.problem = None, ''
        self._where = (domain_id, namespace)
        self._over, self._cancel = threading.Event(), threading.Event()
        self._job = None
        self._asking = ThreadPoolExecutor(1, 'calibrate')
        self._context = Context()
        try:
            self._context.init(domain_id=domain_id)
            own = names.remap_arguments(names.remappings(namespace))
            self._node = Node(f'studio_{uuid.uuid4().hex[:8]}', namespace=f'/{namespace.strip("/")}',
                              context=self._context, cli_args=['--ros-args', *own])
        except (NameValidationException, RuntimeError, ValueError) as error:
            self._context.try_shutdown()
            raise CellError(f'studio: domain {domain_id}, namespace {namespace!r}: cannot be joined: {error}') \
                from error
        self._ears = Ears(self._node, self._lost)
        self._handlers = {}
        for name, kind, handler, profile in (
                (names.RUN_STATE, RunState, self._on_state, qos.COLLECT_LATCHED),
                (names.PROBE_TARGET, ProbeTarget, self._on_target, qos.COLLECT_LATCHED),
                (names.TF_STATIC, TFMessage, self._on_frame, qos.COLLECT_LATCHED),
                (names.BALL_CENTRE, BallCentre, self._on_answer, qos.COLLECT),
                (names.ERROR_MOTIONS, ErrorMotions, self._on_motions, qos.COLLECT_LATCHED),
                (names.CALIBRATION_EVENT, CalibrationEvent, self._on_event, qos.COLLECT),
                (names.DIAGNOSTICS, DiagnosticArray, self._on_health, qos.COLLECT)):
            topic = self._node.resolve_topic_name(name)
            self._handlers[topic] = handler
            self._ears.listen(topic, kind, profile)
        self._thread = threading.Thread(target=self._listen, name='cell watch', daemon=True)
        self._thread.start()

    def close(self):
        """Leave the graph; a calibration that was asked for here is cancelled."""
        self._cancel.set()
        self._asking.shutdown(wait=True)
        self._over.set()
        self._thread.join()
        self._node.destroy_node()
        self._context.try_shutdown()

    # Calibrations

    @property
    def is_asking(self):
        """Whether a calibration that was asked for here is on."""
        return self._job is not None and not self._job.done()

    def calibrate(self, order, seed):
        """Ask for a calibration; how it ends stands in `outcome` or `problem`."""
        if self.is_asking:
            return
        self._cancel.clear()
        self.outcome, self.problem = None, ''
        self._job = self._asking.submit(self._calibrate, order, seed)

    def cancel(self):
        """Cancel the calibration that was asked for here."""
        self._cancel.set()

    def _calibrate(self, order, seed):
        begun = told = False

        def on_progress(_):
            nonlocal begun
            begun = True

        def check():
            nonlocal told
            if self._cancel.is_set() and begun and not told:  # a goal can be cancelled once it is accepted
                told = True
                raise KeyboardInterrupt  # how a client is told to cancel and to wait for the clean end

        try:
            with CellClient(*self._where) as client:
                self.outcome = client.calibrate(order=order, seed=seed, on_progress=on_progress, check=check)
        except (RosetteError, TimeoutError) as error:
            self.problem = ' '.join(str(error).split())

    # Listening

    def _listen(self):
        while not self._over.is_set():
            self._ears.wait(_PERIOD)
            time.sleep(_PAUSE)
            heard = self._ears.take()
            with self.lock:
                for _, topic, message, _ in heard:
                    self._hear(self._handlers[topic], topic, message)

    def _hear(self, handler, topic, message):
        """Take a message; one that is not what its topic wants is told among the faults."""
        try:
            handler(message)
        except RosetteError as error:
            self.state.faults.appendleft((_clock(), f'{topic}: not used: {error}'))

    def _lost(self, topic, count):
        with self.lock:
            self.state.faults.appendleft((_clock(), f'{count} messages on {topic} were lost on the way'))

    def _on_target(self, message):
        self.state.hear_target(convert.target_row(message), convert.point_array(message.centre))

    def _on_answer(self, message):
        self.state.hear_answer(convert.answer_row(message), _clock())

    def _on_state(self, message):
        self.state.hear_progress(Progress(message.run_id, phase_name(message.phase), message.order, message.done,
                                          message.total, message.text), _clock())

    def _on_frame(self, message):
        for one in message.transforms:
            if short_frame(one.child_frame_id) == TABLE_FRAME:
                self.state.hear_frame(convert.frame_record(one.transform))

    def _on_motions(self, message):
        self.state.hear_motions(message.run_id, convert.error_motions_record(message))

    def _on_event(self, message):
        if message.kind == CalibrationEvent.REJECTED:
            self.state.hear_rejection(message.text, _clock())

    def _on_health(self, message):
        for one in message.status:
            if one.hardware_id == self._node.get_namespace().lstrip('/'):
                level = one.level[0] if isinstance(one.level, bytes) else int(one.level)
                self.state.hear_health(one.name.rsplit('/', 1)[-1], level, one.message, time.monotonic())


def _clock():
    return time.strftime('%H:%M:%S')
