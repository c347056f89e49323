# SPDX-License-Identifier: Apache-2.0
"""What the sequencer knows of recorder, evaluator and CMM, and what it requests of them."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from rosette_msgs.msg import Block, CalibrationEvent, ProbeTarget
from rosette_msgs.srv import CheckPlan, NextReadings, Recall, Recorded, StartRecording, StopRecording

from rosette_ros.calibration.calibration_plan import CalibrationPlan
from rosette_ros.calibration.commands import Commands, Until, Warn
from rosette_ros.calibration.state_machine import Sequence
from rosette_ros.core.run.errors import CellError, InvalidPlan, plain
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.io.messages import MACHINE_FRAME, Phase
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import WAKE_PERIOD, CellNode
from rosette_ros.nodes.interfaces import introspected_client
from rosette_ros.nodes.liveliness import SETTLING, process_of

END_EVENTS: dict[int, int] = {Phase.DONE: CalibrationEvent.SUCCEEDED, Phase.CANCELLED: CalibrationEvent.CANCELLED,
                              Phase.FAILED: CalibrationEvent.FAILED}
_AT_ONCE = 1000  # targets that are made at a time, between which the node answers others
_NODE_WORDS = {names.CMM: 'CMM', names.RECORDER: 'recorder'}
BUSY = 2.0  # a node that has called nothing back for this time is told in /diagnostics, s
RESTART = f'wait {1.5 * qos.STATUS_HANGS:g} s for rosette cell to restart it, or restart it'
RECALL_TIMEOUT = 60.0  # how long the recorder may read in its logs, s


class RoleClient:
    """A client of a service in names.SERVERS: what another process than that of the role answers does not count.

    response: the class of its responses."""

    def __init__(self, node: CellNode, service_type: Any, name: str, is_introspected: bool = False,
                 **settings: Any) -> None:
        """Join the graph; is_introspected: whether its traffic is recorded; settings: as of Node.create_client."""
        self._client: Client = (introspected_client if is_introspected else Node.create_client)(
            node, service_type, name, **settings)
        self._servers, self.response = node.servers_of(name), service_type.Response

    @property
    def is_there(self) -> bool:
        """Whether the service is offered."""
        return self._client.service_is_ready()

    def refusal(self) -> str:
        """Return why nothing is asked, and no response counts, now; '' where they may."""
        return self._servers.refusal()

    def send(self, request: Any, done: Callable[[Any], object]) -> Future:
        """Send a request and return the Future of its response, with which `done` is called."""
        future = self._client.call_async(request)
        future.add_done_callback(done)
        return future

    def forget(self, future: Future) -> None:
        """Wait for a response no longer."""
        self._client.remove_pending_request(future)


class Within(NamedTuple):
    """A time limit, s, and the setting that decides it, '' for none."""

    seconds: float
    setting: str = ''

    def __str__(self) -> str:
        """Return it in words."""
        return f'{self.seconds:g} s{f" ({self.setting})" * bool(self.setting)}'


_PLAN_TIMEOUT = Within(30.0)
"""For the answer of the CMM; the ways around 72 balls at all table positions take some seconds."""


@dataclass(eq=False)
class _Call:
    """A request that waits for its response."""

    client: RoleClient
    request: Any
    limit: Within  # of each response
    done: Callable[[Any], None]
    repeat: Callable[[Any], Any]  # returns the next request on a response that is not final, else None
    deadline: float  # steady time, s
    future: Future | None = None  # None until it is sent (again)


class Requests:
    """Requests to one other node; every one is answered, by it or, after the timeout, in its place.

    Nothing is asked while two nodes offer the service; what was asked then is asked again.

    has_answered: whether the last response is that of the other node itself; is_late: whether it is given in place of
    one that did not come in time."""

    def __init__(self, node: CellNode, other: str) -> None:
        """Take the name of the other node, for messages."""
        self._node, self._other = node, other
        self._calls: list[_Call] = []
        self.has_answered, self.is_late = True, False

    def tick(self, now: float) -> None:
        """Repeat requests and answer those that are overdue; call it from a timer. now: steady time, s."""
        for call in list(self._calls):
            if now > call.deadline:
                refusal = call.client.refusal()
                self._answer(call, f'the {self._other} did not answer within {call.limit}'
                             f'{f": {refusal}; end that one" * bool(refusal)}', is_late=True)
            elif not call.client.is_there:
                self._answer(call, f'the {self._other} disconnected before it answered')
            elif call.future is None:
                self._send(call)

    def give_up(self, words: str) -> None:
        """Answer all requests in place of the other node, which will not."""
        for call in list(self._calls):
            self._answer(call, words)

    def _answer(self, call: _Call, words: str, is_late: bool = False) -> None:
        self._calls.remove(call)
        if call.future is not None:
            call.client.forget(call.future)
        self.has_answered, self.is_late = False, is_late
        call.done(call.client.response(success=False, message=words))

    def call(self, client: RoleClient, request: Any, limit: Within, done: Callable[[Any], None],
             repeat: Callable[[Any], Any] = lambda response: None) -> None:
        """Send a request of a client; done(response) is called once; limit, repeat: as of _Call."""
        call = _Call(client, request, limit, done, repeat, self._node.seconds() + limit.seconds)
        self._calls.append(call)
        self._send(call)

    def _send(self, call: _Call) -> None:
        if not call.client.refusal():
            call.deadline = self._node.seconds() + call.limit.seconds
            call.future = call.client.send(
                call.request, lambda future: self._on_response(call, future, future.result()))

    def _on_response(self, call: _Call, future: Future, response: Any) -> None:
        if call not in self._calls or call.future is not future:
            return
        request = call.request if call.client.refusal() else call.repeat(response)
        if request is not None:
            call.request, call.future = request, None
            return
        self._calls.remove(call)
        self.has_answered, self.is_late = True, False
        call.done(response)


class Recalls(Requests):
    """Reads the logs of the recorder."""

    def __init__(self, node: CellNode) -> None:
        super().__init__(node, names.RECORDER)
        # Not introspected: the response is in a log already. In a group of its own: a coroutine that waits for it
        # holds the group of the node.
        self._recall = RoleClient(node, Recall, names.RECALL, callback_group=MutuallyExclusiveCallbackGroup())

    @property
    def is_there(self) -> bool:
        """Whether the service is offered."""
        return self._recall.is_there

    def recall(self, run: str, done: Callable[[Recall.Response], None]) -> None:
        """Request what is recorded of a run; done(response) is called once."""
        self.call(self._recall, Recall.Request(run=run), Within(RECALL_TIMEOUT), done)


class Progress:
    """Whether a quantity that is looked at every WAKE_PERIOD may still change.

    For `patience` s after it did, and for as many looks as fit into them: a process that stood still meanwhile, waiting
    for its disk or for a processor, has not yet taken what came."""

    def __init__(self, seconds: Callable[[], float], patience: float) -> None:
        """Start; seconds: returns the steady time, s."""
        self._seconds, self._patience = seconds, patience
        self._value: int | None = None
        self._since, self._times = 0.0, 0

    def is_expected(self, value: int) -> bool:
        """Look at it once more; return whether it may still change."""
        if value != self._value:
            self._value, self._since, self._times = value, self._seconds(), 0
        self._times += 1
        return self._times * WAKE_PERIOD < self._patience or self._seconds() - self._since < self._patience


class RecorderLink(Recalls):
    """The sequencer's side of the protocol with the recorder."""

    def __init__(self, node: CellNode) -> None:
        super().__init__(node)
        self._start = RoleClient(node, StartRecording, names.START_RECORDING, is_introspected=True)
        self._stop = RoleClient(node, StopRecording, names.STOP_RECORDING, is_introspected=True)
        self._recorded = RoleClient(node, Recorded, names.RECORDED)

    @property
    def is_there(self) -> bool:
        """Whether all services are offered."""
        return super().is_there and self._start.is_there and self._stop.is_there

    def start(self, run_id: str, resumes: str, limit: Within, done: Callable[[StartRecording.Response], None]) -> None:
        """Request a log; resumes: of the log that the run goes on from, '' for none."""
        self.call(self._start, StartRecording.Request(run_id=run_id, resumes=resumes), limit, done)

    def stop(self, request: StopRecording.Request, limit: Within,
             done: Callable[[StopRecording.Response], None]) -> None:
        """Request to close the log of a run that has ended, until the recorder has closed it or says why not."""
        self.call(self._stop, request, limit, done,
                  self._while_missing(request, limit, lambda response: not response.log))

    def recorded(self, request: Recorded.Request, limit: Within, done: Callable[[Recorded.Response], None]) -> None:
        """Request whether the log holds results and readings; what is missing is waited for as in Progress."""
        self.call(self._recorded, request, limit, done,
                  self._while_missing(request, limit, lambda response: response.success))

    def _while_missing(self, request: Any, limit: Within, is_waiting: Callable[[Any], bool]) -> Callable[[Any], Any]:
        """Return what repeats a request while the log lacks something that may still come, as in Progress."""
        progress = Progress(self._node.seconds, 0.8 * limit.seconds)

        def repeat(response: Any) -> Any:
            missing = len(response.missing)
            return request if missing and is_waiting(response) and progress.is_expected(missing) else None

        return repeat


class PlanCheck:
    """The question to the CMM, once for each run and for each block that may be added to its plan."""

    def __init__(self, node: CellNode) -> None:
        self._node, self._cmm = node, Requests(node, _NODE_WORDS[names.CMM])
        self._client = RoleClient(node, CheckPlan, names.CHECK_PLAN)
        self._plan: CalibrationPlan | None = None
        self._targets: Iterator[ProbeTarget] | None = None
        self._question = CheckPlan.Request()
        self._answer: CheckPlan.Response | None = None

    @property
    def is_asking(self) -> bool:
        """Whether the question is made, or its answer is awaited."""
        return self._targets is not None or (self._plan is not None and self._answer is None)

    def is_passed(self, run_id: str, plan: CalibrationPlan, now: float, begin: int = 0) -> bool:
        """Return whether the CMM takes a plan, or does not offer to say so; False while it is asked.

        now: steady time, s; begin: index of the first target of which it is not known. Raises CellError where it does
        not, in its words, or does not say."""
        if self._plan is not plan:
            self._plan, self._question, self._targets = plan, CheckPlan.Request(), None
            self._answer = CheckPlan.Response(success=True)
            if self._client.is_there:
                self._targets, self._answer = self._targets_of(run_id, plan, begin), None
        if self._targets is not None:
            more = list(islice(self._targets, _AT_ONCE))
            self._question.targets.extend(more)
            if len(more) == _AT_ONCE:
                return False
            self._targets = None
            self._cmm.call(self._client, self._question, _PLAN_TIMEOUT, self._take)
            self._question = CheckPlan.Request()
        self._cmm.tick(now)
        if self._answer is None:
            return False
        if not self._answer.success:
            raise CellError(f'{"the CMM cannot measure this plan: " * self._cmm.has_answered}'
                            f'{plain(self._answer.message, most=2000)}')
        return True

    def _take(self, answer: CheckPlan.Response) -> None:
        self._answer = answer

    def _targets_of(self, run_id: str, plan: CalibrationPlan, begin: int) -> Iterator[ProbeTarget]:
        stamp = self._node.now().to_msg()
        for index in range(begin, plan.total):
            target = plan.placed(plan.target(index), plan.taught, MACHINE_FRAME)
            yield conversions.target_message(target._replace(run_id=run_id), stamp)


class NextBlock:
    """The question to the evaluator which readings settle what is open, and to the CMM whether it takes them."""

    def __init__(self, node: CellNode, evaluator: Requests, plan_check: PlanCheck) -> None:
        self._evaluator, self._plan_check = evaluator, plan_check
        self._client = RoleClient(node, NextReadings, names.NEXT_READINGS)
        self._request, self._response = NextReadings.Request(), None  # the last ones
        self._sequence: Sequence | None = None  # for which they are
        self._plan: CalibrationPlan | None = None  # with the readings in the response

    def refuse_none(self, sequence: Sequence) -> None:
        """Raise CellError where a sequence will ask, and no evaluator offers to answer."""
        if sequence.until and not self._client.is_there:
            raise CellError(f'until: expected an evaluator with the service {names.NEXT_READINGS}, found none; start '
                            'another one, or calibrate without until')

    def ask(self, sequence: Sequence, readings_hash: str, readings: int, refused: Iterable[Block] = ()) -> None:
        """Ask for at most so many readings after those with a hash, no refused block; `tick` has the answer."""
        until = sequence.until or Until(0.0, 0.0, 0)
        request = NextReadings.Request(
            run_id=sequence.run_id, readings_hash=readings_hash, readings=readings, refused=list(refused),
            until_probability=until.probability, until_uncertainty=until.uncertainty)
        self._sequence, self._request, self._response, self._plan = sequence, request, None, None

        def take(response: NextReadings.Response) -> None:
            if self._request is request:
                self._response = response

        limits = sequence.limits
        limit = Within(limits.attempts * limits.evaluation_timeout, 'limits.attempts times limits.evaluation_timeout_s')
        self._evaluator.call(self._client, request, limit, take)

    def tick(self, sequence: Sequence, now: float) -> Commands:
        """Return what follows for a sequence once evaluator and CMM have answered; now: steady time, s."""
        response, request = self._response, self._request
        if response is None or sequence is not self._sequence:
            return ()
        text, words = (plain(one, most=2000) for one in (response.text, response.message))
        block: Scheme | None = None
        try:
            block = conversions.block_scheme(response.block, sequence.plan.scheme.n)
            if response.success and block is not None:
                sequence.refuse_block(block)
                self._plan = self._plan or sequence.plan.followed_by(block)
                if not self._plan_check.is_passed(sequence.run_id, self._plan, now, sequence.plan.run_end):
                    return ()
        except InvalidPlan as error:
            response.success, words = False, str(error)
        except CellError as error:
            if len(request.refused) < sequence.limits.attempts:
                self.ask(sequence, request.readings_hash, request.readings, [*request.refused, response.block])
                return (Warn(f'{error}; asking for other readings'),)
            block, text = None, f'{text}; {error}'
        self._response = None
        if self._evaluator.is_late:  # not asked again: it would first answer this question
            return sequence.not_answered(words)
        if not response.success:
            return sequence.not_decided(words, now)
        return sequence.decided(block, text, now, response.settled)


def target_subscriptions(node: Node) -> list[Any]:
    """Return the subscriptions to targets of CMMs: of the processes that publish ball centres.

    Recorder, evaluator, studio and other observers subscribe too. Where no process does both, all but the cell's own
    are returned: a CMM may be two processes."""
    targets, centres = map(node.resolve_topic_name, (names.PROBE_TARGET, names.BALL_CENTRE))
    answering = {process_of(info.endpoint_gid) for info in node.get_publishers_info_by_topic(centres)}
    infos = node.get_subscriptions_info_by_topic(targets)
    return [info for info in infos if process_of(info.endpoint_gid) in answering] or [
        info for info in infos if info.node_name not in (names.RECORDER, names.EVALUATOR)]


class Trouble(NamedTuple):
    """What keeps a run from going on: nodes that are disconnected or restarted, several publishers of one topic, in
    words, and whether answers, or perhaps the open target, were not used because of them."""

    gone: list[str]
    restarted: list[str]
    conflict: str
    has_ignored: bool

    @property
    def nodes(self) -> list[str]:
        """The nodes that are disconnected or restarted."""
        return list(dict.fromkeys(self.gone + self.restarted))

    def __str__(self) -> str:
        """Return it in words, '' where there is none."""
        if self.nodes:
            return f'{" and ".join(f"the {_NODE_WORDS[name]}" for name in self.nodes)} is disconnected'
        others = f'another node has published {names.BALL_CENTRE} or {names.PROBE_TARGET}'
        return self.conflict or others * self.has_ignored


class CellMonitor:
    """The nodes that a calibration needs, as the graph and their statuses describe them.

    status: what the cell lacks, or that it is complete, in words."""

    def __init__(self, node: CellNode, recorder: RecorderLink) -> None:
        self._node, self._recorder = node, recorder
        self._monitors = {name: node.monitor(name) for name in names.NODES}
        self._publishers_of = {topic: node.publishers_of(topic) for topic in names.PUBLISHERS}
        self._of_one = [*self._publishers_of.values(), *map(node.servers_of, names.SERVERS)]
        self._complete_since: float | None = None
        self._endpoints: frozenset[bytes] = frozenset()
        self.status = self._logged = ''
        self._status_since = 0.0

    def missing(self, with_recorder: bool) -> list[str]:
        """Return what the cell lacks for a calibration, in words."""
        node = self._node
        missing = ['the CMM is being tried (rosette check-cmm)' if one.is_tried else
                   f'{one.conflict}; wait' if one.is_restart else
                   f'{one.conflict}: expected one in this domain and namespace; is another cell running? Give each its '
                   'own (--domain, --namespace)' for one in self._of_one if one.conflict]
        if not (self._publishers_of[names.BALL_CENTRE].found and target_subscriptions(node)):
            missing.append(f'no CMM: expected one that subscribes to {names.PROBE_TARGET} and publishes '
                           f'{names.BALL_CENTRE}, found none; '
                           f'{self._remedy(names.CMM, "start simulated_cmm or connect a CMM")}')
        elif not node.has_time():
            missing.append('no time: with use_sim_time the CMM publishes /clock, none was received')
        if not node.count_publishers(names.ERROR_MOTIONS) or self._is_disconnected(names.EVALUATOR):
            missing.append(f'no evaluator: expected one that publishes {names.ERROR_MOTIONS}, found none; '
                           f'{self._remedy(names.EVALUATOR, "start it")}')
        elif (busy := self._monitors[names.EVALUATOR].busy) > node.parameters['limits.evaluation_timeout_s']:
            missing.append(f'the evaluator has answered nothing for {busy:.0f} s: it computes or hangs; wait, or '
                           'restart it')
        if with_recorder and (self._is_disconnected(names.RECORDER) or not self._recorder.is_there):
            missing.append(f'no recorder: expected its service {names.START_RECORDING}, found none; '
                           f'{self._remedy(names.RECORDER, "start it, or set require_recorder to false")}')
        return missing

    def _remedy(self, name: str, words: str) -> str:
        """Return what to do where a node is missing: `words`, unless it was there."""
        return f'it has ended or hangs: {RESTART}' if self._is_disconnected(name) else words

    def update(self, now: float, with_recorder: bool) -> None:
        """Check which nodes are present; log what the cell lacks, and when it has become complete and settled.

        What it lacks is logged after SETTLING s: while nodes discover each other it changes at every moment."""
        lacks = '; '.join(self.missing(with_recorder))
        endpoints = self._find_endpoints()
        if lacks or endpoints - self._endpoints:  # those of a node that was killed leave long after it
            self._complete_since = None
        self._endpoints = endpoints
        if not lacks and self._complete_since is None:
            self._complete_since = now
        status = lacks or (names.COMPLETE if self.is_settled(now) else 'the nodes are getting connected')
        if status != self.status:
            self.status, self._status_since = status, now
        if status != self._logged and (not lacks or now - self._status_since >= SETTLING):
            log, was_complete, self._logged = self._node.get_logger(), self._logged == names.COMPLETE, status
            if lacks and was_complete and not any(one.is_tried for one in self._publishers_of.values()):
                log.warning(status)
            else:
                log.info(status)

    def is_settled(self, now: float) -> bool:
        """Return whether all nodes have been present long enough, and the recorder receives from all of them."""
        return self._complete_since is not None and now - self._complete_since >= SETTLING and self._is_recorded()

    def _is_recorded(self) -> bool:
        """Return whether the recorder receives the statuses of the others; a node without one is left out."""
        recorder = self._monitors[names.RECORDER]
        others = {monitor.process for name, monitor in self._monitors.items()
                  if name != names.RECORDER and monitor.process and not monitor.is_disconnected}
        return not recorder.process or recorder.is_disconnected or others <= set(recorder.hears)

    def processes(self) -> dict[str, str]:
        """Return what serves a run now, by node: the CMM by its endpoint, a recorder by its process."""
        recorder = self._monitors[names.RECORDER].process
        answers = b''.join(self._publishers_of[names.BALL_CENTRE].used).hex()
        return {names.CMM: answers, **({names.RECORDER: recorder} if recorder else {})}

    def trouble(self, processes: dict[str, str], ignored: int) -> Trouble:
        """Return what keeps a run from going on; processes, ignored: as it was asked last."""
        answers, now = self._publishers_of[names.BALL_CENTRE], self.processes()
        is_gone = {names.CMM: answers.is_restart or not answers.found & answers.used,
                   names.RECORDER: self._is_disconnected(names.RECORDER)}
        return Trouble([name for name in processes if is_gone[name]],
                       [name for name, process in processes.items() if now.get(name) != process],
                       '; '.join(filter(None, (one.conflict for one in self._publishers_of.values()))),
                       self.ignored != ignored)

    @property
    def ignored(self) -> int:
        """Number of answers that were not used because another node published, or of targets that may not be."""
        return sum(self._publishers_of[topic].ignored for topic in (names.BALL_CENTRE, names.PROBE_TARGET))

    def problems(self, nodes: Iterable[str]) -> str:
        """Return why nodes that are there cannot do their work, in their own words; '' where all can."""
        return '; '.join(problem for name in nodes if (problem := self._monitors[name].problem)
                         and not self._is_disconnected(name))

    def is_late(self, name: str) -> bool:
        """Return whether it shows within a second whether this node is disconnected."""
        return self._monitors[name].is_late

    def busy(self) -> list[str]:
        """Return which present nodes call nothing back: they compute, or they hang."""
        return [f'{name} has answered nothing for more than {BUSY:g} s: it computes, hangs or lacks processor time'
                for name, monitor in self._monitors.items() if monitor.busy > BUSY and not monitor.is_disconnected]

    def _is_disconnected(self, name: str) -> bool:
        return self._monitors[name].is_disconnected

    def _find_endpoints(self) -> frozenset[bytes]:
        """Return the endpoints of the cell's main topics: those of a restarted node are others."""
        node = self._node
        centres, motions = map(node.resolve_topic_name, (names.BALL_CENTRE, names.ERROR_MOTIONS))
        infos = (*node.get_publishers_info_by_topic(centres), *node.get_publishers_info_by_topic(motions),
                 *node.get_subscriptions_info_by_topic(centres))
        return frozenset(bytes(info.endpoint_gid) for info in infos)
