# SPDX-License-Identifier: Apache-2.0
"""rosette dme serve: what it refuses, and a server that is started, used and ended as a user does."""

import contextlib
import re
import signal
import socket
import subprocess
import sys

import pytest

from rosette_ros.cli.main import main
from rosette_ros.dme.dme_settings import load_dme_settings


@pytest.mark.parametrize('options, complaint', [
    (['--speed', 'slow'], "argument --speed: expected a positive number \\(times real time\\), found 'slow'"),
    (['--port', '70000'], "argument --port: expected a whole number in 0 .. 65535, found '70000'"),
    (['--machine', 'none.yaml'], 'none.yaml: expected a machine file that can be read, found No such file')])
def test_what_is_refused(capsys, options, complaint):
    assert main(['dme', 'serve', '--port', '0', *options]) == 2
    assert re.match(f'rosette: {complaint}', capsys.readouterr().err)


@pytest.mark.parametrize('number, code', [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_it_serves_until_it_is_ended(tmp_path, number, code):
    settings = tmp_path / 'dme.yaml'
    command = [sys.executable, '-m', 'rosette_ros.cli.main', 'dme', 'serve', '--port', '0', '--speed', 'fast',
               '--trace', '--settings', str(settings)]
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        stack.callback(server.kill)
        port = int(re.search(r'127\.0\.0\.1:(\d+): the simulated machine; 12 balls', server.stdout.readline())[1])
        client = stack.enter_context(socket.create_connection(('127.0.0.1', port), timeout=300))
        client.sendall(b'00001 StartSession()\r\n')
        lines = client.makefile('rb')
        assert [lines.readline(), lines.readline()] == [b'00001 &\r\n', b'00001 %\r\n']
        assert load_dme_settings(settings).server.port == port
        server.send_signal(number)
        out, err = server.communicate(timeout=300)
        assert server.returncode == code
        traced = out.replace('Ctrl-C ends it.\n', '')  # printed by another thread, at any line
        assert '< 00001 StartSession()\n> 00001 &\n> 00001 %\n' in traced
        assert 'Traceback' not in err


def test_demo_through_a_server_hides_nothing(capsys):
    assert main(['demo', '--dme', '--hidden', '1']) == 2
    assert 'demo: --dme and --hidden exclude each other: behind a server' in capsys.readouterr().err
