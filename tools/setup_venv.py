# SPDX-License-Identifier: Apache-2.0
"""Makes .venv: the pinned packages, the messages of msg_defs/ and this package, and the command .venv/bin/rosette.

Each of its steps has a stamp in .venv/rosette that holds a hash of everything the step depends on. A step whose
stamp fits is skipped; a step's stamp is removed before its work and written after it, so an interrupted step is done
again. Run it through `make setup`; `setup.sh missing` prints the Debian packages that are missing, and does nothing.
"""

import fcntl
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / '.venv'
STATE = VENV / 'rosette'
LOG = STATE / 'setup.log'
LOCK = ROOT / 'requirements' / 'requirements.lock'
HOOK = ROOT / 'tools' / 'venv_hook.py'
BYTE_CODE = ROOT / 'tools' / 'byte_code.py'
INTERFACES = (ROOT / 'msg_defs', ROOT / 'tools' / 'tf2_msgs')

VERSION = f'{sys.version_info.major}.{sys.version_info.minor}'
SITE_PACKAGES = VENV / 'lib' / f'python{VERSION}' / 'site-packages'
# The interpreter that .venv is made from, also when .venv's own one runs this.
BASE_PYTHON = Path(sys._base_executable)
# The packages that install the others; pinned in the lock like all.
INSTALLERS = ('setuptools', 'uv')
# To be raised when what a step does changes, so that existing environments are made anew.
RECIPE = 1


class SetupError(Exception):
    """What is wrong and what to do about it, in one line."""


def main(arguments: list[str]) -> int:
    """Do what `arguments` ask for: nothing named, the set-up; `missing`, the list of missing Debian packages."""
    try:
        if arguments == ['missing']:
            print(' '.join(package for _, package in missing()))
        elif arguments:
            raise SetupError(f'unknown argument {arguments[0]!r}; known: missing')
        else:
            set_up()
    except SetupError as error:
        print(f'setup: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('setup: interrupted; the next `make setup` goes on from here', file=sys.stderr)
        return 130
    return 0


def set_up() -> None:
    """Bring .venv up to date; say nothing when it is."""
    with Exclusive():
        steps = pending()
        if not steps:
            return
        check_machine()
        print(f'Setting up .venv with Python {platform.python_version()}')
        for title, stamp, key, work in steps:
            began = time.monotonic()
            print(f'  {title} ...', end='', flush=True)
            stamp.unlink(missing_ok=True)
            try:
                work()
            except BaseException:
                print(flush=True)
                raise
            write_whole(stamp, key)
            print(f' {time.monotonic() - began:.0f} s', flush=True)


class Exclusive:
    """Only one set-up of this clone at a time; a second one waits for the first."""

    def __enter__(self) -> None:
        self.folder = os.open(ROOT / 'tools', os.O_RDONLY)
        try:
            fcntl.flock(self.folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print('Waiting for another set-up of this clone to end ...', flush=True)
            fcntl.flock(self.folder, fcntl.LOCK_EX)

    def __exit__(self, *_: object) -> None:
        os.close(self.folder)


# What is to be done


def pending() -> list[tuple[str, Path, str, Callable[[], None]]]:
    """Return (title, stamp, key, work) of every step whose stamp does not hold its key.

    Where the packages are not whole, nothing else is: they are installed into an empty .venv.
    """
    packages_key = digest([LOCK, HOOK], f'{RECIPE} {VENV} {BASE_PYTHON.resolve()} {VERSION}')
    messages_key = digest(files_below(*INTERFACES), packages_key)
    package_key = digest(package_files(), packages_key)
    steps = [
        ('packages', STATE / 'packages', packages_key, install_packages),
        ('messages, about a minute', STATE / 'messages', messages_key, build_messages),
        ('rosette_ros', STATE / 'package', package_key, install_package),
        ('byte code', STATE / 'byte_code', digest([BYTE_CODE], messages_key + package_key), compile_imports),
    ]
    if not holds(STATE / 'packages', packages_key):
        return steps
    return [step for step in steps if not holds(step[1], step[2])]


def package_files() -> list[Path]:
    """Return the files that decide how rosette_ros is installed; its code and settings are used where they are."""
    return [ROOT / name for name in ('package.xml', 'setup.cfg', 'setup.py')]


def files_below(*folders: Path) -> list[Path]:
    """Return all files below `folders`, in a fixed order, without what editors and Python leave behind."""
    found = [path for folder in folders for path in folder.rglob('*')]
    return sorted(path for path in found if path.is_file() and '__pycache__' not in path.parts)


def digest(paths: Iterable[Path], further: str) -> str:
    """Return a hash of names and contents of `paths`, and of `further`."""
    result = hashlib.sha256(further.encode())
    for path in paths:
        content = path.read_bytes()
        result.update(f'\0{path.relative_to(ROOT)}\0{len(content)}\0'.encode())
        result.update(content)
    return result.hexdigest()


def holds(stamp: Path, key: str) -> bool:
    """Tell whether `stamp` holds `key`."""
    try:
        return stamp.read_text() == key
    except (FileNotFoundError, NotADirectoryError):
        return False


def write_whole(path: Path, text: str) -> None:
    """Write `text` to `path`, so that an interruption leaves the old file or the new one."""
    beside = path.with_name(f'{path.name}.new')
    beside.write_text(text)
    beside.replace(path)


# What the machine must have


def check_machine() -> None:
    """Raise a SetupError if .venv cannot be made on this machine."""
    if sys.platform != 'linux' or platform.machine() != 'x86_64' or platform.libc_ver()[0] != 'glibc':
        raise SetupError(
            f'ROS 2 packages exist for Linux on x86-64 with glibc 2.28 or later, this is {sys.platform} on '
            f'{platform.machine()}; use a ROS 2 Jazzy workspace instead: colcon build --base-paths . msg_defs'
        )
    lacking = missing()
    if lacking:
        things = ', '.join(thing for thing, _ in lacking)
        raise SetupError(f'missing: {things}. Install with: apt install {" ".join(package for _, package in lacking)}')


def missing() -> list[tuple[str, str]]:
    """Return (thing, its Debian package) of everything that is needed and not there."""
    # Debian's packages for its default Python have no version in their names.
    default = Path('/usr/bin/python3')
    is_default = default.exists() and default.resolve() == BASE_PYTHON.resolve()
    python = 'python3' if is_default else f'python{VERSION}'
    lacking = []
    if not has_installer():
        lacking.append((f"Python {VERSION}'s ensurepip", f'{python}-venv'))
    if not (Path(sysconfig.get_path('include')) / 'Python.h').exists():
        lacking.append((f"Python {VERSION}'s headers", f'{python}-dev'))
    for variable, names, package in (('CC', ('cc', 'gcc', 'clang'), 'gcc'), ('CXX', ('c++', 'g++', 'clang++'), 'g++')):
        names = (os.environ[variable].split()[0],) if os.environ.get(variable, '').strip() else names
        if not any(map(shutil.which, names)):
            lacking.append((f'a compiler ({" or ".join(names)})', package))
    return lacking


def has_installer() -> bool:
    """Tell whether pip or uv can be had: in the environment, from the base interpreter, or from PATH."""
    return has_module('ensurepip') or has_module('pip') or shutil.which('uv') is not None


def has_module(name: str) -> bool:
    """Tell whether the base interpreter has a module; Debian has an ensurepip that cannot do its work as well."""
    check = f'import {name}' + ('; ensurepip.version()' if name == 'ensurepip' else '')
    return subprocess.run([BASE_PYTHON, '-I', '-c', check], capture_output=True, check=False).returncode == 0


# Step 1: the pinned packages


def install_packages() -> None:
    """Make .venv anew and install everything that the lock names."""
    if VENV.exists() and any(VENV.iterdir()) and not STATE.is_dir():
        raise SetupError('there is a .venv that was not made by `make setup`; move it away, or remove it (make clean)')
    shutil.rmtree(VENV, ignore_errors=True)
    STATE.mkdir(parents=True)
    run([BASE_PYTHON, '-I', '-m', 'venv', '--without-pip', VENV])
    pip_command = pip()
    python = VENV / 'bin' / 'python'
    uv_options = ['--python', python, '--link-mode', 'copy']
    options = ['--require-hashes', '--no-deps', '--no-build-isolation', '-r']
    installers = STATE / 'installers.txt'
    write_whole(installers, locked(INSTALLERS))
    if pip_command:
        run([*pip_command, 'install', '--no-input', '--no-compile', *options, installers])
    else:
        run([shutil.which('uv'), 'pip', 'install', *uv_options, *options, installers])
    try:
        run([VENV / 'bin' / 'uv', 'pip', 'install', *uv_options, *options, LOCK])
    except SetupError:
        # uv does not read pip's configuration, which may name the only way to the packages.
        if not pip_command:
            raise
        print(' uv failed, once more with pip, which takes minutes ...', end='', flush=True)
        run([*pip_command, 'install', '--no-input', '--no-compile', *options, LOCK])
    rewrite_wheel_paths()
    install_hook()


def pip() -> list[str | Path]:
    """Return the command that runs pip for .venv, or nothing where there is none."""
    python = VENV / 'bin' / 'python'
    if subprocess.run([python, '-I', '-m', 'pip', '--version'], capture_output=True, check=False).returncode == 0:
        return [python, '-I', '-m', 'pip']
    if has_module('ensurepip'):
        run([python, '-I', '-m', 'ensurepip', '--default-pip'])
        return [python, '-I', '-m', 'pip']
    if has_module('pip'):
        return [BASE_PYTHON, '-I', '-m', 'pip', '--python', python]
    return []


def locked(names: Iterable[str]) -> str:
    """Return the lock's entries for `names`."""
    entries = re.split(r'^(?=\S)', LOCK.read_text(), flags=re.MULTILINE)
    return ''.join(entry for entry in entries if entry.split('==')[0] in names)


def rewrite_wheel_paths() -> None:
    """Let the CMake files of the wheels name this Python instead of the one of the machine that made them."""
    include = sysconfig.get_path('include')
    for path in files_below(VENV / 'share'):
        content = path.read_bytes()
        if b'/opt/python/cp' in content:
            text = re.sub(r'/opt/python/cp\d+-cp\d+/include/python3\.\d+', include, content.decode())
            text = re.sub(r'/opt/python/cp\d+-cp\d+', str(VENV), text)
            write_whole(path, text)


def install_hook() -> None:
    """Let every start of .venv's Python run venv_hook.py, before all other start-up files."""
    shutil.copyfile(HOOK, SITE_PACKAGES / '_rosette_venv.py')
    write_whole(SITE_PACKAGES / '0_rosette_venv.pth', 'import _rosette_venv; _rosette_venv.start_again()\n')


# Step 2: the messages


def build_messages() -> None:
    """Build the interface packages into .venv and remove what an earlier build put there and this one did not."""
    build = STATE / 'build'
    # A build on top of another one would keep what is left of definitions that are no more.
    shutil.rmtree(build, ignore_errors=True)
    run(
        [
            *(VENV / 'bin' / 'colcon', '--log-base', STATE / 'log', 'build', '--merge-install'),
            *('--build-base', build, '--install-base', VENV, '--base-paths', *INTERFACES),
            *('--cmake-args', '-G', 'Ninja', '-DBUILD_TESTING=OFF', '-DCMAKE_BUILD_TYPE=Release', '-DPYTHON_ONLY=ON'),
        ],
        PATH=f'{VENV / "bin"}:{os.environ["PATH"]}',
        CMAKE_PREFIX_PATH=str(VENV),
        COLCON_HOME=str(STATE),
        MAKEFLAGS=f'-j{os.cpu_count()}',  # else colcon lets Ninja wait while the computer is busy (-l)
    )
    remove_stale({line for path in build.glob('*/install_manifest.txt') for line in path.read_text().splitlines()})


def remove_stale(installed: set[str]) -> None:
    """Remove what an earlier build installed and what is not among `installed`, the files of this one."""
    record = STATE / 'installed'
    before = set(record.read_text().splitlines()) if record.exists() else set()
    for path in before - installed:
        Path(path).unlink(missing_ok=True)
    write_whole(record, '\n'.join(sorted(installed)))


# Step 3: rosette_ros itself


def install_package() -> None:
    """Install rosette_ros so that changes of its code, settings and launch files take effect at once."""
    uv = VENV / 'bin' / 'uv'
    options = ['--python', VENV / 'bin' / 'python', '--no-deps', '--no-build-isolation', '--offline', '--no-cache']
    run([uv, 'pip', 'install', *options, '--editable', ROOT])
    # What an editable installation leaves out.
    for name in ('package.xml', 'config', 'launch'):
        link(VENV / 'share' / 'rosette_ros' / name, ROOT / name)
    index = VENV / 'share' / 'ament_index' / 'resource_index' / 'packages'
    link(index / 'rosette_ros', ROOT / 'resource' / 'rosette_ros')
    # Where `ros2 run` and launch files look for a package's executables.
    for name in console_scripts():
        link(VENV / 'lib' / 'rosette_ros' / name, VENV / 'bin' / name)


def link(path: Path, target: Path) -> None:
    """Let `path` be a symbolic link to `target`."""
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    path.symlink_to(target)


def console_scripts() -> list[str]:
    """Return the names of the commands that rosette_ros installs."""
    [entry_points] = SITE_PACKAGES.glob('rosette_ros-*.dist-info/entry_points.txt')
    return re.findall(r'^(\S+)\s*=', entry_points.read_text(), flags=re.MULTILINE)


# Step 4: byte code


def compile_imports() -> None:
    """Compile what rosette_ros imports, and the tests, once, instead of at the first start or at every start."""
    run([VENV / 'bin' / 'python', BYTE_CODE])


# Running programs


def run(command: list[str | Path], **variables: str) -> None:
    """Run `command` with its output in the log; on failure raise a SetupError with the end of the output."""
    with LOG.open('a+', errors='replace') as log:
        print('$', *command, file=log, flush=True)
        began = log.tell()
        process = subprocess.Popen(
            [str(part) for part in command],
            cwd=ROOT,
            env=clean_environment() | variables,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            wait_for(process)
        finally:
            process.kill()
        if process.returncode == 0:
            return
        log.seek(began)
        last = '\n'.join(log.read().splitlines()[-40:])
    program = Path(command[0]).name
    raise SetupError(f'{program} failed; all of its output is in {LOG.relative_to(ROOT)}, its end:\n{last}')


def wait_for(process: subprocess.Popen[bytes]) -> None:
    """Wait for the end of a program; on a terminal tell every second for how long, and how much is built."""
    began, shown = time.monotonic(), ''
    while process.poll() is None:
        try:
            process.wait(1.0)
        except subprocess.TimeoutExpired:
            if sys.stdout.isatty():
                shown = f' {time.monotonic() - began:.0f} s{how_far()}'
                print(shown + '\b' * len(shown), end='', flush=True)
    print(' ' * len(shown) + '\b' * len(shown), end='', flush=True)


def how_far() -> str:
    """Return how many of its steps Ninja has done, in words; '' where it does nothing."""
    logs = sorted((STATE / 'log' / 'latest_build').glob('*/stdout.log'), key=lambda path: path.stat().st_mtime)
    steps = re.findall(r'^\[(\d+)/(\d+)\]', logs[-1].read_text(errors='replace'), re.MULTILINE) if logs else []
    return f', {" of ".join(steps[-1])}' if steps else ''


def clean_environment() -> dict[str, str]:
    """Return the environment without what a sourced ROS 2, another virtual environment or pip's --user would change."""
    unwanted = re.compile(
        r'(AMENT|CMAKE|COLCON)_PREFIX_PATH|COLCON_DEFAULTS_FILE|LD_LIBRARY_PATH|PYTHON(PATH|HOME)|VIRTUAL_ENV|'
        r'PIP_(USER|TARGET|PREFIX|REQUIRE_VIRTUALENV)|ROS_.*|_ROS_WHEELS_BOOTSTRAP_COMPLETE|ROSETTE_VENV|MAKEFLAGS|MAKELEVEL'
    )
    return {name: value for name, value in os.environ.items() if not unwanted.fullmatch(name)}


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
