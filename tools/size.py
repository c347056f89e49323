# SPDX-License-Identifier: Apache-2.0
"""Prints what the project has grown to beside the limits in pyproject.toml, and fails above one of them."""

import ast
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

WRITTEN = re.compile('<!-- table .*?<!-- end of the table -->', re.DOTALL)
"""Tables that a command writes into a page are no reading."""


def lines(folder: Path) -> int:
    """Return the lines of all Python files of a folder, blank ones included."""
    return sum(len(path.read_text('utf-8').splitlines()) for path in folder.rglob('*.py'))


def words(pages: Iterable[Path]) -> int:
    """Return the words of pages, without the tables that commands write."""
    return sum(len(WRITTEN.sub('', path.read_text('utf-8')).split()) for path in pages)


def constants(folder: Path) -> int:
    """Return the number of names in capitals that modules of a folder assign."""
    found = 0
    for path in folder.rglob('*.py'):
        for node in ast.parse(path.read_text('utf-8')).body:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(
                node, ast.AnnAssign) else []
            found += sum(isinstance(name, ast.Name) and name.id.isupper()
                         for target in targets for name in ast.walk(target))
    return found


def with_one_importer(package: Path) -> list[str]:
    """Return the modules of a package that exactly one other module of it imports."""
    modules = {'.'.join(path.relative_to(package.parent).with_suffix('').parts): path for path in package.rglob('*.py')}
    importers = Counter[str]()
    for path in modules.values():
        names = set[str]()
        for node in ast.walk(ast.parse(path.read_text('utf-8'))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names |= {str(node.module), *(f'{node.module}.{alias.name}' for alias in node.names)}
        importers.update(names & set(modules))
    return sorted(name for name, count in importers.items() if count == 1)


def figures(root: Path) -> dict[str, int]:
    """Return what is limited, by the names of pyproject.toml."""
    return {
        'package-lines': lines(root / 'rosette_ros'),
        'test-lines': lines(root / 'test'),
        'document-words': words([*root.glob('*.md'), *root.glob('*.rst'), *root.glob('docs/*.md')]),
        'diagnosis-constants': constants(root / 'rosette_ros' / 'core' / 'diagnosis'),
        'one-importer-modules': len(with_one_importer(root / 'rosette_ros')),
    }


def main(root: Path) -> int:
    """Print each figure and its limit, and return 1 where one is above."""
    limits = tomllib.loads((root / 'pyproject.toml').read_text('utf-8'))['tool']['rosette']['size']
    found = figures(root)
    for name in sorted(found.keys() | limits.keys()):
        print(f'{name:<22} {found[name]:>6} of {limits[name]}' + ('  TOO MANY' if found[name] > limits[name] else ''))
    return int(any(found[name] > limits[name] for name in found))


if __name__ == '__main__':
    sys.exit(main(Path(__file__).parents[1]))
