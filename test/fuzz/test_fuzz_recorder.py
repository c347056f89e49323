# SPDX-License-Identifier: Apache-2.0
"""Every request to the recorder, and any bytes where it hears messages."""

import contextlib
import math
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from made_up import bounded, mutated, tried
from made_up_log import LIBRARY, RUN_ID, TOPICS, TYPES, write_log
from made_up_messages import TEXTS, messages
from mute import FIELDS, Mute, check_words, defaults
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from rosette_msgs.msg import BallCentre, ProbeTarget, RunState, Touches
from rosette_msgs.srv import Recall, Recorded, StartRecording, StopRecording
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.nodes.interfaces import decoded, interface_class
from rosette_ros.nodes.log_session import LogSession, Retention, RunContents
from rosette_ros.nodes.recorder import WANTED as RECORDER_WANTED
from rosette_ros.nodes.recorder import Recorder

pytestmark = pytest.mark.long

# The recorder -------------------------------------------------------------------------------------


KINDS = {'/probe_target': ProbeTarget, '/ball_centre': BallCentre, '/touches': Touches, '/run_state': RunState,
         '/tf_static': TFMessage}


class MuteRecorder(Mute, Recorder):
    """A recorder without a graph."""

    def __init__(self, log_dir):
        """Keep logs in a folder."""
        session = LogSession(2.0, lambda topic: [], dict)
        for topic, kind in TOPICS.items():
            session.add_topic(
                f'/{topic}', LIBRARY.definition(TYPES.get(topic) or f'rosette_msgs/msg/{kind.__name__}'), Retention.NONE
            )
        for topic, type_name in OTHERS.items():
            session.add_topic(topic, LIBRARY.definition(type_name), Retention.NONE)
        Mute.__init__(
            self,
            parameters=defaults(RECORDER_WANTED, log_dir=str(log_dir)),
            _library=LIBRARY,
            _session=session,
            _contents=RunContents('', list),
            _ending=None,
            _told=('', 0),
            _over_since=math.inf,
            _filled=set(),
            _requested=('', 0.0),
            get_namespace=lambda: '/rosette',
            _clock_topic='/clock',
            _rosout_topic='/rosout',
            _kinds=KINDS | {topic: interface_class(type_name) for topic, type_name in OTHERS.items()},
            _processes={},
            _is_simulated=True,
            _said={},
            _simulated_now=0,
            _last='',
        )


OTHERS = {
    '/clock': 'rosgraph_msgs/msg/Clock',
    '/rosout': 'rcl_interfaces/msg/Log',
}


def kept(folder):
    """Return all files below a folder with their bytes."""
    return {path: path.read_bytes() for path in Path(folder).rglob('*') if path.is_file()}


@pytest.fixture(scope='module')
def log_dir(tmp_path_factory):
    """Return a folder of logs: a run with a second part, a damaged one, one that is empty, a file."""
    folder = tmp_path_factory.mktemp('cell') / 'runs'
    write_log(folder / RUN_ID)
    write_log(folder / 'run_part2', flush_interval=1e9)
    path = write_log(folder / 'cut') / 'log_0.mcap'
    path.write_bytes(path.read_bytes()[:-9000])
    (folder / 'empty').mkdir()
    (folder / 'file').write_text('x')
    write_log(folder.parent / 'outside')
    return folder


LOG_NAMES = st.one_of(
    st.sampled_from(
        [
            RUN_ID, 'run_part2', 'cut', 'empty', 'file', '../outside', './run', 'new', 'new_2', 'RUN', 'run/',
            'run/.', 'empty/..',
        ]
    ),
    TEXTS,
)
REQUESTS = st.lists(
    st.one_of(
        messages(StartRecording.Request, run_id=LOG_NAMES, resumes=st.one_of(st.just(''), LOG_NAMES)),
        messages(StopRecording.Request, run_id=LOG_NAMES),
        messages(Recall.Request, run=LOG_NAMES),
        messages(Recorded.Request, run_id=LOG_NAMES),
    ),
    min_size=1,
    max_size=4,
)


@tried(0.12)
@given(REQUESTS)
def test_what_the_recorder_is_asked(log_dir, requests):
    """No log is written over or outside the folder, and every answer says yes or why not in one line."""
    node, before = MuteRecorder(log_dir), kept(log_dir.parent)
    callbacks = {
        StartRecording.Request: (node._on_start, StartRecording),
        Recall.Request: (node._on_recall, Recall),
        StopRecording.Request: (node._on_stop, StopRecording),
        Recorded.Request: (node._on_recorded, Recorded),
    }
    try:
        with bounded():
            for request in requests:
                on, kind = callbacks[type(request)]
                was_open = node._session.is_open
                response = on(request, kind.Response())
                serialize_message(response) if hasattr(response, 'get_fields_and_field_types') else None
                check_words([*node.words, response.message])
                assert response.success or response.message
                if kind is StartRecording:
                    assert response.success or node._session.is_open == was_open
                if kind is Recall and response.success:
                    assert (log_dir / response.log).is_dir()
    finally:
        if node._session.is_open:
            node._session.close()
        after = kept(log_dir.parent)
        for path in set(after) - set(before):
            assert path.parent.parent == log_dir
            shutil.rmtree(path.parent, ignore_errors=True)
    assert {path: after.get(path) for path in before} == before


SENT = {
    '/ball_centre': BallCentre, '/run_state': RunState, '/clock': Clock, '/rosout': Log, '/tf_static': TFMessage,
    '/probe_target': ProbeTarget,
}


@st.composite
def sent_bytes(draw):
    """Return (topic, bytes): a message as on the wire, or bytes that were one."""
    topic = draw(st.sampled_from([*SENT, *(topic for topic in OTHERS if topic not in SENT)]))
    kind = SENT.get(topic) or interface_class(OTHERS[topic])
    fields = {name: strategy for name, strategy in FIELDS.items() if name in ('run_id', 'seq')}
    data = serialize_message(draw(messages(kind, lists=1, **fields)))
    return topic, draw(st.one_of(st.just(data), mutated(data), st.binary(max_size=12)))


def is_of_another_run(data):
    """Return whether bytes are a target of another run."""
    with contextlib.suppress(InvalidData):
        return decoded(data, ProbeTarget).run_id != RUN_ID
    return False


@tried(0.08)
@given(st.lists(sent_bytes(), min_size=1, max_size=6))
@example([('/probe_target', b'\0\1\0\0')])
def test_bytes_that_the_recorder_hears(tmp_path_factory, said):
    """Bytes of another version of a message, or none: they are recorded, and told; but for targets of other runs."""
    node = MuteRecorder(tmp_path_factory.getbasetemp() / 'heard')
    written = []
    node._session = SimpleNamespace(
        take=lambda message: not written.append(message), is_open=True, run_id=RUN_ID, close=lambda: None, failure='',
        messages=0,
    )
    node._close = lambda: ''
    with bounded():
        for topic, data in said:
            node._receive(topic, data)
    check_words(node.words)
    assert len(written) + len(node.words) >= sum(
        topic != '/rosout' and not (topic == '/probe_target' and is_of_another_run(data)) for topic, data in said)
