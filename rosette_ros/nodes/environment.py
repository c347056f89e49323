# SPDX-License-Identifier: Apache-2.0
"""Whether the environment names a middleware, domain and home that exist: ROS ends the process where it does not."""

import os
from collections.abc import Mapping
from pathlib import Path

from rosette_ros.core.run.errors import CellError
from rosette_ros.nodes import names

_LOGS = ('ROS_LOG_DIR', 'ROS_HOME', 'HOME')
"""Where ROS looks for the folder of its own logs, first to last."""
_INDEX = Path('share', 'ament_index', 'resource_index', 'rmw_typesupport')


def check_middleware(environ: Mapping[str, str] = os.environ) -> None:
    """Raise CellError where RMW_IMPLEMENTATION is not installed; call it before rclpy is loaded.

    environ: mapping with AMENT_PREFIX_PATH. Nothing is checked where none is known to be installed."""
    wanted = environ.get('RMW_IMPLEMENTATION', '')
    folders = [Path(prefix) / _INDEX for prefix in environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix]
    there = sorted({path.name for folder in folders if folder.is_dir() for path in folder.iterdir()
                    if path.name.startswith('rmw_') and path.name != 'rmw_implementation'})
    if wanted and there and wanted not in there:
        raise CellError(f'RMW_IMPLEMENTATION: wanted one that is installed, {" or ".join(there)}, got {wanted!r:.80}; '
                        'unset it, or install that one')


def check_environment(domain_id: int | None, environ: Mapping[str, str] = os.environ) -> None:
    """Raise CellError where no domain is given and that of the environment does not exist, or ROS cannot log."""
    given = environ.get('ROS_DOMAIN_ID', '').strip() if domain_id is None else ''
    if given and not (given.isdecimal() and int(given) in names.DOMAINS):
        raise CellError(f'ROS_DOMAIN_ID: wanted a whole number in 0..{names.DOMAINS[-1]}, got {given!r:.80}; set '
                        'another one, or give --domain')
    if not any(environ.get(name) for name in _LOGS):
        raise CellError('HOME: wanted the folder of the user, got none; set HOME, or ROS_LOG_DIR to a folder for the '
                        'logs of ROS')
