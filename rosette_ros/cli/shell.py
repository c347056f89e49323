# SPDX-License-Identifier: Apache-2.0
"""rosette shell: a shell, or one command, in which `rosette` and the Python with ROS are found."""

import argparse
import os
import shlex
import shutil
import sys
from pathlib import Path

from rosette_ros.cli.arguments import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('command', metavar='COMMAND', nargs=argparse.REMAINDER,
                        help='a command and its arguments, such as: python my_cmm.py (default: a shell)')


def run(options: argparse.Namespace) -> None:
    """Become the command, or the user's shell; raises UsageError where it is not found.

    A start-up file may put other folders before ours; bash is given one that reads the user's and then ours."""
    folder = str(Path(sys.executable).parent)
    environment = {**os.environ, 'PATH': os.pathsep.join([folder, os.environ.get('PATH', os.defpath)])}
    command = options.command or [os.environ.get('SHELL', 'sh')]
    found = shutil.which(command[0], path=environment['PATH'])
    if found is None:
        raise UsageError(f'shell: wanted a command, got {command[0]!r}, which is not found')
    if not options.command:
        print(f'{command[0]} with rosette and python of {folder}; exit leaves it', flush=True)
        if Path(found).name == 'bash':
            begin, end = os.pipe()
            os.write(end, f'[ -f ~/.bashrc ] && . ~/.bashrc\nPATH={shlex.quote(folder)}:$PATH\n'.encode())
            os.close(end)
            os.set_inheritable(begin, True)
            command += ['--rcfile', f'/dev/fd/{begin}']
    os.execve(found, command, environment)
