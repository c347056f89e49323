# SPDX-License-Identifier: Apache-2.0
"""What a cell adds to the environment of its processes, and what comes of it."""

import os
import re
import socket
import struct
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from xml.etree import ElementTree

import pytest

from rosette_ros.cell import supervisor
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import LOCAL, MODULES, PROFILES, RANGE, TRANSPORTS, added_environment
from rosette_ros.core.run.errors import CellError
from rosette_ros.nodes.environment import check_environment
from rosette_ros.nodes.recorder import LAST_MESSAGES

PROFILE = Path(supervisor.__file__).with_name('fastdds.xml')
LOG = Path(__file__).parents[1] / 'golden' / 'logs' / 'log_clean_n6_diagonal'


@pytest.mark.parametrize(('given', 'wanted'), [
    ({}, {RANGE: LOCAL, TRANSPORTS: 'UDPv4', PROFILES: str(PROFILE)}),
    ({RANGE: LOCAL, 'RMW_IMPLEMENTATION': 'rmw_fastrtps_cpp'}, {TRANSPORTS: 'UDPv4', PROFILES: str(PROFILE)}),
    ({RANGE: ''}, {RANGE: LOCAL, TRANSPORTS: 'UDPv4', PROFILES: str(PROFILE)}),
    ({RANGE: 'localhost'}, {TRANSPORTS: 'UDPv4', PROFILES: str(PROFILE)}),  # rcl warns and stays here
    ({RANGE: 'SUBNET'}, {TRANSPORTS: 'UDPv4'}),
    ({RANGE: 'SYSTEM_DEFAULT'}, {TRANSPORTS: 'UDPv4'}),
    ({'ROS_STATIC_PEERS': '192.0.2.7'}, {RANGE: LOCAL, TRANSPORTS: 'UDPv4'}),
    ({PROFILES: '/own.xml', TRANSPORTS: 'SHM'}, {RANGE: LOCAL}),
    ({'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}, {RANGE: LOCAL, TRANSPORTS: 'UDPv4'}),
])
def test_what_is_given_stays(given, wanted):
    """Only who stays on this computer gets the profile that nobody elsewhere could reach; twice changes nothing."""
    before = dict(given)
    assert added_environment(given) == wanted
    assert given == before
    assert added_environment({**given, **wanted}) == {}


def test_the_profile_offers_the_loopback_address_alone():
    """The one that counts where no profile is named."""
    space = {'f': 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles'}
    root = ElementTree.parse(PROFILE).getroot()
    assert [one.get('is_default_profile') for one in root.iterfind('.//f:participant', space)] == ['true']
    assert {one.text for one in root.iterfind('.//f:address', space)} == {'127.0.0.1'}


def test_what_is_lost_is_repeated_before_it_is_missed():
    """The heartbeat period of writers, with a third as long again for the repetition, against what waits for a log."""
    space = {'f': 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles'}
    found = ElementTree.parse(PROFILE).getroot().find('.//f:data_writer/f:times/f:heartbeatPeriod', space)
    here = int(found.find('f:sec', space).text) + 1e-9 * int(found.find('f:nanosec', space).text)
    for period in (here, 3.0):  # and by default
        assert 4 / 3 * period <= LAST_MESSAGES


def test_the_nodes_of_a_cell_listen_on_loopback_alone(cell_of, domain_id, monkeypatch):
    """The ports of DDS, by which others are heard, are on no address of the network, and none is in shared memory.

    By the kernel's table of sockets, and by the threads, which Fast DDS names after what they listen to; rmw_fastrtps
    adds shared memory where it can.
    """
    first = 7400 + 250 * domain_id

    def addresses(processes):
        links = {os.readlink(path) for process in processes for path in (process / 'fd').iterdir()}
        found = set()
        for line in Path('/proc/net/udp').read_text().splitlines()[1:]:
            fields = line.split()
            host, port = (int(part, 16) for part in fields[1].split(':'))
            if f'socket:[{fields[9]}]' in links and first <= port < first + 250:
                found.add(socket.inet_ntoa(struct.pack('=I', host)))
        return found

    def threads(processes):
        names = {path.read_text().strip() for process in processes for path in process.glob('task/*/comm')}
        return {match[1] for name in names if (match := re.fullmatch(r'dds\.(shm|udp)\.\d+', name))}

    def heard():
        with cell_of(3) as cell:
            processes = [Path('/proc', str(cell.processes[node].popen.pid)) for node in MODULES]
            return addresses(processes), threads(processes)

    assert heard() == ({'127.0.0.1'}, {'udp'})
    monkeypatch.setenv(PROFILES, '')
    found, names = heard()
    assert '0.0.0.0' in found and names == {'udp', 'shm'}, 'else the test does not see what it looks for'


def test_the_command_that_resumes_names_the_domain_of_the_environment(monkeypatch, domain_id):
    """It is copied into another terminal, where the environment names another one."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    with CellClient() as client:
        assert client.resume_command('run_a').endswith(f'calibrate --resume run_a --domain {domain_id}')


@pytest.mark.parametrize(('given', 'domain', 'words'), [
    ('300', None, "ROS_DOMAIN_ID: expected a whole number in 0..232, found '300'; set another one, or give --domain"),
    ('-1', None, "found '-1'"), ('lab', None, "found 'lab'"), ('300', 5, ''), ('', None, ''), (' 7 ', None, '')])
def test_a_domain_that_does_not_exist(tmp_path, given, domain, words):
    """ROS would end the process, or log in its own words; one that is given is what counts."""
    if not words:
        check_environment(domain, {'ROS_DOMAIN_ID': given, 'HOME': str(tmp_path)})
        return
    with pytest.raises(CellError, match=re.escape(words)):
        check_environment(domain, {'ROS_DOMAIN_ID': given})


@pytest.mark.parametrize('given', [{'HOME': '{}/root'}, {'ROS_HOME': '{}/ros'}, {'ROS_LOG_DIR': '{}/logs', 'HOME': ''}])
def test_ros_has_to_have_a_place_for_its_logs(tmp_path, given):
    """It ends the process without one, in its own words."""
    check_environment(None, {name: value.format(tmp_path) for name, value in given.items()})
    with pytest.raises(CellError, match='^HOME: expected the folder of the user, found none; set HOME, or ROS_LOG_DIR'):
        check_environment(None, dict.fromkeys(given, ''))


@pytest.mark.parametrize(('given', 'words'), [
    ({'RCUTILS_LOGGING_USE_STDOUT': 'abc'}, "RCUTILS_LOGGING_USE_STDOUT: expected 0 or 1, found 'abc'; unset it"),
    ({'RCUTILS_LOGGING_BUFFERED_STREAM': 'x'}, "RCUTILS_LOGGING_BUFFERED_STREAM: expected 0 or 1, found 'x'; unset it"),
    ({'RCUTILS_COLORIZED_OUTPUT': '7'}, "RCUTILS_COLORIZED_OUTPUT: expected 0 or 1, found '7'; unset it"),
    ({'ROS_STATIC_PEERS': '127.0.0.1;no such host'}, 'ROS_STATIC_PEERS: expected names or addresses of computers, '
     'separated by ";", found \'no such host\', which has no address; correct it, or unset it'),
    ({'ROS_STATIC_PEERS': 'a' * 300}, 'ROS_STATIC_PEERS: expected names or addresses'),
    ({'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce'}, 'ROS_SECURITY_KEYSTORE: expected the folder '
                                                                          'of '
     "the keys, as ROS_SECURITY_STRATEGY is Enforce, found ''; set it (docs/security.md), or unset "
     "ROS_SECURITY_ENABLE"),
    ({'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce', 'ROS_SECURITY_KEYSTORE': '/nowhere'},
     "found '/nowhere'"),
    ({'ROS_LOG_DIR': '/dev/null'}, 'ROS_LOG_DIR: expected a folder for the logs of ROS, found /dev/null: File exists; '
                                   'set '
     'ROS_LOG_DIR to another one'),
    ({'ROS_HOME': '/dev/null'}, 'ROS_HOME: expected a folder for the logs of ROS, found /dev/null/log: Not a '
                                'directory'),
])
def test_what_ends_a_node_is_named(tmp_path, given, words):
    """By the variable, in one line: ROS ends the process, with a traceback or in hundreds of lines."""
    with pytest.raises(CellError) as caught:
        check_environment(None, {'HOME': str(tmp_path), **given})
    assert str(caught.value).startswith(words) or words in str(caught.value)


SETTINGS = ('<CycloneDDS><Domain Id="any"><General><AllowMulticast>false</AllowMulticast></General></Domain>'
            '</CycloneDDS>')
FILES = {'whole.xml': SETTINGS, 'cut.xml': SETTINGS[:60], 'empty.xml': '', 'text.xml': 'hello',
         'mismatch.xml': SETTINGS.replace('</General>', '</Generals>'), 'behind.xml': f'{SETTINGS}rubbish',
         'header.xml': f'<?xml version="1.0"?>\n<!-- <a> -->\n{SETTINGS}\n<!-- end -->\n',
         'short.xml': '<CycloneDDS><Domain><General><AllowMulticast>false</></></></>'}
WHOLE = ('', ' ', SETTINGS, '{}/whole.xml', 'file://{}/whole.xml', '{}/empty.xml', '{}/header.xml',
         '{}/whole.xml,{}/header.xml', ' {}/whole.xml, ', f'{SETTINGS},{{}}/whole.xml', SETTINGS + SETTINGS,
         '<General><AllowMulticast>false</></>')
BROKEN = {'{}/none.xml': 'expected a file that can be read, found No such file or directory',
          'file://{}/none.xml': 'found No such file or directory', '{}/whole.xml,{}/none.xml': 'No such file',
          '{}/cut.xml': 'found XML that is not whole', '{}/mismatch.xml': 'not whole', '{}/text.xml': 'not whole',
          '{}/short.xml': 'not whole',
          '{}/behind.xml': 'not whole', SETTINGS[:60]: 'not whole', f'{SETTINGS}rubbish': 'rubbish: expected a file',
          'http://example.org/a.xml': 'http://example.org/a.xml: expected a file that can be read'}

JOINING = '''
import os, sys
from cyclonedds.domain import DomainParticipant
for settings in sys.argv[2:]:
    if not (child := os.fork()):
        os.environ['CYCLONEDDS_URI'] = settings
        DomainParticipant(int(sys.argv[1]))
        os._exit(0)
    print('joined' if os.waitpid(child, 0)[1] == 0 else 'refused', flush=True)
'''


@pytest.fixture
def settings_of_cyclone(tmp_path):
    """Return a function that makes the value of CYCLONEDDS_URI, with files in place of {}."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return lambda given: given.replace('{}', str(tmp_path))


@pytest.mark.parametrize('given', [*WHOLE, *BROKEN])
def test_settings_of_cyclone_dds_are_whole(tmp_path, settings_of_cyclone, given):
    """Files and texts, with commas between; without that middleware nobody reads them."""
    home, value = {'HOME': str(tmp_path)}, settings_of_cyclone(given)
    check_environment(None, {'CYCLONEDDS_URI': value, **home})
    with nullcontext() if given in WHOLE else pytest.raises(CellError) as caught:
        check_environment(None, {'CYCLONEDDS_URI': value, 'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp', **home})
    if given in BROKEN:
        assert str(caught.value).startswith('CYCLONEDDS_URI: ') and BROKEN[given] in str(caught.value)
        assert str(caught.value).endswith('; correct it, or unset it') and '\n' not in str(caught.value)


def test_cyclone_dds_judges_its_settings_alike(settings_of_cyclone, domain_id):
    """By the library itself, a process for each, forked once it is loaded."""
    pytest.importorskip('cyclonedds')
    every = (*WHOLE, *BROKEN)
    done = subprocess.run([sys.executable, '-c', JOINING, str(domain_id), *map(settings_of_cyclone, every)],
                          capture_output=True, text=True, timeout=300, check=True)
    joined = [word == 'joined' for word in done.stdout.split()]
    assert joined == [given in WHOLE for given in every], done.stderr


@pytest.mark.parametrize(('text', 'words'), [
    (None, 'expected a file that can be read, found No such file or directory'),
    ('<a>', 'expected profiles of Fast DDS, found no XML: no element found'), ('<profiles/>', '')])
def test_profiles_that_fast_dds_would_leave_out_are_named(tmp_path, text, words):
    """It goes on without them, with a line in the middle of others: on other addresses than those wanted."""
    file = tmp_path / 'profiles.xml'
    if text is not None:
        file.write_text(text)
    given = {PROFILES: str(file), 'HOME': str(tmp_path)}
    check_environment(None, {**given, 'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'})
    with pytest.raises(CellError) if words else nullcontext() as caught:
        check_environment(None, given)
    if words:
        assert str(caught.value).startswith(f'{PROFILES}: {file}: {words}')


def test_what_the_environment_wants_of_the_output_changes_no_cell(monkeypatch):
    """Lines of the nodes are read by the cell: with another format or with colours, it waited for nodes in vain."""
    monkeypatch.setenv('RCUTILS_CONSOLE_OUTPUT_FORMAT', '{message}')
    monkeypatch.setenv('RCUTILS_COLORIZED_OUTPUT', '1')
    done = subprocess.run([sys.executable, '-c', 'from rclpy.logging import get_logger as g; g("n").warning("words")'],
                          env=supervisor.cell_environment(), stderr=subprocess.PIPE, text=True, check=True)
    assert supervisor.LOG_LINE.fullmatch(done.stderr.strip()).groups() == ('WARN', 'words')


@pytest.mark.parametrize(('name', 'value', 'verb', 'words'), [
    ('HOME', '', ('demo', '--output', 'demo'), 'HOME: expected the folder of the user, found none; set HOME'),
    ('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp', ('calibrate',),
     r"RMW_IMPLEMENTATION: expected one that is installed, rmw_\w+.*, found 'rmw_cyclonedds_cpp'; unset it, or "
     r"install"),
    ('ROS_DOMAIN_ID', '300', ('calibrate',), 'ROS_DOMAIN_ID: expected a whole number in 0..232'),
    ('ROS_DOMAIN_ID', '300', ('cell',), 'ROS_DOMAIN_ID: expected a whole number in 0..232'),
    ('PYTHONPATH', 'rclpy', ('check-cmm',), r'check-cmm: \S*/rclpy/__init__.py: expected a package that can be loaded, '
                                            "found: No module named 'rclpy.*; check PYTHONPATH"),
    ('DASK_CONFIG', 'dask', ('archive', 'add', str(LOG), '--into', 'archive'),
     r'archive: \S*dask\S*: expected a package that can be loaded, found: A dask config file at .* is malformed'),
])
def test_an_environment_of_others_is_told_in_one_line(tmp_path, name, value, verb, words):
    """A middleware that is not there, a domain beyond the ports, another rclpy, settings that no program can read."""
    (tmp_path / 'other' / 'rclpy').mkdir(parents=True)
    (tmp_path / 'other' / 'rclpy' / '__init__.py').touch()
    (tmp_path / 'dask').mkdir()
    (tmp_path / 'dask' / 'x.yaml').write_text('distributed: [')
    paths = {'rclpy': os.pathsep.join([str(tmp_path / 'other'), *sys.path]), 'dask': str(tmp_path / 'dask')}
    done = subprocess.run([sys.executable, '-m', 'rosette_ros.cli.main', *verb], capture_output=True, text=True,
                          timeout=300, cwd=tmp_path, env={**os.environ, name: paths.get(value, value)}, check=False)
    if value == 'rmw_cyclonedds_cpp' and 'no cell' in done.stderr:
        pytest.skip('it is installed')
    assert done.returncode == 2, done.stderr
    assert re.fullmatch(rf'rosette: {words}.*', done.stderr.strip()), done.stderr
