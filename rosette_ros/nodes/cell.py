# SPDX-License-Identifier: Apache-2.0
"""A whole cell on this computer: its nodes as processes, started, watched and ended together."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import yaml

from rosette_ros.core.errors import CellError, InvalidConfig
from rosette_ros.nodes import environment, names

MODULES = {
    names.RECORDER: 'rosette_ros.nodes.recorder',
    names.EVALUATOR: 'rosette_ros.nodes.evaluator',
    names.CMM: 'rosette_ros.nodes.simulated_cmm',
    names.SEQUENCER: 'rosette_ros.nodes.sequencer',
}
"""The nodes in the order of starting: who listens comes first."""

START_TIMEOUT = 60.0
MOST_DEATHS, DEATHS_WITHIN = 5, 60.0
"""A node that dies so often within so many seconds is not started again."""
_STEPS = ((signal.SIGINT, 15.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0))
"""How a node is ended: the signal, and how long it has for it, s."""
_ESCALATION = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL).index
_POLL = 0.02


@dataclass(eq=False)
class _Process:
    """A node's process and where its output goes, behind that of earlier ones from byte `begin` on."""

    name: str
    popen: subprocess.Popen
    output: Path
    begin: int

    def text(self):
        with open(self.output, 'rb') as stream:
            stream.seek(self.begin)
            return stream.read().decode('utf-8', errors='replace')

    def end(self, number):
        """Send the signal; one that is still loading its modules has nothing to end in order."""
        is_ready = names.READY in self.text()
        self.popen.send_signal(number if is_ready else max(number, signal.SIGTERM, key=_ESCALATION))

    @property
    def is_dead(self):
        return self.popen.poll() is not None

    def obituary(self):
        lines = [line for line in self.text().strip().splitlines() if not line.startswith('[INFO]')]
        last = f': {lines[-1]}' if lines else ''
        return f'node {self.name} ended with exit code {self.popen.returncode}{last}'


class Cell:
    """The nodes of one cell as processes; a context manager.

    domain_id: ROS domain, None for that of the environment; namespace: of the cell; machine: path
    of a machine.yaml for the simulated machine, None for the installed one; params: parameter
    values per node ({'sequencer': {'order': 'row', 'plate.balls': 6}}) over those of
    `params_file` (None: defaults); log_dir: where runs go; nodes: which to start; output_dir: where
    the nodes' own output goes, None for a temporary folder that is removed at a clean end; remappings:
    pairs of names, None for frames and time of its own in every namespace but the default.

    Raises CellError where a node does not start, in the node's own words.
    """

    def __init__(self, domain_id=None, namespace=names.NAMESPACE, *, machine=None, params=None,
                 params_file=None, log_dir='runs', nodes=tuple(MODULES), output_dir=None,
                 simulated_time=True, remappings=None):
        """Prepare; nothing is started before `start`."""
        unknown = set(nodes) - set(MODULES)
        if unknown:
            raise InvalidConfig(f'cell: nodes: wanted some of {", ".join(MODULES)}, '
                                f'got {sorted(unknown)[0]!r}')
        self.domain_id, self.namespace = domain_id, namespace.strip('/')
        self._remappings = names.remappings(namespace) if remappings is None else remappings
        self.log_dir = Path(log_dir).absolute()
        self.machine = None if machine is None else Path(machine)
        self._nodes = [name for name in MODULES if name in nodes]
        self._params_file = params_file
        self._params = {name: dict((params or {}).get(name, {})) for name in self._nodes}
        self._set(names.RECORDER, 'log_dir', str(self.log_dir))
        if machine is not None:
            self._set(names.CMM, 'machine', str(machine))
        for name in (names.SEQUENCER, names.EVALUATOR, names.RECORDER):
            self._set(name, 'use_sim_time', simulated_time)
        self._own_output = output_dir is None
        self._output_dir = output_dir
        self._processes = {}
        self._deaths = {}

    def __enter__(self):
        """Start the cell."""
        self.start()
        return self

    def __exit__(self, *_):
        """End the cell."""
        self.stop()

    def start(self):
        """Start all nodes and wait until the cell is complete."""
        folder = self._output_dir or tempfile.mkdtemp(prefix='rosette_cell_')
        self.output_dir = Path(folder)
        self.output_dir.mkdir(parents=True, exist_ok=True)
        try:
            for name in self._nodes:
                self.start_node(name, wait=False)
            self._await_output(dict.fromkeys(self._nodes, f'{names.READY}\n'))
            if set(self._nodes) == set(MODULES):
                self._await_output({names.SEQUENCER: names.COMPLETE})
        except BaseException:
            self.stop()
            raise

    def start_node(self, name, wait=True):
        """Start one node (again)."""
        if name in self._processes and not self._processes[name].is_dead:
            raise CellError(f'cell: node {name} runs already')
        output = self.output_dir / f'{name}.log'
        with open(output, 'ab') as stream:
            begin = stream.tell()
            popen = subprocess.Popen(
                self._command(name), stdin=subprocess.DEVNULL, stdout=stream,
                stderr=subprocess.STDOUT, start_new_session=True,
                env={**cell_environment(self.domain_id), names.PARENT_PID: str(os.getpid())})
        self._processes[name] = _Process(name, popen, output, begin)
        if wait:
            self._await_output({name: f'{names.READY}\n'})

    def stop(self):
        """End all nodes, the sequencer first; return node name to exit code."""
        for number, patience in _STEPS:
            for process in reversed(self._processes.values()):
                if not process.is_dead:
                    process.end(number)
            if self._await_end(patience):
                break
        codes = {name: process.popen.returncode for name, process in self._processes.items()}
        if self._own_output and not any(codes.values()):
            self._remove_output()
        return codes

    def signal_node(self, name, number):
        """Send a signal to one node."""
        self._processes[name].popen.send_signal(number)

    def pid(self, name):
        """Return the process id of one node."""
        return self._processes[name].popen.pid

    def wait_node(self, name, timeout=15.0):
        """Wait until one node has ended and return its exit code."""
        return self._processes[name].popen.wait(timeout)

    def check(self):
        """Raise CellError where a node has died, in its last words."""
        for process in self._processes.values():
            if process.is_dead:
                raise CellError(f'cell: {process.obituary()}')

    def revive(self):
        """Start again every node that has died; return its last words by name.

        Raises CellError where a node has died MOST_DEATHS times within DEATHS_WITHIN seconds: what
        kills it then would only kill it again.
        """
        now = time.monotonic()
        words = {}
        for name in self._nodes:
            process = self._processes[name]
            if not process.is_dead:
                continue
            deaths = self._deaths.setdefault(name, [])
            deaths[:] = [when for when in deaths if now - when < DEATHS_WITHIN] + [now]
            words[name] = process.obituary()
            if len(deaths) >= MOST_DEATHS:
                raise CellError(f'cell: {words[name]}; it died {len(deaths)} times within '
                                f'{DEATHS_WITHIN:g} s and is not started again')
            self.start_node(name, wait=False)
        return words

    def output(self, name):
        """Return what a node has printed, over all its lives."""
        return self._processes[name].output.read_text(encoding='utf-8', errors='replace')

    def _command(self, name):
        params = self.output_dir / f'{name}.yaml'
        text = yaml.safe_dump({'/**': {'ros__parameters': self._params[name]}})
        params.write_text(text, encoding='utf-8')
        command = [sys.executable, '-m', MODULES[name], '--ros-args', '-r', f'__ns:=/{self.namespace}',
                   *names.remap_arguments(self._remappings), '--enclave', names.enclave(self.namespace, name)]
        if self._params_file is not None:
            command += ['--params-file', str(self._params_file)]
        return [*command, '--params-file', str(params)]

    def _set(self, name, parameter, value):
        if name in self._params:
            self._params[name].setdefault(parameter, value)

    def _await_output(self, wanted):
        """Wait until each node has printed its words; wanted: node name to words."""
        deadline = time.monotonic() + START_TIMEOUT
        missing = dict(wanted)
        while missing:
            missing = {name: words for name, words in missing.items()
                       if words not in self._processes[name].text()}
            self.check()
            if time.monotonic() > deadline:
                name, words = next(iter(missing.items()))
                raise CellError(f'cell: wanted "{words.strip()}" from node {name} within '
                                f'{START_TIMEOUT:g} s, got: {self._processes[name].text()[-500:]}')
            time.sleep(_POLL)

    def _await_end(self, patience):
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline:
            if all(process.is_dead for process in self._processes.values()):
                return True
            time.sleep(_POLL)
        return False

    def _remove_output(self):
        for path in self.output_dir.iterdir():
            path.unlink()
        self.output_dir.rmdir()


def cell_environment(domain_id=None):
    """Return the environment for processes of a cell that stays on this computer."""
    made = {**os.environ, **environment.added(os.environ)}
    made['PYTHONUNBUFFERED'] = '1'
    if domain_id is not None:
        made['ROS_DOMAIN_ID'] = str(domain_id)
    return made
