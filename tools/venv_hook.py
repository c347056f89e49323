# SPDX-License-Identifier: Apache-2.0
"""Runs at every start of .venv's Python, so that it finds its own ROS 2 without any `source setup.bash`.

The dynamic linker reads LD_LIBRARY_PATH once, when a process starts. So this sets the environment and, the first
time only, starts the same command again in it; child processes inherit it and start once. A ROS 2 that the calling
shell has sourced is left out, because two ROS 2 in one process do not mix.
"""

import os
import sys

MARK = 'ROSETTE_VENV'


def environment(given: dict[str, str], prefix: str, libraries: list[str]) -> dict[str, str]:
    """Return the environment `given`, changed so that the ROS 2 in `prefix` is found, and no other.

    A sourced workspace that was built on top of `prefix` is not another one, and stays.
    """
    sourced = [p for p in given.get('AMENT_PREFIX_PATH', '').split(':') if p]
    on_top = prefix in sourced
    foreign = [] if on_top else sourced
    if given.get(MARK, prefix) != prefix:
        foreign.append(given[MARK])

    def kept(name: str) -> list[str]:
        parts = [part for part in given.get(name, '').split(':') if part]
        return [part for part in parts if not any(f'{part}/'.startswith(f'{p.rstrip("/")}/') for p in foreign)]

    own, inherited = [f'{prefix}/lib', *libraries], kept('LD_LIBRARY_PATH')
    changed = {
        MARK: prefix,
        'AMENT_PREFIX_PATH': ':'.join(sourced) if on_top else prefix,
        'LD_LIBRARY_PATH': ':'.join(inherited + own if on_top else own + inherited),
        'PYTHONPATH': ':'.join(kept('PYTHONPATH')),
        'ROS_DISTRO': 'jazzy',
        'ROS_VERSION': '2',
        'ROS_PYTHON_VERSION': '3',
        # The wheels' own start-up file would do part of this again.
        '_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1',
    }
    result = given | changed
    if not changed['PYTHONPATH']:
        del result['PYTHONPATH']
    return result


def start_again() -> None:
    """Replace this process by the same command in the right environment, unless it runs there already."""
    if os.environ.get(MARK) == sys.prefix:
        return
    site_packages = os.path.dirname(os.path.abspath(__file__))
    libraries = sorted(
        entry.path
        for entry in os.scandir(site_packages)
        if entry.name.startswith('ros_') and entry.name.endswith('.libs')
    )
    if sys.stdout:
        sys.stdout.flush()
    os.execve(
        sys.executable,
        [sys.executable, *sys.orig_argv[1:]],
        environment(dict(os.environ), sys.prefix, libraries),
    )
