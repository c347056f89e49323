# SPDX-License-Identifier: Apache-2.0
"""rosette replay: publishes the messages of a log and its runs, and compares the error motions of an evaluator."""

import argparse
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import TransformStamped
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rosette_msgs.msg import ErrorMotions as ErrorMotionsMessage
from rosette_msgs.msg import ProbeTarget, Run, RunState
from rosette_msgs.srv import NextReadings
from tf2_msgs.msg import TFMessage

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import GraphClient
from rosette_ros.cell.supervisor import Cell
from rosette_ros.cli.arguments import add_shared, positive
from rosette_ros.cli.console import console, print_table
from rosette_ros.core.diagnosis.run_result import Which
from rosette_ros.core.run.errors import CellError, InvalidData, plain
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.io.bag_metadata import TopicSummary
from rosette_ros.io.log_reader import LoggedMessage, iter_log, read_log
from rosette_ros.io.log_run import BALL_CENTRE, PROBE_TARGET, LogRun, PublishedMotions
from rosette_ros.io.messages import Target, answer_of, target_of
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.conversions import published_motions, qos_profile, run_message
from rosette_ros.nodes.interfaces import decoded, interface_class
from rosette_ros.presentation.tables import curves

INPUTS = (names.PROBE_TARGET, names.BALL_CENTRE, names.RUN_STATE, names.TF_STATIC, names.CLOCK)
"""What of a log is published as it is, by the last part of the topic."""
FASTEST = 4000
"""Most messages per second: the queue of a subscriber, some thousand long, must not overflow."""
LIVE_PATIENCE = 3.5
"""How long a running cell is searched for before anything is published, s; participants announce themselves every 3."""
SEARCH_TIMEOUT, START_TIMEOUT, RESULT_TIMEOUT = 5.0, 20.0, 60.0
_BATCH = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('log', metavar='RUN', help='log directory or .mcap file')
    parser.add_argument('--rate', metavar='X', type=positive('times the recorded rate'),
                        help='times the recorded rate (default: as fast as possible)')
    add_shared(parser, '--domain')
    add_shared(parser, '--namespace', default=None, help='namespace to publish in (default: that of the log)')


def run(options: argparse.Namespace) -> None:
    """Replay and compare."""
    log = read_log(options.log)
    expected = expected_motions(log)
    out = console()
    with LogPlayer(log.topics, options.domain, options.namespace) as player:
        if player.await_evaluator(SEARCH_TIMEOUT):
            found = replay(player, options, log, expected)
        else:
            player.refuse_running_cell()
            out.print('No evaluator in this ROS domain: starting one for this replay.')
            with Cell(options.domain, player.namespace, nodes=(names.EVALUATOR,), remappings=player.remappings) as cell:
                if not player.await_evaluator(START_TIMEOUT):
                    raise CellError('replay: the evaluator has started but does not receive the messages; another '
                                    'middleware, or a firewall on the loopback interface?')
                found = replay(player, options, log, expected)
                cell.check()
    differ = [show(out, run_id, published_motions(found[run_id]), wanted) for run_id, wanted in expected.items()]
    if any(differ):
        raise InvalidData(f'{options.log}: expected the error motions of the log, found others; another version of the '
                          'software, or another model?')
    if others := [seq for seq, is_same in player.decisions if not is_same]:
        raise InvalidData(f'{options.log}: expected the next readings after target {others[0]} as in the log, found '
                          'others; another version of the software, or another model?')
    if player.decisions:
        out.print(f'[green]next readings equal to those in the log, {len(player.decisions)} times[/]')


class Expected(NamedTuple):
    """The curves expected of one run as modelled, their source, and whether u is, too: no message has an imported one.

    result: the result, None where it was not looked for what is missing, or a log is older than this."""

    motions: ErrorMotions
    source: str
    with_u: bool
    result: ErrorMotions | None = None


def expected_motions(log: LogRun) -> dict[str, Expected]:
    """Return by run_id what is expected: as published in the log, or (an imported table) as evaluated now.

    Raises InvalidData where there is no run to evaluate.
    """
    expected = {run_id: Expected(published.modelled, 'in the log', True, published.judged) for run_id in log.run_ids
                if (published := log.latest_error_motions(run_id))}
    if not expected and not log.states:
        run = log.to_run()
        if not run.is_complete:
            raise InvalidData(f'{log.path}: expected all {run.n**2} ball centres, for which an evaluator waits, found '
                              f'{run.size}; try rosette evaluate')
        expected = {run.run_id: Expected(analyse(run).error_motions, 'of rosette evaluate', run.repeatability is None)}
    if not expected:
        ended = '; '.join(f'run {state.run_id}: {state.text}' for state in log.states)
        raise InvalidData(f'{log.path}: expected a run that was evaluated, found none ({ended}); try rosette evaluate '
                          'on '
                          'what was measured')
    return expected


def replay(player: 'LogPlayer', options: argparse.Namespace, log: LogRun,
           expected: Mapping[str, Expected]) -> dict[str, ErrorMotionsMessage]:
    """Publish the log and return the error motions received, by run_id."""
    player.refuse_running_cell()
    screen = console(sys.stderr)
    with Progress(*Progress.get_default_columns(), console=screen, transient=True,
                  disable=not screen.is_terminal) as bar:
        player.play(bar.track(iter_log(options.log), total=log.messages, description='replay'), options.rate)
    found = player.evaluate(log, expected, RESULT_TIMEOUT)
    missing = [run_id for run_id in expected if run_id not in found]
    if missing:
        raise CellError(f'replay: expected the error motions of run {missing[0]} within {RESULT_TIMEOUT:g} s, found '
                        'none; '
                        'see the output of the evaluator')
    return found


def show(out: Console, run_id: str, published: PublishedMotions, expected: Expected) -> bool:
    """Print the curves received, of the result if these are compared; return whether they differ from the log."""
    got, wanted, which = published.judged, expected.result, published.which
    if got is None or wanted is None:
        got, wanted, which = published.modelled, expected.motions, Which.MODELLED
    out.print(f'[bold]{escape(run_id)}[/]')
    print_table(out, curves(got, which))
    what = difference(got, wanted, expected.with_u)
    parts = 'curves and uncertainties' if expected.with_u else 'curves'
    out.print(f'\n[red]{what} those {expected.source}[/]' if what else
              f'\n[green]{parts} equal to those {expected.source}, bit for bit[/]')
    return bool(what)


def difference(got: ErrorMotions, wanted: ErrorMotions, with_u: bool) -> str:
    """Return in words how the error motions received differ, with_u: or their u, empty: not by a bit."""
    if got.values.shape != wanted.values.shape or not np.array_equal(got.angle, wanted.angle):
        return 'other table angles than'
    if not np.array_equal(got.values, wanted.values):
        size = 1e6 * np.abs(got.values - wanted.values)
        return f'up to {size[:, :3].max():.2g} µm and {size[:, 3:].max():.2g} µrad off'
    if with_u and not np.array_equal(got.u, wanted.u):
        return 'other uncertainties than'
    return ''


class LogPlayer(GraphClient):
    """Publishes logged messages, byte for byte, and collects the error motions received.

    topics: of the log; domain: ROS domain, None for that of the environment; namespace: None for that of the log.
    Raises CellError where the log holds no ball centres.
    """

    def __init__(self, topics: Sequence[TopicSummary], domain: int | None = None, namespace: str | None = None) -> None:
        inputs = {_last(name) for name in INPUTS}
        chosen = {topic.name: topic for topic in topics if _last(topic.name) in inputs}
        answers = [name for name in chosen if _last(name) == names.BALL_CENTRE]
        if not answers:
            raise CellError(f'replay: expected a log with the topic {names.BALL_CENTRE}, found '
                            f'{", ".join(topic.name for topic in topics) or "no topics"}')
        library = TypeLibrary.from_environment(os.environ)
        for topic in chosen.values():
            if topic.hash not in ('', library.definition(topic.type_name).hash):
                raise CellError(f'replay: {topic.name}: was recorded with another version of {topic.type_name}, which '
                                'no node here can read; try rosette evaluate')
        self.namespace = answers[0].rpartition('/')[0] or '/' if namespace is None else f'/{namespace}'
        of_domain = () if namespace is None or names.remappings(self.namespace) else map(_last, names.OF_A_DOMAIN)
        places = {name: name if namespace is None else _last(name) for name in chosen}
        places |= {name: f'/{_last(name)}' for last in of_domain for name in chosen if _last(name) == last}
        super().__init__('player', domain, self.namespace, enable_rosout=False)
        self._publishers = {name: self._node.create_publisher(interface_class(topic.type_name), places[name],
                                                              qos_profile(topic.qos, topic.messages))
                            for name, topic in chosen.items()}
        self._runs = self._node.create_publisher(Run, names.RUN, qos.RESULT)
        state = self._node.resolve_topic_name(names.RUN_STATE)
        self._states = next((one for one in self._publishers.values() if one.topic_name == state), None) or (
            self._node.create_publisher(RunState, names.RUN_STATE, qos.STATE))
        self._topics = {publisher.topic_name for publisher in self._publishers.values()}
        self._motions: list[ErrorMotionsMessage] = []
        self._next_readings = self._node.create_client(NextReadings, names.NEXT_READINGS)
        self.decisions: list[tuple[int, bool]] = []  # last target before each, whether it is as in the log
        self._node.create_subscription(ErrorMotionsMessage, names.ERROR_MOTIONS, self._motions.append, 10)

    @property
    def remappings(self) -> tuple[tuple[str, str], ...]:
        """Pairs of names with which an evaluator reads the topics as they were recorded."""
        return () if names.TF_STATIC in self._topics else names.remappings(self.namespace)

    def refuse_running_cell(self) -> None:
        """Raise CellError where a CMM or a sequencer, searched during LIVE_PATIENCE, is on the graph."""
        topics = [self._node.resolve_topic_name(topic) for topic in (names.BALL_CENTRE, names.PROBE_TARGET)]
        if live := self._spin_until(lambda: [
                one for one in topics if self._node.count_publishers(one) > (one in self._topics)], LIVE_PATIENCE):
            raise CellError(f'replay: {live[0]} has another publisher: a live cell is on this graph, and '
                            'recorded targets would move its machine. End the cell, or choose another --domain')

    def await_evaluator(self, timeout: float) -> bool:
        """Return whether an evaluator receives runs and their states within `timeout`, s."""
        return bool(self._spin_until(lambda: self._runs.get_subscription_count()
                                     and self._states.get_subscription_count()
                                     and self._node.count_publishers(names.ERROR_MOTIONS) > 0, timeout))

    def play(self, messages: Iterable[LoggedMessage], rate: float | None = None) -> None:
        """Publish those logged messages whose topics are announced; rate: None as fast as FASTEST allows."""
        began, start = time.monotonic(), None
        chosen = (message for message in messages if message.topic in self._publishers)
        for count, message in enumerate(chosen):
            start = message.log_time if start is None else start
            if rate:
                due = began + 1e-9 * (message.log_time - start) / rate
                self._spin_until(lambda: False, due - time.monotonic())
            elif count % _BATCH == 0:
                self._spin_until(lambda: False, began + count / FASTEST - time.monotonic())
            self._publishers[message.topic].publish(message.data)

    def evaluate(self, log: LogRun, run_ids: Iterable[str], timeout: float) -> dict[str, ErrorMotionsMessage]:
        """Publish runs as their sequencer did, whose log may hold none, and return the error motions by run_id.

        timeout: for each, s."""
        frames = frames_of(log.path)
        is_asked = any(topic.messages and _is_next(topic.name) for topic in log.topics)
        for answers, request, response in decisions_of(log.path) if is_asked else ():
            if answers.run_id in run_ids and self._evaluate(answers, frames.get(answers.run_id, []), timeout):
                future = self._next_readings.call_async(request)
                self._spin_until(future.done, timeout)
                self.decisions.append((answers.targets[-1].seq, future.done() and future.result() == response))
        for run_id in run_ids:
            self._evaluate(log.runs[run_id], frames.get(run_id, []), timeout)
        return {one.run_id: one for one in self._motions}

    def _evaluate(self, answers: RunAnswers, frames: list[TransformStamped], timeout: float) -> bool:
        """Publish a run as far as it is, and return whether its error motions came within `timeout`, s."""
        run = run_message(answers, frames, self._node.get_clock().now().to_msg())
        run.process = f'{names.SEQUENCER} of a replay'
        self._runs.publish(run)
        self._states.publish(RunState(run_id=answers.run_id, phase=RunState.PHASE_EVALUATION, done=answers.answered,
                                      process=run.process))
        wanted = answers.readings_hash
        return bool(self._spin_until(lambda: any(one.readings_hash == wanted for one in self._motions), timeout))


def decisions_of(log: str | Path) -> Iterator[tuple[RunAnswers, NextReadings.Request, NextReadings.Response]]:
    """Yield each request for next readings in a log that was answered, with the readings until then."""
    answers, request = dict[str, RunAnswers](), None
    for message in iter_log(log):
        if message.type_name in (PROBE_TARGET, BALL_CENTRE):
            one = (target_of if message.type_name == PROBE_TARGET else answer_of)(
                decoded(message.data, interface_class(message.type_name)))
            known = answers.setdefault(one.run_id, RunAnswers(one.run_id))
            known.add_target(one) if isinstance(one, Target) else known.add_answer(one)
        elif _is_next(message.topic):
            event = decoded(message.data, NextReadings.Event)
            request = next(iter(event.request), request)
            if event.response and event.response[0].success and request is not None and request.run_id in answers:
                yield answers[request.run_id], request, event.response[0]


def frames_of(log: str | Path) -> dict[str, list[TransformStamped]]:
    """Return the transforms that were published after the first target of each run, by run_id."""
    found: dict[str, list[TransformStamped]] = {}
    for message in iter_log(log):
        if message.type_name == 'rosette_msgs/msg/ProbeTarget':
            found.setdefault(plain(decoded(message.data, ProbeTarget).run_id), [])
        elif message.channel.is_static_frames:
            for frames in found.values():
                frames += decoded(message.data, TFMessage).transforms
    return found


def _is_next(topic: str) -> bool:
    return topic.endswith(f'/{names.NEXT_READINGS}{names.SERVICE_EVENT}')


def _last(topic: str) -> str:
    return topic.rpartition('/')[2]


IMPLEMENTED = {'replay': (add_arguments, run)}
