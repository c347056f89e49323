# SPDX-License-Identifier: Apache-2.0
"""What the documents say of files and verbs is true."""

import re
from pathlib import Path

import pytest

from rosette_ros import __version__
from rosette_ros.cli.main import VERBS

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob('*.md'), *ROOT.glob('docs/*.md')])
LINK = re.compile(r'\]\((?!https?:|#)([^)#\s]+)')


def anchors(path):
    """Return the anchors of a document's headings."""
    heads = re.findall(r'^#+ (.*)$', path.read_text(encoding='utf-8'), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', head.lower()).replace(' ', '-') for head in heads}


@pytest.mark.parametrize('path', DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    """Files that documents point to are there, with the heading."""
    text = path.read_text(encoding='utf-8')
    missing = [target for target in LINK.findall(text) if not (path.parent / target).exists()]
    assert missing == []
    for target, anchor in re.findall(r'\]\((?!https?:)([^)#\s]*\.md)#([^)\s]+)\)', text):
        assert anchor in anchors(path.parent / target), f'{target}#{anchor}'


def test_the_verbs_of_the_readme_exist():
    """Those of the table, and those of every example."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    listed = {verb for row in re.findall(r'^\| (`.*?) \|', text, re.MULTILINE)
              for verb in re.findall(r'`(\w+)[ `]', row)}
    used = set(re.findall(r'^(?:\.venv/bin/)?rosette (\w+)', text, re.MULTILINE))
    assert {'demo', 'plan', 'calibrate', 'evaluate', 'info', 'import', 'export',
            'replay'} <= listed
    assert (listed | used) - set(VERBS) == set()


def test_changelog_begins_with_this_version():
    """In the style of ROS: version (date), underlined."""
    text = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    assert re.search(rf'^{re.escape(__version__)} \(\d{{4}}-\d\d-\d\d\)\n-{{18}}$', text,
                     re.MULTILINE)
