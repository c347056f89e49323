# SPDX-License-Identifier: Apache-2.0
"""Builds the documentation as a site in build/site: python tools/docs_site.py

Pages stay as they are on a forge: they are copied with what they link to, the README as the first page, and mkdocs
refuses a link that leads nowhere. The pages of the interface are made from its docstrings."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / 'build' / 'site-source'
COPIED = ('docs', 'examples', 'config', 'LICENSE', 'CONTRIBUTING.md', 'CHANGELOG.rst')
MODULES = {
    'Runs': 'rosette_ros.api.measurement', 'Evaluating': 'rosette_ros.api.evaluating',
    'Comparing curves': 'rosette_ros.api.curve_sources', 'Planning': 'rosette_ros.api.plans',
    'Simulating': 'rosette_ros.api.simulating',
    'Effects and models': 'rosette_ros.api.effect_library', 'Documents': 'rosette_ros.api.documents',
    'Results': 'rosette_ros.api.result', 'Errors': 'rosette_ros.core.run.errors'}


def main() -> int:
    """Copy the pages, write those of the interface, build; return the exit code of mkdocs."""
    shutil.rmtree(SOURCE, ignore_errors=True)
    SOURCE.mkdir(parents=True)
    for name in COPIED:
        path = ROOT / name
        (shutil.copytree if path.is_dir() else shutil.copy)(path, SOURCE / name)
    shutil.copy(ROOT / 'README.md', SOURCE / 'index.md')
    for page in SOURCE.rglob('*.md'):
        text = page.read_text(encoding='utf-8')
        page.write_text(re.sub(r'\]\((\.\./)?README\.md', r'](\1index.md', text), encoding='utf-8')
    parts = [f'## {title}\n\n::: {module}\n' for title, module in MODULES.items()]
    (SOURCE / 'interface.md').write_text('\n'.join(['# Interface for Python\n', *parts]), encoding='utf-8')
    return subprocess.run([sys.executable, '-m', 'mkdocs', 'build', '--strict', '--quiet', '--config-file',
                           ROOT / 'mkdocs.yml'], cwd=ROOT, check=False).returncode


if __name__ == '__main__':
    sys.exit(main())
