# SPDX-License-Identifier: Apache-2.0
"""What the documents state about files, modules, commands, options, parameters and messages is true."""

import argparse
import ast
import re
from functools import cache
from pathlib import Path

import pytest

from rosette_ros.cli.main import VERBS, Parser, declare, implementation
from rosette_ros.invocation import __version__

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob('*.md'), *ROOT.glob('docs/*.md')])
CONFIGURED = [*DOCUMENTS, ROOT / 'CHANGELOG.rst', *sorted(ROOT.glob('config/*.yaml'))]
NOT_OF_THE_REPOSITORY = {'my_cmm.py'}
"""Files that a reader writes."""
LINK = re.compile(r'\]\((?!https?:|#)([^)#\s]+)')
FILE = re.compile(r'(?<![\w/.*])((?:[\w.-]+/)*[\w-]+\.(?:py|sh|yaml|yml|xml|msg|srv|action|css|j2))\b')
COMMAND = re.compile(rf'rosette ({"|".join(VERBS)})(?![\w-])([^`\n#|]*)')


def name_of(path):
    """Return the path of a document as a test id."""
    return str(path.relative_to(ROOT))


def text_of(path):
    """Return the text of a document."""
    return path.read_text(encoding='utf-8')


def anchors(path):
    """Return the anchors of a document's headings."""
    heads = re.findall(r'^#+ (.*)$', text_of(path), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', head.lower()).replace(' ', '-') for head in heads}


@cache
def files():
    """Return the paths of all files of the repository, each with a slash in front."""
    tops = ('rosette_ros', 'test', 'tools', 'benchmarks', 'config', 'docs', 'examples', 'launch', 'msg_defs',
            'requirements')
    inside = [path for top in tops for path in (ROOT / top).rglob('*') if '__pycache__' not in path.parts]
    return [f'/{path.relative_to(ROOT).as_posix()}' for path in (*ROOT.iterdir(), *inside) if path.is_file()]


def names_a_module(dotted):
    """Return whether rosette_ros.a.b names a package, a module, or something that a module contains."""
    base = ROOT.joinpath(*dotted.split('.'))
    if base.is_dir() or base.with_suffix('.py').is_file():
        return True
    inside = [path for path in (base.parent.with_suffix('.py'), base.parent / '__init__.py') if path.is_file()]
    return any(re.search(rf'\b{base.name}\b', text_of(path)) for path in inside)


@cache
def options_of(verb):
    """Return the options that a verb takes, those of its own verbs included."""
    parser = Parser()
    declare(parser, implementation(verb, VERBS[verb][0]))
    inner = [made for action in parser._actions if isinstance(action, argparse._SubParsersAction)
             for made in action.choices.values()]
    return {option for one in (parser, *inner) for action in one._actions for option in action.option_strings}


@cache
def texts_of_the_package():
    """Return all string constants of the package, parts of f-strings included, joined by line feeds."""
    return '\n'.join(
        node.value for path in ROOT.glob('rosette_ros/**/*.py') for node in ast.walk(ast.parse(text_of(path)))
        if isinstance(node, ast.Constant) and isinstance(node.value, str))


@pytest.mark.parametrize('path', DOCUMENTS, ids=name_of)
def test_links_have_targets(path):
    """The linked files exist, and so does the linked heading."""
    text = text_of(path)
    missing = [target for target in LINK.findall(text) if not (path.parent / target).exists()]
    assert missing == []
    own = re.findall(r'\]\(#([^)\s]+)\)', text)
    assert [anchor for anchor in own if anchor not in anchors(path)] == []
    for target, anchor in re.findall(r'\]\((?!https?:)([^)#\s]*\.md)#([^)\s]+)\)', text):
        assert anchor in anchors(path.parent / target), f'{target}#{anchor}'


@pytest.mark.parametrize('path', CONFIGURED, ids=name_of)
def test_named_files_exist(path):
    """Every path of a source, test or configuration file is the end of a path of the repository."""
    named = set(FILE.findall(text_of(path))) - NOT_OF_THE_REPOSITORY - {'metadata.yaml', 'package.xml'}
    own = {name for name in named if '/' in name or name.endswith('.py')}
    assert [name for name in sorted(own) if not any(file.endswith(f'/{name}') for file in files())] == []


@pytest.mark.parametrize('path', CONFIGURED, ids=name_of)
def test_named_modules_exist(path):
    """Every dotted name below rosette_ros."""
    named = set(re.findall(r'\brosette_ros(?:\.[A-Za-z_]\w*)+', text_of(path)))
    assert [name for name in sorted(named) if not names_a_module(name)] == []


@pytest.mark.parametrize('path', CONFIGURED, ids=name_of)
def test_named_options_exist(path):
    """Every `rosette VERB --option`."""
    used = [(verb, option) for verb, rest in COMMAND.findall(text_of(path))
            for option in re.findall(r'(?<!\S)--?[a-z][\w-]*', rest.partition('--ros-args')[0])]
    assert [(verb, option) for verb, option in used if option not in options_of(verb)] == []


@pytest.mark.parametrize('path', CONFIGURED, ids=name_of)
def test_named_limits_exist(path):
    """Every parameter `limits. ...` is in cell.yaml."""
    block = re.search(r'^    limits:\n((?:      .*\n)+)', text_of(ROOT / 'config/cell.yaml'), re.MULTILINE)
    known = set(re.findall(r'^\s+(\w+):', block[1], re.MULTILINE))
    assert set(re.findall(r'\blimits\.(?!py\b)(\w+)', text_of(path))) - known == set()


@pytest.mark.parametrize('path', CONFIGURED, ids=name_of)
def test_named_targets_of_make_exist(path):
    """Every `make TARGET` in code."""
    known = set(re.findall(r'^([\w-]+):', text_of(ROOT / 'Makefile'), re.MULTILINE))
    assert set(re.findall(r'(?:`|^\s*)make ([a-z-]+)', text_of(path), re.MULTILINE)) - known == set()


def test_quoted_messages_are_printed():
    """The messages in the third column of docs/reliability.md, in the parts between what varies."""
    rows = re.findall(r'^\|([^|]*)\|([^|]*)\|([^|]*)\|$', text_of(ROOT / 'docs/reliability.md'), re.MULTILINE)
    quoted = [span for *_, message in rows for span in re.findall(r'`([^`]+)`', message) if ' ' in span]
    assert len(quoted) > 8
    assert [span for span in quoted if span not in texts_of_the_package()] == []


def test_every_verb_is_listed():
    """In the table of commands; and every example of the README is one of them."""
    listed = {verb for row in re.findall(r'^\| (`.*?) \|', text_of(ROOT / 'docs/commands.md'), re.MULTILINE)
              for verb in re.findall(r'`([\w-]+)[ `]', row)}
    used = set(re.findall(r'^(?:\.venv/bin/)?rosette ([\w-]+)', text_of(ROOT / 'README.md'), re.MULTILINE))
    assert listed == {verb for verb, (module, _) in VERBS.items() if (ROOT / f'rosette_ros/cli/{module}.py').is_file()}
    assert used and used - set(VERBS) == set()


def test_the_readme_is_read_in_two_minutes():
    """What is no code, no picture and no table of links has at most 500 words."""
    prose = re.sub(r'^```.*?^```$', '', text_of(ROOT / 'README.md'), flags=re.MULTILINE | re.DOTALL)
    lines = [line for line in prose.splitlines() if not line.startswith(('|', '[', '!['))]
    assert 200 < len(' '.join(lines).split()) <= 500


def test_changelog_begins_with_this_version():
    """In the style of ROS: version (date), underlined."""
    text = text_of(ROOT / 'CHANGELOG.rst')
    assert re.search(rf'^{re.escape(__version__)} \(\d{{4}}-\d\d-\d\d\)\n-{{18}}$', text, re.MULTILINE)


def test_constants_of_the_diagnosis_are_explained():
    """Each in the table of its page, in the row of its file; none that is gone; of a single run at most 50."""
    named = set()
    core = ROOT / 'rosette_ros' / 'core'
    of_cells = [core / 'joint' / f'{name}.py' for name in ('run_causes', 'cell_rates', 'cell_diagnosis')]
    of_sight = [core / 'sight' / f'{name}.py' for name in ('priors', 'limits')]
    for path in (*(core / 'diagnosis').glob('*.py'), *of_sight, *of_cells):
        for node in ast.parse(text_of(path)).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            named |= {(path.name, name.id) for target in targets for name in ast.walk(target)
                      if isinstance(name, ast.Name) and name.id.isupper()}
    rows = re.findall(r'^\| `(\w+\.py)` \| ([^|]*) \|', text_of(ROOT / 'docs' / 'diagnosis.md'), re.MULTILINE)
    explained = {(file, name) for file, names in rows for name in re.findall(r'`(\w+)`', names)}
    assert named == explained
    assert len([file for file, _ in named if file not in {path.name for path in of_cells}]) <= 50
