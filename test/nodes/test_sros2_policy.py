# SPDX-License-Identifier: Apache-2.0
"""The SROS2 policy allows what the nodes of a running cell use, and nothing else."""

import re
import shlex
import subprocess
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from rclpy.context import Context
from rclpy.node import Node

from rosette_ros.cell.client import CellClient
from rosette_ros.cell.cmm_check import CmmClient
from rosette_ros.nodes import names
from rosette_ros.studio.cell_watcher import CellWatcher

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
POLICY = ROOT / 'config' / 'sros2' / 'policies.xml'
SAY, HEAR = 'say', 'hear'
ENCLAVES = {'sequencer': ('sequencer',), 'cmm': ('cmm',), 'evaluator': ('evaluator',), 'recorder': ('recorder',),
            'operator': ('client_*', 'studio_*', '_ros2cli_*'), 'check': ('check_*',),
            'watcher': ('studio_*', '_ros2cli_*')}
"""Enclave to the nodes that run in it; * stands for what is drawn at the start."""
BY_HAND = (names.START_CALIBRATION, names.CANCEL_CALIBRATION, names.DIAGNOSE, names.ADD_EFFECT, names.REMOVE_EFFECT,
           names.EVALUATE_JOINTLY, names.NEXT_READINGS, names.RECOVER)
EXTRAS = {
    'cmm': {*(pair for name in (names.RECOVER,) for pair in (
        (HEAR, f'rq/rosette/{name}Request'), (SAY, f'rr/rosette/{name}Reply')))},
    'operator': {pair for name in BY_HAND for pair in (
        (SAY, f'rq/rosette/{name}Request'), (HEAR, f'rr/rosette/{name}Reply'))},
    'check': {(SAY, f'rq/rosette/{names.RECOVER}Request'), (HEAR, f'rr/rosette/{names.RECOVER}Reply')},
    'watcher': {(HEAR, 'rt/rosette/model')},
}
"""What a person may do with the command line of ROS, and a CMM through I++ DME does; this test uses neither."""
COMMANDS = {'rt/tf_static': 'sequencer', 'rt/rosette/run_state': 'sequencer',
            'rt/rosette/calibration_event': 'sequencer', 'rt/rosette/ball_centre': 'cmm', 'rt/clock': 'cmm',
            'rt/rosette/error_motions': 'evaluator', 'rt/rosette/model': 'evaluator',
            'rt/rosette/diagnosis': 'evaluator', 'rq/rosette/recorder/start_recordingRequest': 'sequencer',
            'rq/rosette/recorder/stop_recordingRequest': 'sequencer',
            'rq/rosette/start_calibrationRequest': 'operator',
            'rq/rosette/cancel_calibrationRequest': 'operator'}
"""What moves a machine, makes a curve or opens a log, and who alone may say it."""


# What DDS is told, by the names that ROS gives to its topics: rt topic, rq request, rr reply


def topic(how, name):
    """Return the pair of a ROS topic; how: SAY or HEAR."""
    return {(how, f'rt{name}')}


def service(asks, name):
    """Return the pairs of one end of a service; asks: whether it is the client's."""
    request, reply = (SAY, HEAR) if asks else (HEAR, SAY)
    return {(request, f'rq{name}Request'), (reply, f'rr{name}Reply')}


def action(asks, name):
    """Return the pairs of one end of an action."""
    tells = HEAR if asks else SAY
    parts = [service(asks, f'{name}/_action/{part}') for part in ('send_goal', 'get_result', 'cancel_goal')]
    return set().union(*parts, *(topic(tells, f'{name}/_action/{part}') for part in ('feedback', 'status')))


RULES = {('topics', 'publish'): lambda name: topic(SAY, name), ('topics', 'subscribe'): lambda name: topic(HEAR, name),
         ('services', 'request'): lambda name: service(True, name),
         ('services', 'reply'): lambda name: service(False, name),
         ('actions', 'call'): lambda name: action(True, name), ('actions', 'execute'): lambda name: action(False, name)}
GRAPH = {'publisher': lambda name: topic(SAY, name), 'subscriber': lambda name: topic(HEAR, name),
         'client': lambda name: service(True, name), 'service': lambda name: service(False, name)}


def full_name(text, home, node):
    """Return the full name of a name in a profile."""
    if text.startswith('~/'):
        return f'{home}{node}{text[1:]}'
    return text if text.startswith('/') else f'{home}{text}'


def allowed_by(profile):
    """Return the pairs that a profile allows; everything that is not understood fails."""
    assert profile.tag == 'profile'
    assert sorted(profile.attrib) == ['node', 'ns']
    home, node, pairs = profile.get('ns').rstrip('/') + '/', profile.get('node'), set()
    for group in profile:
        assert set(group.attrib.values()) == {'ALLOW'}
        for how in group.attrib:
            for one in group:
                assert one.tag == group.tag.removesuffix('s')
                assert not one.attrib
                found = RULES[group.tag, how](full_name(one.text, home, node))
                assert not found & pairs, f'{node}: {how} {one.text} stands twice'
                pairs |= found
    return pairs


def read_policy(text):
    """Return the pairs that a policy allows, by the last part of the enclave's path, and its profiles."""
    root = ET.fromstring(text)
    assert (root.tag, root.attrib, [one.tag for one in root]) == ('policy', {'version': '0.2.0'}, ['enclaves'])
    allowed, profiles = {}, {}
    for enclave in root[0]:
        assert (enclave.tag, [one.tag for one in enclave]) == ('enclave', ['profiles'])
        home, _, name = enclave.get('path').rpartition('/')
        assert home in ('/rosette', '/cell2')
        allowed[name] = set().union(*map(allowed_by, enclave[0]))
        profiles[name] = tuple(profile.get('node') for profile in enclave[0])
    return allowed, profiles


@pytest.fixture(scope='module')
def policy():
    """Return what the policy allows, by enclave."""
    return read_policy(POLICY.read_bytes())[0]


# What the nodes use


class Witness:
    """Looks at the graph of a domain."""

    def __init__(self, domain):
        """Join with a node like those of the command line of ROS."""
        self.context = Context()
        self.context.init(domain_id=domain)
        self.node = Node('_ros2cli_1', context=self.context)

    def close(self):
        """Leave."""
        self.node.destroy_node()
        self.context.try_shutdown()

    def used(self):
        """Return the pairs that each node uses; what is drawn at the start is told as *."""
        found = {}
        for name, home in self.node.get_node_names_and_namespaces():
            pairs = set()
            for kind, pairs_of in GRAPH.items():
                for full, _ in getattr(self.node, f'get_{kind}_names_and_types_by_node')(name, home):
                    pairs |= pairs_of(_without_chance(full))
            found[_without_chance(name)] = pairs
        return found


def _without_chance(name):
    """Put * for the part of a name that is drawn at the start of a program."""
    return re.sub(r'\b(client_|check_|studio_|_ros2cli_)[0-9a-f]+', r'\1*', name)


@pytest.fixture(scope='module')
def used(policy, module_domain_id, make_cell, tmp_path_factory):
    """Return the pairs that each node of a running cell, a client, a check of the CMM, the studio and a tool use."""
    folder = tmp_path_factory.mktemp('policy')
    cell = make_cell(module_domain_id, folder)
    with cell, CellClient(module_domain_id) as client, CmmClient(module_domain_id) as checker:
        client.wait()
        checker.check(checker.settings({}))
        watch, witness = CellWatcher(module_domain_id), Witness(module_domain_id)
        try:
            return settled(witness.used, lambda found: not any(
                map(any, (differences(policy, found, enclave) for enclave in ENCLAVES))))
        finally:
            witness.close()
            watch.close()


def settled(look, is_whole, quiet=2.0, patience=60.0):
    """Return what is seen once it is whole and has not changed for `quiet` s, or when `patience`, s, is over."""
    seen, since, deadline = look(), time.monotonic(), time.monotonic() + patience
    while not (is_whole(seen) and time.monotonic() - since >= quiet) and time.monotonic() < deadline:
        time.sleep(0.1)
        now = look()
        if now != seen:
            seen, since = now, time.monotonic()
    return seen


def differences(policy, used, enclave):
    """Return what the nodes of an enclave use and may not, and what they may and neither use nor have as EXTRAS."""
    needed = set().union(*(used.get(node, ()) for node in ENCLAVES[enclave]))
    return needed - policy[enclave], (policy[enclave] - needed) ^ EXTRAS.get(enclave, set())


def described(pairs):
    """Return pairs as lines that can be read."""
    return sorted(f'{how} {name}' for how, name in pairs)


@pytest.mark.parametrize('enclave', ENCLAVES)
def test_what_is_used_is_allowed_and_nothing_else(policy, used, enclave):
    """Every publisher, subscription, service, client and action of every node."""
    not_allowed, not_used = differences(policy, used, enclave)
    assert (described(not_allowed), described(not_used)) == ([], []), 'used and not allowed; allowed and not used'


def test_each_enclave_has_the_nodes_that_run_in_it():
    """By their names, none left out."""
    assert read_policy(POLICY.read_bytes())[1] == ENCLAVES


def test_only_one_may_say_what_counts(policy):
    """Targets (and who tries a CMM), answers, frames, curves, requests to the recorder, calibrations."""
    assert [name for name in policy if (SAY, 'rt/rosette/probe_target') in policy[name]] == ['sequencer', 'check']
    for name, speaker in COMMANDS.items():
        assert [enclave for enclave in policy if (SAY, name) in policy[enclave]] == [speaker], name
    goal = 'rq/rosette/calibrate/_action/send_goalRequest'
    assert [enclave for enclave in policy if (SAY, goal) in policy[enclave]] == ['operator', 'check']


def test_who_looks_says_nothing_about_a_run(policy):
    """Only the log lines, the parameters and the parameter services of its own node."""
    said = {name for how, name in policy['watcher'] if how == SAY}
    assert [name for name in said if not re.match(r'rr/(rosette/studio|_ros2cli)_\*/\w+Reply$', name)] in (
        ['rt/rosout', 'rt/parameter_events'], ['rt/parameter_events', 'rt/rosout'])


def test_the_recorder_may_hear_whatever_may_be_said(policy):
    """It subscribes to every topic of the cell that it sees."""
    said = {name for pairs in policy.values() for how, name in pairs if how == SAY and name.startswith('rt/')}
    assert said <= {name for how, name in policy['recorder'] if how == HEAR}


def test_whoever_asks_is_heard(policy):
    """Requests and replies have two ends."""
    for pairs in policy.values():
        for how, name in pairs:
            if name.startswith('rq/') and how == SAY:
                assert [one for one in policy.values() if (HEAR, name) in one], name


def test_the_command_for_another_namespace_is_right(policy):
    """That of docs/security.md: every name moves into the namespace, frames and time included."""
    text = (ROOT / 'docs' / 'security.md').read_text(encoding='utf-8')
    [command] = re.findall(r'^(sed .*?) > \S+$', text, re.MULTILINE)
    done = subprocess.run(shlex.split(command), cwd=POLICY.parent, capture_output=True, check=True)
    moved, _ = read_policy(done.stdout)
    own = {f'rt{old}': f'rt/cell2/{new}' for old, new in names.remappings('cell2')}
    assert moved == {enclave: {(how, own.get(name, name.replace('/rosette/', '/cell2/', 1))) for how, name in pairs}
                     for enclave, pairs in policy.items()}


def test_nodes_start_in_their_enclaves(cell_of, domain_id):
    """The name is given to every node, also where security is off."""
    context = Context()
    context.init(domain_id=domain_id)
    node = Node('witness', context=context)
    try:
        with cell_of(nodes=('cmm',)):
            seen = settled(node.get_node_names_and_namespaces_with_enclaves,
                           lambda seen: any(name == 'cmm' for name, *_ in seen), quiet=0)
            assert ('cmm', '/rosette', '/rosette/cmm') in seen
    finally:
        node.destroy_node()
        context.try_shutdown()
