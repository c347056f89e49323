# SPDX-License-Identifier: Apache-2.0
"""tools/size.py counts what it says, and growth above a limit fails."""

import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / 'tools' / 'size.py'
FILES = {
    'tools/size.py': SCRIPT.read_text('utf-8'),
    'rosette_ros/core/diagnosis/score.py': (
        'from rosette_ros import words\n\nLIMIT, (MOST) = 1, 2\nNAMES: dict = {}\nx = A = 0\n'),
    'rosette_ros/words.py': 'import rosette_ros.letters\n',
    'rosette_ros/letters.py': '',
    'rosette_ros/page.py': 'import rosette_ros.letters\n\ndef f():\n    INNER = 0\n',
    'test/test_words.py': '\n\n',
    'README.md': 'One two\n<!-- table of -->| not read |<!-- end of the table -->three\n',
}
COUNTED = {'package-lines': 10, 'test-lines': 2, 'document-words': 3, 'diagnosis-constants': 4,
           'one-importer-modules': 1}


def test_growth_above_a_limit_fails(tmp_path):
    """A small tree whose figures are known: within its limits, and with each limit lowered by one."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding='utf-8')
    for lowered in (None, *COUNTED):
        limits = '\n'.join(f'{name} = {count - (name == lowered)}' for name, count in COUNTED.items())
        (tmp_path / 'pyproject.toml').write_text(f'[tool.rosette.size]\n{limits}\n', encoding='utf-8')
        done = subprocess.run([sys.executable, tmp_path / 'tools/size.py'], capture_output=True, text=True, check=False)
        above = [line.split()[0] for line in done.stdout.splitlines() if 'TOO MANY' in line]
        assert (done.returncode, above) == ((1, [lowered]) if lowered else (0, [])), done.stdout + done.stderr
