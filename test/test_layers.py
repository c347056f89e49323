# SPDX-License-Identifier: Apache-2.0
"""The layers of the package: what may import what, what works without ROS, and how modules are named."""

import ast
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from rosette_ros.cell.supervisor import MODULES
from rosette_ros.cli.main import VERBS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / 'rosette_ros'
FILES = sorted(PACKAGE.rglob('*.py'))
ROS = frozenset(('rclpy', 'rosette_msgs', 'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs', 'geometry_msgs',
                 'tf2_msgs', 'diagnostic_msgs', 'action_msgs', 'builtin_interfaces', 'lifecycle_msgs', 'rcl_interfaces',
                 'service_msgs', 'ament_index_python', 'launch', 'launch_ros'))
SIMULATION_MAY = frozenset((
    'core', 'core.run', 'core.run.axes', 'core.run.errors', 'core.run.geometry', 'core.run.records', 'core.run.scheme',
    'core.run.touches', 'core.table', 'core.table.correction', 'io.correction_file', 'io.safe_yaml', 'io.text_file'))
"""What the simulated machine shares with the evaluation: records, geometry, correction tables, files, no physics."""

ALLOWED = {
    '__init__': {'api', 'core', 'invocation'},  # all but the last for types; loaded when it is used
    'invocation': set(),
    'requirements': set(),
    'plugins': set(),
    'core': {'core', 'plugins'},
    'words': {'core', 'invocation', 'words'},
    'io': {'core', 'io', 'plugins'},
    'simulation': {'core', 'io', 'simulation'},
    'calibration': {'core', 'words', 'io', 'calibration'},
    'analysis': {'core', 'analysis'},
    'dme': {'core', 'io', 'simulation', 'dme'},
    'presentation': {'core', 'invocation', 'words', 'io', 'analysis', 'presentation'},
    'certificate': {'core', 'invocation', 'words', 'io', 'analysis', 'presentation', 'certificate'},
    'archive': {'core', 'invocation', 'words', 'io', 'analysis', 'presentation', 'archive'},
    'api': {'core', 'words', 'io', 'simulation', 'analysis', 'presentation', 'certificate', 'archive', 'requirements',
            'api'},
    'nodes': {'core', 'invocation', 'words', 'io', 'simulation', 'analysis', 'calibration', 'dme', 'nodes'},
    'cell': {'core', 'invocation', 'words', 'io', 'calibration', 'nodes', 'cell'},
    'studio': {'core', 'words', 'io', 'analysis', 'api', 'presentation', 'archive', 'calibration', 'nodes', 'cell',
               'requirements', 'studio'},
    'cli': {'core', 'invocation', 'words', 'io', 'simulation', 'analysis', 'api', 'presentation', 'certificate',
            'archive', 'calibration', 'dme', 'nodes', 'cell', 'studio', 'requirements', 'cli'},
}
"""Layer: the layers it may import. Arrows point one way only."""

ROOMS = ('run', 'effects', 'model', 'sight', 'uncertainty', 'diagnosis', ('planning', 'joint', 'table'))
"""Rooms of the core: each imports only those before it; the last ones do not import each other."""

WITHOUT_ROS = ('core', 'words', 'io', 'simulation', 'analysis', 'presentation', 'certificate', 'archive', 'calibration',
               'dme', 'api')
MCAP_MAY = {'io/log_reader.py', 'io/log_writer.py', 'io/message_decoder.py'}
"""The only files that know the library of the log format."""
IN_CLI = {f'rosette_ros.cli.{name}' for name, _ in VERBS.values()}
STARTED_BY_NAME = {'rosette_ros.cli.main', 'rosette_ros.nodes.table_corrector', 'rosette_ros.nodes.own_cmm',
                   *MODULES.values(), *IN_CLI}
"""Modules that nobody has to import: commands, nodes, verbs; what programs of users import."""


def layer(path):
    """Return the layer of a file: its folder or, at the top, its own name."""
    inside = path.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else inside.stem


@cache
def tree_of(path):
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding='utf-8'))


@cache
def nodes(tree):
    """Return all nodes of a syntax tree, which is walked once for all rules."""
    return tuple(ast.walk(tree))


def module_of(path):
    """Return the full name of a file's module; a package is called as its folder."""
    return '.'.join(('rosette_ros', *path.relative_to(PACKAGE).with_suffix('').parts)).removesuffix('.__init__')


@cache
def imports(tree):
    """Return the full names of what a file imports, relative ones with a leading dot."""
    names = set()
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = '.' * node.level + (node.module or '')
            names |= {module} | {f'{module}.{alias.name}' for alias in node.names}
    return frozenset(names)


def own(names):
    """Return imports of this package as paths inside it: rosette_ros.core.model.least_squares -> core.model...."""
    return sorted(name.partition('.')[2] for name in names if name.startswith('rosette_ros.'))


def is_module(name):
    """Return whether a dotted path inside the package is a module of it."""
    path = PACKAGE.joinpath(*name.split('.'))
    return path.with_suffix('.py').is_file() or (path / '__init__.py').is_file()


def wrong_arrows(here, tree):
    """Return what a file in the layer `here` imports from layers that are not below it."""
    if any(name.startswith('.') for name in imports(tree)):
        return ['a relative import']
    allowed = ALLOWED.get(here, set())
    return [name for name in own(imports(tree)) if name.split('.')[0] not in allowed]


def outside_of_core(tree):
    """Return what does not belong in the core: other libraries, files, clocks, printing, eval."""
    tops = {name.split('.')[0] for name in imports(tree)}
    foreign = {top for top in tops - {'numpy', 'scipy', 'rosette_ros'} if top not in sys.stdlib_module_names}
    worldly = tops & {'os', 'io', 'pathlib', 'time', 'datetime', 'logging', 'subprocess'}
    calls = {node.func.id for node in nodes(tree)
             if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    return sorted(foreign | worldly | (calls & {'print', 'open', 'input', 'eval', 'exec'}))


def nested_imports(tree):
    """Return the lines of imports inside functions: they hide an arrow."""
    outside = [tree]
    for node in outside:
        outside.extend(child for child in ast.iter_child_nodes(node)
                       if not isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)))
    inside = {node for node in nodes(tree) if isinstance(node, (ast.Import, ast.ImportFrom))}.difference(outside)
    return sorted(node.lineno for node in inside)


def mcap_imports(tree):
    """Return the modules of the log format's library that a file imports."""
    return sorted(name for name in imports(tree) if re.match(r'mcap(_ros2)?(\.|$)', name))


def scipy_imports(tree):
    """Return the parts of scipy that a file imports itself."""
    return sorted(name for name in imports(tree) if name.startswith('scipy.'))


def texts(tree):
    """Return the texts in a file: a module may be imported by its name."""
    return {node.value for node in nodes(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def classes(tree):
    """Return the names of the classes at the top of a file."""
    return [node.name for node in tree.body if isinstance(node, ast.ClassDef)]


def repeated(names):
    """Return the names that occur more than once."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def offenders(rule, *layers):
    """Return {file: what the rule finds in it} of the files of some layers (all) that break it."""
    chosen = [path for path in FILES if not layers or layer(path) in layers]
    assert chosen
    found = {path.relative_to(PACKAGE).as_posix(): rule(path) for path in chosen}
    return {path: words for path, words in found.items() if words}


def test_arrows_point_one_way():
    """A layer imports only the layers below it; a new layer has to be given its place here."""
    assert offenders(lambda path: wrong_arrows(layer(path), tree_of(path))) == {}


def upward_in_core(room, tree):
    """Return what a file in a room of the core imports from rooms that are not below it, for types or not."""
    floors = {name: floor for floor, some in enumerate(ROOMS) for name in ([some] if isinstance(some, str) else some)}
    rooms = {name: name.split('.')[1] for name in own(imports(tree)) if name.startswith('core.')}
    return [name for name, other in rooms.items() if other != room and floors[other] >= floors[room]]


def test_rooms_of_the_core_import_those_below():
    """Imports of types included; a new room has to be given its place here, and no module stands beside the rooms."""
    assert offenders(lambda path: upward_in_core(path.relative_to(PACKAGE).parts[1], tree_of(path))
                     if path != PACKAGE / 'core' / '__init__.py' else [], 'core') == {}


def in_circles(arrows):
    """Return the modules that import themselves by others: those that stay when what imports nothing of the rest, and
    what nothing of the rest imports, is taken away again and again."""
    left = {name: others - {name} for name, others in arrows.items()}
    while True:
        imported = set().union(*left.values()) if left else set()
        kept = {name: others & left.keys() for name, others in left.items()
                if name in imported and others & left.keys()}
        if kept == left:
            return sorted(left)
        left = kept


@pytest.mark.parametrize(('folder', 'name'), [(PACKAGE, 'rosette_ros'), (ROOT / 'benchmarks', 'benchmarks')])
def test_no_circle(folder, name):
    """No module imports itself by others, nor for its types only."""
    modules = {'.'.join((name, *path.relative_to(folder).with_suffix('').parts)): path for path in folder.rglob('*.py')
               if path.stem != '__init__'}
    assert in_circles({one: imports(tree_of(path)) & modules.keys() for one, path in modules.items()}) == []


def test_core_knows_numbers_only():
    """Numpy, scipy and the standard library; no files, no clock, no printing."""
    assert offenders(lambda path: outside_of_core(tree_of(path)), 'core') == {}


def test_the_simulated_machine_shares_no_physics_with_the_evaluation():
    """What it hides must be found, not recognised: no effects, no model, no fit."""
    assert offenders(lambda path: [
        name for name in own(imports(tree_of(path)))
        if name.startswith(('core', 'io.')) and is_module(name) and name not in SIMULATION_MAY], 'simulation') == {}


def test_no_ros_below_the_nodes():
    """Whoever has no ROS can still evaluate."""
    assert offenders(lambda path: {name.split('.')[0] for name in imports(tree_of(path))} & ROS, *WITHOUT_ROS) == {}


def test_layers_without_ros_import_where_ros_is_not():
    """Every module of them, in a process in which ROS cannot be imported."""
    modules = [module_of(path) for path in FILES if layer(path) in WITHOUT_ROS]
    script = ('import importlib, sys\n'
              f'for name in {sorted(ROS)!r}: sys.modules[name] = None\n'
              f'for name in {modules!r}: importlib.import_module(name)\n')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


LOOKS_INTO = frozenset(('startswith', 'endswith', 'partition', 'rpartition', 'find', 'index', 'match', 'fullmatch',
                        'search'))
"""Functions that look for a text in another one."""
SENTENCE = re.compile(r"[A-Za-z]+ [A-Za-z]+ [A-Za-z]+")
"""Three words: a name has two at most."""


def sentences(trees):
    """Return the names of constants of files that are words of a sentence."""
    return {target.id for tree in trees for node in tree.body if isinstance(node, ast.Assign)
            for name, value in [(node.targets[0], node.value)]
            for target, text in (zip(name.elts, value.elts) if isinstance(name, ast.Tuple) and isinstance(
                value, ast.Tuple) else [(name, value)])
            if isinstance(target, ast.Name) and isinstance(text, ast.Constant) and SENTENCE.search(str(text.value))}


def decided_by_sentences(tree, known):
    """Return the lines that compare a text with words of a sentence, or look for these; known: constants of such."""
    def is_sentence(node):
        return ((isinstance(node, ast.Constant) and isinstance(node.value, str) and bool(SENTENCE.search(node.value)))
                or (isinstance(node, ast.JoinedStr) and any(map(is_sentence, node.values)))
                or (isinstance(node, ast.Name) and node.id in known))
    asked = [(node.lineno, [*node.comparators, node.left]) for node in nodes(tree) if isinstance(node, ast.Compare)]
    asked += [(node.lineno, node.args) for node in nodes(tree) if isinstance(node, ast.Call) and isinstance(
        node.func, ast.Attribute) and node.func.attr in LOOKS_INTO]
    return sorted({line for line, others in asked if any(map(is_sentence, others))})


def test_nothing_is_decided_by_a_sentence():
    """Below the nodes, where what was found is a record; a message may carry no more than words."""
    known = sentences(map(tree_of, FILES))
    assert offenders(lambda path: decided_by_sentences(tree_of(path), known), *WITHOUT_ROS) == {}


def test_who_fits_no_model_starts_without_the_parts_of_scipy():
    """They take half of the time of importing a node, and a cell has four of them."""
    script = ('import importlib, sys\n'
              'for name in ("nodes.recorder", "nodes.sequencer", "cell.client", "cell.supervisor"):\n'
              '    importlib.import_module(f"rosette_ros.{name}")\n'
              '    if sys.modules.keys() & {"scipy.linalg", "scipy.sparse", "scipy.special"}: sys.exit(name)\n')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_parts_of_scipy_load_where_they_are_used():
    """After `import scipy`: the first one takes 0.12 s of processor time, a ninth of what `rosette evaluate` takes."""
    assert offenders(lambda path: scipy_imports(tree_of(path))) == {}


def test_what_scipy_only_looks_at_is_not_loaded():
    """Of numpy; whoever uses it gets it."""
    script = ('import sys\n'
              'from rosette_ros.core.model import least_squares\n'
              'least_squares.scipy.special.ndtr(0.0), least_squares.scipy.linalg.lapack\n'
              'unused = {"numpy.f2py.crackfortran", "numpy.testing._private.utils"}\n'
              'assert not sys.modules.keys() & unused, sys.modules.keys() & unused\n'
              'import numpy\n'
              'from numpy.testing import assert_allclose\n'
              'assert_allclose(1.0, 1.0)\n'
              'assert callable(numpy.f2py.run_main) and unused <= sys.modules.keys()\n')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_slow_parts_of_scipy_are_left_out():
    """One of them takes 0.35 s, a third of what `rosette evaluate` takes from its start."""
    assert offenders(lambda path: re.findall(r'scipy\.(?:signal|stats|ndimage)\b', path.read_text('utf-8'))) == {}


def test_every_file_states_its_licence():
    """In its first line."""
    first = '# SPDX-License-Identifier: Apache-2.0\n'
    assert offenders(lambda path: not path.read_text(encoding='utf-8').startswith(first)) == {}


def test_imports_stand_at_the_top():
    """An import inside a function hides an arrow."""
    assert offenders(lambda path: nested_imports(tree_of(path))) == {}


def test_the_log_format_is_known_to_reader_and_writer_only():
    """They, and the decoder of messages, use the libraries of the format; nobody else does."""
    assert set(offenders(lambda path: mcap_imports(tree_of(path)))) == MCAP_MAY


def test_nobody_takes_the_event_of_lost_messages():
    """rmw_fastrtps 8.4 hangs where it is taken while another message is lost (its pull request 890)."""
    assert offenders(lambda path: 'message_lost' in path.read_text(encoding='utf-8')) == {}


def test_no_two_modules_have_one_name():
    """A name leads to one file."""
    assert repeated(path.stem for path in FILES if path.stem != '__init__') == []


def test_no_two_classes_have_one_name():
    """In the whole package."""
    assert repeated(name for path in FILES for name in classes(tree_of(path))) == []


def test_every_module_is_used_by_the_package():
    """What only tests or tools use belongs to them."""
    trees = [tree_of(path) for path in (*FILES, ROOT / 'launch' / 'cell.launch.py')]
    used = STARTED_BY_NAME.union(*map(imports, trees), *map(texts, trees))
    assert [module_of(path) for path in FILES if path.stem != '__init__' and module_of(path) not in used] == []


@pytest.mark.parametrize(('rule', 'text', 'found'), [
    (lambda tree: wrong_arrows('core', tree), 'import rosette_ros.io.open_run', ['io.open_run']),
    (lambda tree: wrong_arrows('io', tree), 'from rosette_ros.nodes import names', ['nodes', 'nodes.names']),
    (lambda tree: wrong_arrows('attic', tree), 'from rosette_ros.core import fit', ['core', 'core.fit']),
    (lambda tree: wrong_arrows('core', tree), 'from . import fit', ['a relative import']),
    (lambda tree: upward_in_core('model', tree), 'from rosette_ros.core.joint import sharing',
     ['core.joint', 'core.joint.sharing']),
    (lambda _: in_circles({'a': {'b'}, 'b': {'c', 'd'}, 'c': {'b'}, 'd': set(), 'e': {'a'}}), '', ['b', 'c']),
    (outside_of_core, 'import rich, time\nprint(1)', ['print', 'rich', 'time']),
    (nested_imports, 'def f():\n    import os', [2]),
    (scipy_imports, 'import scipy\nfrom scipy import special\nimport scipy.linalg', ['scipy.linalg', 'scipy.special']),
    (lambda tree: decided_by_sentences(tree, sentences([tree])), "A = 'a b'\nB, C = 'is rounded to', 1\n"
     "d = x.startswith(B)\ne = 'are in doubt' in x\nf = x.endswith(A)\ng = x == f'{x} and so on'\nh = x.find('mm')",
     [3, 4, 6]),
    (mcap_imports, 'import mcap_ros2.writer\nfrom mcap.reader import x\nimport mcapx',
     ['mcap.reader', 'mcap.reader.x', 'mcap_ros2.writer']),
    (lambda tree: repeated(classes(tree)), 'class A: pass\nclass B: pass\nclass A: pass', ['A']),
])
def test_the_rules_see_what_is_wrong(rule, text, found):
    """Each rule on a text that breaks it."""
    assert rule(ast.parse(text)) == found
