# SPDX-License-Identifier: Apache-2.0
"""A whole cell on this computer: its nodes as processes, started, supervised and ended together."""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rosette_ros.cell.ending import ENDING
from rosette_ros.core.run.errors import CellError, InvalidConfig
from rosette_ros.io.safe_yaml import read_yaml
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.environment import check_environment

MODULES = {names.RECORDER: 'rosette_ros.nodes.recorder', names.EVALUATOR: 'rosette_ros.nodes.evaluator',
           names.CMM: 'rosette_ros.nodes.simulated_cmm', names.SEQUENCER: 'rosette_ros.nodes.sequencer'}
"""The nodes in the order of starting: subscribers come first."""
DME_CMM = 'rosette_ros.nodes.dme_cmm'
"""The node that takes the place of the simulated CMM where one with an I++ DME server is there."""

START_TIMEOUT = 60.0
MOST_PARAMETERS = 1 << 20  # longest parameter file, bytes
CHECK_PERIOD = 0.2  # a failed node is restarted within this time, s, unless the cell ends meanwhile
MOST_FAILURES, FAILURES_WITHIN = 5, 60.0  # a node that fails so often within so many seconds is not restarted
_STEPS = ((signal.SIGINT, 15.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0))  # how a node is ended: signal, s for it
_ESCALATION = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL).index
_POLL = 0.02
LOG_FORMAT = {'RCUTILS_CONSOLE_OUTPUT_FORMAT': '[{severity}] [{time}] [{name}]: {message}',
              'RCUTILS_COLORIZED_OUTPUT': '0', 'RCUTILS_LOGGING_BUFFERED_STREAM': '0'}
"""How the nodes of a cell log, whatever the environment wants: it is read here."""
LOG_LINE = re.compile(r'\[(\w+)\] \[[\d.]+\] \[[^]]*\]: (.*)')
"""A line of a node's log: level and words."""

RANGE, PEERS, RMW = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'RMW_IMPLEMENTATION'
TRANSPORTS, PROFILES = 'FASTDDS_BUILTIN_TRANSPORTS', 'FASTRTPS_DEFAULT_PROFILES_FILE'
FAST_DDS = ('', 'rmw_fastrtps_cpp', 'rmw_fastrtps_dynamic_cpp')
DEFINITIONS = Path(__file__).parents[2] / 'msg_defs'
"""The definitions in the source tree; an installed package has none beside it."""
LOCAL, WIDE = 'LOCALHOST', ('SUBNET', 'SYSTEM_DEFAULT')


@dataclass(eq=False)
class NodeProcess:
    """A node's process; its output is appended to a file, from byte `begin` on."""

    name: str
    popen: subprocess.Popen[bytes]
    output: Path
    begin: int
    told: int = 0
    hung: bool = False

    def text(self) -> str:
        with open(self.output, 'rb') as stream:
            stream.seek(self.begin)
            return stream.read().decode('utf-8', errors='replace')

    def news(self) -> list[tuple[str | Any, ...]]:
        """Return the whole lines of the log that have come since the last call, as (level, words)."""
        with open(self.output, 'rb') as stream:
            stream.seek(max(self.begin, self.told))
            lines = stream.read().rpartition(b'\n')[0]
        self.told = max(self.begin, self.told) + len(lines) + bool(lines)
        return [found.groups() for found in map(LOG_LINE.match, lines.decode('utf-8', 'replace').splitlines()) if found]

    def end(self, number: signal.Signals) -> None:
        """Send the signal; one that is still loading its modules has nothing to end in order."""
        is_ready = names.READY in self.text()
        self.popen.send_signal(number if is_ready else max(number, signal.SIGTERM, key=_ESCALATION))

    def kill_hanging(self) -> None:
        """End one that publishes no status, and so takes no other signal."""
        self.hung = True
        self.popen.send_signal(signal.SIGKILL)
        _wait(lambda: self.has_ended, _STEPS[-1][1])

    @property
    def has_ended(self) -> bool:
        return self.popen.poll() is not None

    def failure(self) -> str:
        """Return the exit code, or the signal, and the last line of the output that is an error.

        One that was ended by a signal has said before what it logged as an error: that is not the reason."""
        code = self.popen.returncode
        logged = '[INFO]', '[WARN]', *(['[ERROR]'] if code < 0 else [])
        lines = [line for line in self.text().strip().splitlines() if not line.startswith(logged)]
        how = f'was ended by {signal.Signals(-code).name}' if code < 0 else f'ended with exit code {code}'
        if self.hung:
            return (f'node {self.name} was running (process {self.popen.pid}) but published no status for '
                    f'{qos.STATUS_HANGS:g} s and {how}')
        return f'node {self.name} {how}{"".join(f": {x}" for x in lines[-1:])}'


class Cell:
    """The nodes of one cell as processes; a context manager.

    domain_id: ROS domain, None for that of the environment; namespace: of the cell; machine: path of a machine.yaml for
    the simulated machine, None for the installed one; dme: path of the settings file of a CMM with an I++ DME server,
    which then takes the place of the simulated one; params: parameter values per node ({'sequencer': {'order': 'row',
    'plate.balls': 6}}), in preference to those of `params_file`; log_dir: for the logs of runs; nodes: which to start;
    output_dir: for the output of the nodes, None for a temporary folder that is removed at a clean end; remappings:
    pairs of names, None for frames and time of its own in every namespace but the default.

    Raises CellError where a node does not start, in the node's own words."""

    process_of = subprocess.Popen
    """What starts a node's process."""

    def __init__(self, domain_id: int | None = None, namespace: str = names.NAMESPACE, *,
                 machine: str | Path | None = None, params: Mapping[str, Mapping[str, Any]] | None = None,
                 params_file: str | Path | None = None, log_dir: str | Path = 'runs',
                 nodes: Collection[str] = tuple(MODULES), output_dir: str | Path | None = None,
                 simulated_time: bool = True, remappings: Sequence[tuple[str, str]] | None = None,
                 dme: str | Path | None = None) -> None:
        """Prepare; nothing is started before `start`."""
        if unknown := set(nodes) - {*MODULES}:
            raise InvalidConfig(f'cell: nodes: expected some of {", ".join(MODULES)}, found {min(unknown)!r}')
        self.domain_id, self.namespace = domain_id, namespace.strip('/')
        self._remappings = names.remappings(namespace) if remappings is None else remappings
        self.log_dir = Path(log_dir).absolute()
        self.machine = None if machine is None else Path(machine)
        self.nodes = [name for name in MODULES if name in nodes]
        self._params_file = params_file
        self._modules = {**MODULES, **({} if dme is None else {names.CMM: DME_CMM})}
        is_simulated = simulated_time and dme is None
        defaults: dict[str, dict[str, Any]] = {name: {'use_sim_time': is_simulated} for name in MODULES}
        defaults[names.RECORDER]['log_dir'] = str(self.log_dir)
        if dme is not None:
            defaults[names.CMM]['settings'] = str(Path(dme).absolute())
        else:
            defaults[names.CMM] = {} if machine is None else {'machine': str(machine)}
        self._params = {name: {**defaults[name], **(params or {}).get(name, {})} for name in self.nodes}
        self._output_dir = output_dir
        self.processes: dict[str, NodeProcess] = {}
        self._failures: dict[str, list[float]] = {}

    def __enter__(self) -> 'Cell':
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start all nodes and wait until the cell is complete."""
        check_messages()
        check_environment(self.domain_id)
        self.output_dir = Path(self._output_dir or tempfile.mkdtemp(prefix='rosette_cell_'))
        self.output_dir.mkdir(parents=True, exist_ok=True)
        try:
            for name in self.nodes:
                self.start_node(name, wait=False)
            self._await_output(dict.fromkeys(self.nodes, f'{names.READY}\n'))
            if set(self.nodes) >= set(MODULES):
                self._await_output({names.SEQUENCER: names.COMPLETE})
        except BaseException:
            self.stop()
            raise

    def start_node(self, name: str, wait: bool = True) -> None:
        """Start one node that is not running."""
        if name in self.processes and not self.processes[name].has_ended:
            raise CellError(f'cell: node {name} is running already')
        output = self.output_dir / f'{name}.log'
        with open(output, 'ab') as stream:
            begin = stream.tell()
            popen = self.process_of(
                self._command(name), stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT,
                start_new_session=True, env={**cell_environment(self.domain_id), names.PARENT_PID: str(os.getpid())})
        self.processes[name] = NodeProcess(name, popen, output, begin)
        if wait:
            self._await_output({name: f'{names.READY}\n'})

    def news(self) -> list[str]:
        """Return what is new for a person: all that the sequencer says, what the other nodes warn of."""
        return [f'{name}: {words}' for name, process in self.processes.items() for level, words in process.news()
                if words != names.READY and (name == names.SEQUENCER or level != 'INFO')]

    def stop(self) -> dict[str, int | None]:
        """End all nodes, the sequencer first; return the exit codes by node.

        None is left behind, not even one that hangs or is suspended, nor where this is interrupted."""
        with ENDING:
            try:
                for number, patience in _STEPS:
                    for process in reversed(self.processes.values()):
                        if not process.has_ended:
                            process.end(number)
                    if _wait(lambda: all(process.has_ended for process in self.processes.values()), patience):
                        break
            finally:
                for process in self.processes.values():
                    if not process.has_ended:
                        process.popen.kill()
        codes = {name: process.popen.returncode for name, process in self.processes.items()}
        if self._output_dir is None and not any(codes.values()):
            shutil.rmtree(self.output_dir)
        return codes

    def check(self) -> None:
        """Raise CellError where a node has ended, in its last words."""
        for process in self.processes.values():
            if process.has_ended:
                raise CellError(f'cell: {process.failure()}')

    def restart_failed(self, hanging: Collection[str] = ()) -> dict[str, str]:
        """Restart every node that has ended; return its last words by node; hanging: nodes to be ended before.

        Raises CellError where a node has failed MOST_FAILURES times within FAILURES_WITHIN seconds: whatever ends it
        would only end it again."""
        for name in hanging:
            self.processes[name].kill_hanging()
        now, words = time.monotonic(), {}
        for name in self.nodes:
            if not self.processes[name].has_ended:
                continue
            recent = [when for when in self._failures.get(name, ()) if now - when < FAILURES_WITHIN]
            self._failures[name] = [*recent, now]
            words[name] = self.processes[name].failure()
            if len(recent) + 1 >= MOST_FAILURES:
                raise CellError(f'cell: {words[name]}; it failed {len(recent) + 1} times within {FAILURES_WITHIN:g} s '
                                'and is not restarted')
            self.start_node(name, wait=False)
        return words

    def _command(self, name: str) -> list[str]:
        params = self.output_dir / f'{name}.yaml'
        params.write_text(yaml.safe_dump({'/**': {'ros__parameters': self._params[name]}}), encoding='utf-8')
        files = [str(path) for path in (self._given_params(), params) if path is not None]
        return [sys.executable, '-m', self._modules[name], '--ros-args', '-r', f'__ns:=/{self.namespace}',
                *names.remap_arguments(self._remappings), '--enclave', names.enclave(self.namespace, name),
                *(part for path in files for part in ('--params-file', path))]

    def _given_params(self) -> str | Path | None:
        """Return the parameter file that was given, or a copy where ROS does not take its lists: [0.35, 0.26, 0]."""
        if self._params_file is None:
            return None
        given = read_yaml(self._params_file, 'a parameter file', MOST_PARAMETERS, InvalidConfig)
        if repr(given) == repr(yaml.safe_load(Path(self._params_file).read_text(encoding='utf-8'))):
            return self._params_file
        copy = self.output_dir / 'given.yaml'
        copy.write_text(yaml.safe_dump(given), encoding='utf-8')
        return copy

    def _await_output(self, wanted: Mapping[str, str]) -> None:

        def missing() -> list[str]:
            self.check()
            return [name for name, words in wanted.items() if words not in self.processes[name].text()]

        if not _wait(lambda: not missing(), START_TIMEOUT):
            name = missing()[0]
            raise CellError(f'cell: expected "{wanted[name].strip()}" from node {name} within {START_TIMEOUT:g} s, '
                            'found: '
                            f'{self.processes[name].text()[-500:]}')


def _wait(condition: Callable[[], bool], timeout: float) -> bool:
    """Wait until a condition holds, at most for `timeout` s; return whether it does."""
    deadline = time.monotonic() + timeout
    while not (holds := condition()) and time.monotonic() < deadline:
        time.sleep(_POLL)
    return holds


def added_environment(given: Mapping[str, str]) -> dict[str, str]:
    """Return what a process of a cell needs beyond its environment `given`, which stays as it is.

    It stays on this computer and does not use shared memory: a killed process leaves ports of its shared memory behind,
    by which its successor may receive nothing (Fast-DDS issue 5053). FASTDDS_BUILTIN_TRANSPORTS alone does not prevent
    that for a participant that stays on its computer: rmw_fastrtps then chooses the transports itself. So a profile
    gives these processes no other address than one of UDP, by which no other computer can reach them."""
    made = {} if given.get(RANGE) else {RANGE: LOCAL}
    if TRANSPORTS not in given:
        made[TRANSPORTS] = 'UDPv4'
    stays = (given.get(RANGE) or LOCAL) not in WIDE and not given.get(PEERS)
    if stays and given.get(RMW, '') in FAST_DDS and PROFILES not in given:
        made[PROFILES] = str(Path(__file__).with_name('fastdds.xml'))
    return made


def cell_environment(domain_id: int | None = None) -> dict[str, str]:
    """Return the environment for processes of a cell that stays on this computer."""
    domain = {} if domain_id is None else {'ROS_DOMAIN_ID': str(domain_id)}
    return {**os.environ, **added_environment(os.environ), **LOG_FORMAT, 'PYTHONUNBUFFERED': '1', **domain}


def check_messages(definitions: Path = DEFINITIONS, environ: Mapping[str, str] = os.environ) -> None:
    """Raise CellError where rosette_msgs was built from other definitions than those of the source tree.

    definitions: folder with msg, srv and action; environ: mapping with AMENT_PREFIX_PATH, of which the first prefix
    with rosette_msgs counts. Nothing is checked where one of both is not there."""
    prefixes = (Path(prefix) for prefix in environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix)
    built = next((share for prefix in prefixes if (share := prefix / 'share' / 'rosette_msgs').is_dir()), None)
    if built is None:
        return
    for path in sorted(definitions.glob('*/*.*')):
        copy = built / path.relative_to(definitions)
        if not copy.exists() or copy.read_bytes() != path.read_bytes():
            raise CellError(f'messages: expected rosette_msgs as {definitions} defines it, found a build in {built} in '
                            f'which {path.name} {"differs" if copy.exists() else "is missing"}: run make setup (in a '
                            'workspace: colcon build)')
