# SPDX-License-Identifier: Apache-2.0
"""Arguments that several verbs share, and how their texts become values."""

import argparse
import contextlib
import importlib
import importlib.util
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from rosette_ros.core.run.errors import RosetteError
from rosette_ros.core.run.number_limits import LARGEST, is_size
from rosette_ros.core.run.number_words import ANGLES
from rosette_ros.core.uncertainty.stated_environment import CLASSES
from rosette_ros.io.text_file import path_of, refuse_read
from rosette_ros.nodes.names import DOMAINS, NAMESPACE
from rosette_ros.requirements import missing_words

PICTURES = ('.png', '.svg', '.pdf')
WRITTEN = ('output', 'pdf', 'xlsx', 'dfq', 'qif', 'figure', 'noise_picture', 'save')
"""Options that name a file to write; a file that another one names is read."""
ENDS = tuple(signal.Signals[name] for name in ('SIGTERM', 'SIGHUP') if name in signal.Signals.__members__)
"""Signals that ask a verb to end, of those that the system has."""
IN_LOG = 'who, what and where (YAML, rosette-identity/1), kept in the log of each run'
_ROS = re.compile(r'rclpy|ament_index_python|rosidl\w+|\w+_(msgs|srvs|interfaces)')
_SOURCE = 'this needs ROS 2: source the set-up file of ROS 2 and of the workspace'
Value = TypeVar('Value', int, float)


class UsageError(RosetteError):
    """The command was not given as it is meant."""


def whole(low: int | None, high: int) -> Callable[[str], int]:
    """Return a reader of whole numbers in low .. high; low None: no lower bound."""
    span = f'of at most {high}' if low is None else f'in {low} .. {high}'
    return _reader(int, lambda value: value <= high and (low is None or value >= low), f'a whole number {span}')


def positive(unit: str) -> Callable[[str], float]:
    """Return a reader of positive numbers in a unit, as large as they can be."""
    return _reader(float, is_size, f'a positive number ({unit})')


def number(unit: str, most: float = LARGEST) -> Callable[[str], float]:
    """Return a reader of numbers in a unit, as large as they can be."""
    return _reader(float, lambda value: abs(value) <= most, f'a number ({unit}) from -{most:g} to {most:g}')


def until(text: str) -> float:
    """Return the probability from which on a cause is settled."""
    return _reader(float, lambda value: 0.5 < value < 1, 'a probability above 0.5 and below 1')(text)


def picture_file(text: str) -> Path:
    """Read the name of a picture to write."""
    if Path(text).suffix.lower() not in PICTURES:
        raise argparse.ArgumentTypeError(f'expected a file name that ends with {", ".join(PICTURES)}, found {text!r}')
    return Path(text)


def _reader(kind: Callable[[str], Value], is_right: Callable[[Value], bool], wanted: str) -> Callable[[str], Value]:
    def read(text: str) -> Value:
        with contextlib.suppress(ValueError):
            if is_right(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f'expected {wanted}, found {text!r}')
    return read


def made_folder(path: str, use: str = 'for logs', hint: str = '; choose another one with --output') -> Path:
    """Make a folder and return it; raise UsageError, with its use and a hint, where that is not possible."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f'{path}: expected a folder {use}, found: {error.strerror}{hint}') from error
    return Path(path)


def keep_inputs(options: argparse.Namespace, *written: Path) -> None:
    """Raise InvalidData where a command would write to a file that it reads; written: files besides its options."""
    given = vars(options)
    named = [one for name, value in given.items() if name not in WRITTEN
             for one in (value if isinstance(value, list) else [value]) if isinstance(one, (str, Path))]
    for path in (*written, *(given[name] for name in WRITTEN if given.get(name))):
        refuse_read(path, named)


def expand_home(options: argparse.Namespace) -> None:
    """Replace what was given as `~/` or file:/// by the path that it means, where no shell has (`--model=~/m.yaml`)."""
    for name, value in vars(options).items():
        is_list = isinstance(value, list)
        every = [path_of(one) if isinstance(one, str) else one for one in (value if is_list else [value])]
        setattr(options, name, every if is_list else every[0])


def namespace(text: str) -> str:
    """Read a namespace, with or without the slash in front."""
    bare = text.strip('/')
    if not re.fullmatch(r'([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?', bare, re.ASCII):
        raise argparse.ArgumentTypeError('expected a namespace such as cell2 (letters, digits and "_", none begins '
                                         f'with a digit), found {text!r}')
    return bare


SHARED: dict[str, dict[str, Any]] = {
    'run_path': {'metavar': 'RUN', 'help': 'log directory, .mcap file or ball-centre table (CSV)'},
    'archive': {'metavar': 'ARCHIVE', 'help': 'folder of the archive'},
    '--into': {'metavar': 'ARCHIVE', 'required': True, 'help': 'folder of the archive; made where there is none'},
    '--run-id': {'metavar': 'ID', 'help': 'which run, where a log holds several (rosette info names them)'},
    '--columns': {'metavar': 'MAP', 'help': 'what the columns of a table of another program are: a file of '
                  '`rosette import --save`, or table=Table,ball=Ball,x=X,y=Y,z=Z,radius_mm=182.5 ...'},
    '--model': {'metavar': 'FILE', 'help': 'model file (YAML); without it the base model: table motions, '
                                           'plate deviations, CMM deviations'},
    '--experience': {'metavar': 'FILE', 'help': 'what earlier runs of the cell have taught (YAML, '
                     'rosette-experience/1, of archive experience): its causes are found where they are weak'},
    '--any-cell': {'action': 'store_true', 'help': 'take the experience of another cell, too'},
    '--identity': {'metavar': 'FILE', 'help': 'who, what, where and tolerances (YAML, rosette-identity/1), in place of '
                                              'what the log states'},
    '--refit-spheres': {'action': 'store_true', 'help': 'recalculate the ball centres from the touches in the log, and '
                        'show these: radii, form of the balls, lobing of the probe'},
    '--plate': {'metavar': 'FILE', 'help': 'plate file (rosette-plate/1) of balls at other places than an equal pitch; '
                                           '--balls is then the number of table positions'},
    '--inputs': {'metavar': 'FILE', 'help': 'what the readings do not tell its uncertainty budget, such as '
                 'form of the balls, temperature, alignment (YAML, rosette-budget/1, see config/budget.yaml)'},
    '--environment': {'choices': tuple(CLASSES), 'help': 'how far machine, table and plate may move in a run, so that '
                      'U contains what the order cannot show; numbers of the cell: section environment of --inputs'},
    '--angle-unit': {'choices': tuple(ANGLES), 'default': 'urad', 'help': 'of small angles in all that is printed, '
                     'drawn and written as text or table; JSON and files for controllers keep theirs (default urad)'},
    '--format': {'choices': ('svg', 'png'), 'help': 'of the files of --figures (default svg)'},
    '--force': {'action': 'store_true', 'help': 'overwrite existing files'},
    '--trace': {'action': 'store_true', 'help': 'show every line that is sent and received, on stderr'},
    '--json': {'action': 'store_true', 'help': 'print one JSON object and nothing else'},
    '--output': {'metavar': 'DIR', 'default': 'rosette-runs',
                 'help': 'folder of the logs, one folder per run (default rosette-runs)'},
    '--domain': {'metavar': 'ID', 'type': whole(0, DOMAINS[-1]),
                 'help': 'ROS domain (default: that of the environment)'},
    '--namespace': {'metavar': 'NS', 'type': namespace, 'default': NAMESPACE,
                    'help': f'namespace of the cell (default {NAMESPACE})'}}
"""Arguments that several verbs take."""


def add_shared(parser: argparse.ArgumentParser, *names: str, **changed: Any) -> None:
    """Add arguments of SHARED; changed: settings in which they differ."""
    for name in names:
        parser.add_argument(*(['-o'] if name == '--output' else []), name, **(SHARED[name] | changed))


def add_places(parser: argparse.ArgumentParser) -> None:
    """Add --cmm-positions, --balls-of, --share and --shortest, of which one excludes the others."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument('--cmm-positions', metavar='K', default='', help='measure at the K CMM positions that determine '
                       'the curves best, or at those of a list such as 1,5,7,10 (default: all)')
    group.add_argument('--balls-of', metavar='K', default='', dest='balls_in_use',
                       help='measure the K balls that determine the curves best, or those of a list')
    group.add_argument('--share', dest='cmm_positions', metavar='PART', help='measure at this part of the CMM '
                       'positions, such as 0.5', type=_share)
    group.add_argument('--shortest', dest='cmm_positions', action='store_const', const='fewest',
                       help='measure at the fewest CMM positions that determine the curves')


def add_table_offset(parser: argparse.ArgumentParser) -> None:
    """Add --table-offset-deg."""
    angle = _reader(float, is_size,
                    'an angle above 0 and below one step of the table, deg (for 0 leave the option out)')
    parser.add_argument('--table-offset-deg', metavar='DEG', type=angle, help='table angle of table position 1, below '
                        'one step of the table: half a step for a run at half pitches (default 0)')


def _share(text: str) -> str:
    part = _reader(float, lambda value: 0 < value <= 1, 'a part of the CMM positions, above 0 and at most 1')
    return f'{100 * part(text):g} %'


def add_formats(parser: argparse.ArgumentParser, csv: str) -> argparse._MutuallyExclusiveGroup:
    """Add --json and, with words for it, --csv; return their group, of which one excludes the others."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument('--json', **SHARED['--json'])
    group.add_argument('--csv', action='store_true', help=csv)
    return group


def load(module: str, what: str) -> ModuleType:
    """Import what only some commands need; raise UsageError for `what`, naming the package, where one is missing."""
    os.environ['MATPLOTLIBRC'] = os.devnull  # matplotlib cannot be imported where it cannot read that of the user
    try:
        if os.path.exists('matplotlibrc') and 'matplotlib' not in sys.modules:  # that of this folder comes before it
            with contextlib.suppress(ModuleNotFoundError), contextlib.chdir('/'):
                importlib.import_module('matplotlib')
        return importlib.import_module(module)
    except RosetteError:
        raise
    except Exception as error:
        package = (getattr(error, 'name', None) or '').partition('.')[0]
        file = [one.filename for one in traceback.extract_tb(error.__traceback__) if os.path.isfile(one.filename)][-1]
        is_ours = package in ('', 'rosette_ros') and Path(file).is_relative_to(Path(__file__).parents[1])
        if is_ours or package == 'rosette_ros':
            raise
        if isinstance(error, ModuleNotFoundError) and importlib.util.find_spec(package) is None:
            words = (f'expected the Python package {package}, found none; {_SOURCE}' if _ROS.fullmatch(package) else
                     missing_words(package))
            raise UsageError(f'{what}: {words}') from error
        where = getattr(sys.modules.get(package), '__file__', None) or file
        raise UsageError(f'{what}: {where}: expected a package that can be loaded, found: '
                         f'{" ".join(str(error).split()):.300}; check PYTHONPATH and the settings of that package'
                         ) from error


def plots(name: str) -> ModuleType:
    """Import pictures where some are drawn: without them a command starts in half the time."""
    return load(f'rosette_ros.presentation.plots.{name}', 'pictures')
