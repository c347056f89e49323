# SPDX-License-Identifier: Apache-2.0
"""Whether ROS can work with what the environment says: else it ends the process, in many lines, or never names it."""

import os
import re
import socket
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from rosette_ros.core.run.errors import CellError
from rosette_ros.io.text_file import read_limited
from rosette_ros.nodes import names

_LOGS = {'ROS_LOG_DIR': '', 'ROS_HOME': 'log', 'HOME': '.ros/log'}
"""Where ROS looks for the folder of its own logs, first to last, and where below."""
_SWITCHES = 'RCUTILS_LOGGING_USE_STDOUT', 'RCUTILS_LOGGING_BUFFERED_STREAM', 'RCUTILS_COLORIZED_OUTPUT'
_PEERS, _LONGEST_PEER = 'ROS_STATIC_PEERS', 255
_ENABLE, _STRATEGY, _KEYSTORE = 'ROS_SECURITY_ENABLE', 'ROS_SECURITY_STRATEGY', 'ROS_SECURITY_KEYSTORE'
_RMW, _FAST_DDS, _CYCLONE_DDS = 'RMW_IMPLEMENTATION', ('', 'rmw_fastrtps_cpp'), 'rmw_cyclonedds_cpp'
_PROFILES, _SETTINGS, _LONGEST_SETTINGS = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'CYCLONEDDS_URI', 1 << 16
_TAG = re.compile(r'''<!--.*?-->|<[?].*?[?]>|<(/?)([^\s<>/"']*)([\s/](?:"[^"]*"|'[^']*'|[^<>"'])*)?>''', re.DOTALL)
"""A comment, an instruction, or a tag: / where it closes, name, attributes."""
_BETWEEN = ' \t\r\n,'
_INDEX = Path('share', 'ament_index', 'resource_index', 'rmw_typesupport')


def check_middleware(environ: Mapping[str, str] = os.environ) -> None:
    """Raise CellError where RMW_IMPLEMENTATION is not installed; call it before rclpy is loaded.

    environ: mapping with AMENT_PREFIX_PATH. Nothing is checked where none is known to be installed."""
    wanted = environ.get(_RMW, '')
    folders = [Path(prefix) / _INDEX for prefix in environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix]
    there = sorted({path.name for folder in folders if folder.is_dir() for path in folder.iterdir()
                    if path.name.startswith('rmw_') and path.name != 'rmw_implementation'})
    if wanted and there and wanted not in there:
        raise CellError(f'{_RMW}: expected one that is installed, {" or ".join(there)}, found '
                        f'{wanted!r:.80}; '
                        'unset it, or install that one')


def check_environment(domain_id: int | None, environ: Mapping[str, str] = os.environ) -> None:
    """Raise CellError, which names the variable, where ROS could not work with an environment.

    domain_id: None for that of the environment."""
    given = environ.get('ROS_DOMAIN_ID', '').strip() if domain_id is None else ''
    if given and not (given.isdecimal() and int(given) in names.DOMAINS):
        raise CellError(f'ROS_DOMAIN_ID: expected a whole number in 0..{names.DOMAINS[-1]}, found {given!r:.80}; set '
                        'another one, or give --domain')
    for name in _SWITCHES:
        if environ.get(name, '') not in ('', '0', '1'):
            raise CellError(f'{name}: expected 0 or 1, found {environ[name]!r:.80}; unset it')
    for peer in filter(None, environ.get(_PEERS, '').split(';')):
        _check_peer(peer)
    keys = environ.get(_KEYSTORE, '')
    if environ.get(_ENABLE) == 'true' and environ.get(_STRATEGY) == 'Enforce' and not os.path.isdir(keys):
        raise CellError(f'{_KEYSTORE}: expected the folder of the keys, as {_STRATEGY} is Enforce, found '
                        f'{keys!r:.80}; set '
                        f'it (docs/security.md), or unset {_ENABLE}')
    if environ.get(_RMW, '') in _FAST_DDS and (file := environ.get(_PROFILES, '')):
        _check_profiles(file)
    if environ.get(_RMW) == _CYCLONE_DDS:
        _check_settings(environ.get(_SETTINGS, ''))
    _check_logs(environ)


def _settings_file(variable: str, name: str) -> str:
    """Return the text of a file with settings of a middleware; raises CellError."""
    try:
        return read_limited(name, 'a file', _LONGEST_SETTINGS, CellError).decode('utf-8', 'replace')
    except CellError as error:
        raise CellError(f'{variable}: {error}; correct it, or unset it') from error


def _check_profiles(name: str) -> None:
    """Raise CellError where Fast DDS would leave out its profiles: without them it does what nobody asked for."""
    try:
        ElementTree.fromstring(_settings_file(_PROFILES, name))
    except ElementTree.ParseError as error:
        raise CellError(f'{_PROFILES}: {name}: expected profiles of Fast DDS, found no XML: {error}; correct it, or '
                        'unset it') from error


def _check_settings(given: str) -> None:
    """Raise CellError where Cyclone DDS could not read its settings: texts in XML and names of files, with commas."""
    while given := given.lstrip(_BETWEEN):
        if given.startswith('<'):
            where, end = f'{given!r:.80}', _end_of_element(given, '')
            is_whole, given = end > 0, given[end:]
        else:
            where, _, given = given.partition(',')
            text = _settings_file(_SETTINGS, where.removeprefix('file://')).lstrip()
            end = _end_of_element(text)
            is_whole = not text or (end > 0 and not _TAG.sub('', text[end:]).strip())
        if not is_whole:
            raise CellError(f'{_SETTINGS}: {where}: expected settings of Cyclone DDS, <CycloneDDS>...</CycloneDDS>, '
                            'found XML that is not whole; correct it, or unset it')


def _end_of_element(text: str, short: str | None = None) -> int:
    """Return where the first element of a text in XML ends, 0 where it does not; short: name that closes any."""
    unclosed = list[str]()
    for tag in _TAG.finditer(text) if text.startswith('<') else ():
        slash, name, rest = tag.groups()
        if name is None:  # a comment, an instruction
            continue
        if not slash and not (rest or '').endswith('/'):
            unclosed.append(name)
        elif slash and (not unclosed or name not in (short, unclosed.pop())):
            return 0
        if not unclosed:
            return tag.end()
    return 0


def _check_peer(peer: str) -> None:
    """Raise CellError where a computer has no address."""
    try:
        if len(peer) <= _LONGEST_PEER and socket.getaddrinfo(peer.strip(), None):
            return
    except (OSError, UnicodeError):
        pass
    raise CellError(f'{_PEERS}: expected names or addresses of computers, separated by ";", found {peer!r:.80}, which '
                    'has '
                    'no address; correct it, or unset it')


def _check_logs(environ: Mapping[str, str]) -> None:
    """Raise CellError where ROS cannot make the folder of its own logs."""
    name = next((name for name in _LOGS if environ.get(name)), '')
    if not name:
        raise CellError('HOME: expected the folder of the user, found none; set HOME, or ROS_LOG_DIR to a folder for '
                        'the '
                        'logs of ROS')
    folder = Path(os.path.expanduser(environ[name]), _LOGS[name])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        reason = '' if os.access(folder, os.W_OK | os.X_OK) else 'no permission to write'
    except OSError as error:
        reason = str(error.strerror)
    if reason:
        raise CellError(f'{name}: expected a folder for the logs of ROS, found {folder}: {reason}; set ROS_LOG_DIR to '
                        'another one')
