# SPDX-License-Identifier: Apache-2.0
"""The walls of the house: which room may import which, and what works where there is no ROS."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / 'rosette_ros'
FILES = sorted(PACKAGE.rglob('*.py'))
ROS = frozenset(('rclpy', 'rosette_msgs', 'rosgraph_msgs', 'std_msgs', 'std_srvs', 'geometry_msgs',
                 'tf2_msgs', 'diagnostic_msgs', 'action_msgs', 'builtin_interfaces',
                 'rcl_interfaces', 'service_msgs', 'ament_index_python', 'launch', 'launch_ros'))
MACHINE_MAY = frozenset(('core.errors', 'core.geometry', 'core.records', 'core.scheme',
                         'core.alignment', 'core'))
"""What the simulated machine shares with the evaluation: records and geometry, no physics."""

ALLOWED = {
    '__init__': set(),
    'core': {'core'},
    'data': {'core', 'data'},
    'machine': {'core', 'machine'},
    'analysis': {'core', 'analysis'},
    'story': {'core', 'analysis'},
    'units': set(),
    'words': {'core', 'report_json', 'units'},
    'report_json': {'core', 'analysis'},
    'diagnosis_json': {'core', 'analysis', 'report_json'},
    'pictures': {'core', 'data', 'analysis', 'story', 'report_json', 'units', 'words', 'pictures'},
    'report': {'core', 'data', 'analysis', 'story', 'report_json', 'diagnosis_json', 'units', 'words',
               'pictures', 'report'},
    'nodes': {'core', 'data', 'machine', 'analysis', 'nodes'},
    'web': {'core', 'data', 'analysis', 'story', 'report_json', 'diagnosis_json', 'units', 'words',
            'pictures', 'report', 'nodes', 'web'},
    'cli': {'core', 'data', 'machine', 'analysis', 'story', 'units', 'words', 'report_json',
            'diagnosis_json', 'pictures', 'report', 'nodes', 'web', 'cli'},
}
"""Room: the rooms it may import. Arrows point one way only."""

WITHOUT_ROS = ('core', 'data', 'machine', 'analysis', 'story', 'units', 'words', 'report_json',
               'diagnosis_json', 'pictures', 'report')


def room(path):
    """Return the room of a file: its folder or, at the top, its own name."""
    inside = path.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else inside.stem


def tree_of(path):
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding='utf-8'))


def imports(tree):
    """Return the full names of what a file imports, relative ones with a leading dot."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = '.' * node.level + (node.module or '')
            names |= {module} | {f'{module}.{alias.name}' for alias in node.names}
    return names


def own(names):
    """Return imports of this package as paths inside it: rosette_ros.core.fit -> core.fit."""
    return sorted(name.partition('.')[2] for name in names
                  if name.startswith('rosette_ros.') and name != 'rosette_ros.__version__')


def is_module(name):
    """Return whether a dotted path inside the package is a module of it."""
    path = PACKAGE.joinpath(*name.split('.'))
    return path.with_suffix('.py').is_file() or (path / '__init__.py').is_file()


def wrong_arrows(here, tree):
    """Return what a file in the room `here` imports from rooms that are not below it."""
    if any(name.startswith('.') for name in imports(tree)):
        return ['a relative import']
    allowed = ALLOWED.get(here, set())
    return [name for name in own(imports(tree)) if name.split('.')[0] not in allowed]


def outside_of_core(tree):
    """Return what does not belong in the core: other libraries, files, clocks, printing, eval."""
    tops = {name.split('.')[0] for name in imports(tree)}
    foreign = {top for top in tops - {'numpy', 'scipy', 'rosette_ros'}
               if top not in sys.stdlib_module_names}
    worldly = tops & {'os', 'io', 'pathlib', 'time', 'datetime', 'logging', 'subprocess'}
    calls = {node.func.id for node in ast.walk(tree)
             if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    return sorted(foreign | worldly | (calls & {'print', 'open', 'input', 'eval', 'exec'}))


def hidden_imports(tree):
    """Return the lines of imports inside functions: they hide an arrow."""
    return sorted({node.lineno for function in ast.walk(tree)
                   if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef))
                   for node in ast.walk(function)
                   if isinstance(node, (ast.Import, ast.ImportFrom))})


def offenders(rule, *rooms):
    """Return {file: what the rule says of it} of the files of some rooms (all) that break it."""
    chosen = [path for path in FILES if not rooms or room(path) in rooms]
    assert chosen
    said = {str(path.relative_to(PACKAGE)): rule(path) for path in chosen}
    return {path: words for path, words in said.items() if words}


def test_arrows_point_one_way():
    """A room imports only the rooms below it; a new room has to be given its place here."""
    assert offenders(lambda path: wrong_arrows(room(path), tree_of(path))) == {}


def test_core_knows_numbers_only():
    """Numpy, scipy and the standard library; no files, no clock, no printing."""
    assert offenders(lambda path: outside_of_core(tree_of(path)), 'core') == {}


def test_the_machine_shares_no_physics_with_the_evaluation():
    """What it hides must be found, not recognised: no effects, no model, no fit."""
    assert offenders(lambda path: [
        name for name in own(imports(tree_of(path)))
        if name.startswith('core') and is_module(name) and name not in MACHINE_MAY],
        'machine') == {}


def test_no_ros_below_the_nodes():
    """Whoever has no ROS can still evaluate."""
    assert offenders(lambda path: {name.split('.')[0] for name in imports(tree_of(path))} & ROS,
                     *WITHOUT_ROS) == {}


def test_rooms_without_ros_import_where_ros_is_not():
    """Every module of them, in a process in which ROS cannot be imported."""
    modules = ['.'.join(('rosette_ros', *path.relative_to(PACKAGE).with_suffix('').parts))
               for path in FILES if room(path) in WITHOUT_ROS]
    script = (
        'import importlib, sys\n'
        f'for name in {sorted(ROS)!r}: sys.modules[name] = None\n'
        f'for name in {modules!r}: importlib.import_module(name.removesuffix(".__init__"))\n')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr


def test_every_file_says_its_licence():
    """In its first line."""
    first = '# SPDX-License-Identifier: Apache-2.0\n'
    assert offenders(
        lambda path: not path.read_text(encoding='utf-8').startswith(first)) == {}


def test_imports_stand_at_the_top():
    """An import inside a function hides an arrow."""
    assert offenders(lambda path: hidden_imports(tree_of(path))) == {}


@pytest.mark.parametrize(('rule', 'text', 'found'), [
    (lambda tree: wrong_arrows('core', tree), 'import rosette_ros.data.labels', ['data.labels']),
    (lambda tree: wrong_arrows('data', tree), 'from rosette_ros.nodes import names',
     ['nodes', 'nodes.names']),
    (lambda tree: wrong_arrows('attic', tree), 'from rosette_ros.core import fit',
     ['core', 'core.fit']),
    (lambda tree: wrong_arrows('core', tree), 'from . import fit', ['a relative import']),
    (outside_of_core, 'import rich, time\nprint(1)', ['print', 'rich', 'time']),
    (hidden_imports, 'def f():\n    import os', [2]),
])
def test_the_rules_see_what_is_wrong(rule, text, found):
    """Each rule on a text that breaks it."""
    assert rule(ast.parse(text)) == found
