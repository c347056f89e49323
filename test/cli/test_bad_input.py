# SPDX-License-Identifier: Apache-2.0
"""Bad input through the command line: one line: where, what was wanted, what came."""

import re

import pytest


def change(line, column, value):
    """Return an edit that puts a value into a cell of the table; lines and columns from zero."""
    def edit(lines):
        cells = lines[line].split(',')
        cells[column] = value
        return [*lines[:line], ','.join(cells), *lines[line + 1:]]
    return edit


def drop_column(name):
    """Return an edit that takes a column out."""
    def edit(lines):
        at = lines[4].split(',').index(name)
        cut = [','.join(cell for place, cell in enumerate(line.split(',')) if place != at)
               for line in lines[4:]]
        return lines[:4] + cut
    return edit


def radians(lines):
    """Write the table angles in radians by mistake."""
    return lines[:5] + [change(0, 4, str(float(line.split(',')[4]) / 57.29577951308232))([line])[0]
                        for line in lines[5:]]


TABLES = {
    'missing column': (drop_column('y_mm'), ('line 5', 'expected the column y_mm', '--order diagonal --csv-template')),
    'word': (change(7, 5, 'abc'), ('line 8', 'x_mm', "expected a number, found 'abc'")),
    'NaN': (change(7, 6, 'nan'), ('line 8', 'y_mm', "expected a finite number, found nan")),
    'ball out of range': (change(9, 2, '0'), ('line 10', 'ball', 'expected at least 1, found 0')),
    'n disagrees': (change(40, 2, '9'), ('ball', 'found 9')),
    'radians': (radians, ('radians',)),
    'empty': (lambda lines: [], ('is empty',)),
    'header only': (lambda lines: lines[:5], ('expected rows of ball centres, found none',)),
    'no schema': (lambda lines: lines[1:], ('# schema: rosette-ball-centres/1',)),
    'duplicate': (lambda lines: [*lines[:6], '2' + lines[5][1:], *lines[7:]],
                  ('line 7', 'found table_position 1, ball 1 again (first in line 6)')),
}


@pytest.mark.parametrize('fault', TABLES)
def test_a_faulty_table(refused, make_table, fault):
    """File, line, column, what was expected, what was found; the same words in every verb."""
    edit, words = TABLES[fault]
    path = make_table(edit=edit)
    line = refused('evaluate', path)
    assert str(path) in line
    for word in words:
        assert word in line
    assert refused('export', path, '-o', path.with_name('out.csv')) == line
    assert refused('info', path) == line


@pytest.mark.parametrize('words', [('evaluate',), ('info',), ('replay',), ('import', '-o', 'x')])
def test_nothing_there(refused, tmp_path, words):
    """A path that does not exist."""
    line = refused(words[0], tmp_path / 'nowhere', *words[1:])
    assert str(tmp_path / 'nowhere') in line
    assert 'check the path' in line


def test_too_few_ball_centres(refused, make_table):
    """What cannot be determined is named."""
    path = make_table(edit=lambda lines: ['# balls: 6', *lines[:5 + 20]])
    line = refused('evaluate', path)
    assert 'too few ball centres: 20 of 36' in line
    assert 'give rank 51 where 53 is needed (at least 22 well spread ball centres)' in line
    assert 'cannot determine ctz at table position 1, ctz at table position 2' in line


MODELS = {
    'base: [table]': "model: base: expected some of table_motions, plate_deviations, "
                     "cmm_deviations, found 'table'",
    'effects: [warp]': "Unknown effect 'warp'. Did you mean ",
    'effects: frame_drift': "effects: expected a list, found 'frame_drift'",
    'effects: 0': 'effects: expected a list, found 0',
    'base: [table_motions\n': 'expected YAML, found text that is none: line 2, column 1: ',
    '- frame_drift': 'expected a mapping with base and effects, found a list',
    'schema: rosette-model/2': "schema: expected rosette-model/1, found 'rosette-model/2'",
    'bases: []': "expected the keys schema, base, effects, noise, found 'bases'",
    'effects: [{name: frame_warmup, time: 3}]': "effect frame_warmup: expected settings among ",
}


@pytest.mark.parametrize('text', MODELS)
def test_a_faulty_model(refused, make_table, tmp_path, text):
    """The file and the key are named."""
    model = tmp_path / 'model.yaml'
    model.write_text(text)
    line = refused('evaluate', make_table(), '--model', model)
    assert str(model) in line
    assert MODELS[text] in line


def test_an_effect_that_the_order_hides(refused, make_table, tmp_path):
    """Drift in row order: taken up whole by the base model."""
    model = tmp_path / 'model.yaml'
    model.write_text('effects: [table_backlash]\n')
    line = refused('evaluate', make_table(), '--model', model)
    assert 'table_backlash' in line


def test_a_table_is_not_overwritten(refused, rosette, make_table):
    """Unless it is asked for."""
    def measured(lines):
        return [*lines[:-1], lines[-1].replace(',20.0,', ',20.1,')]  # a thermometer that stands still is doubted

    source, target = make_table(edit=measured), make_table(name='there.csv', seed=1, edit=measured)
    before = target.read_bytes()
    assert '--force' in refused('export', source, '-o', target)
    assert target.read_bytes() == before
    assert rosette('export', source, '-o', target, '--force').code == 0
    assert target.read_bytes() != before


@pytest.mark.parametrize('words', [
    ('correct', 'RUN', '-o'), ('report', 'RUN', '-o'), ('certificate', 'RUN', '-o'), ('export', 'RUN', '-o'),
    ('certificate', 'other.csv', '--identity', 'RUN', '-o', 'a.xml', '--pdf'),
    ('budget', 'other.csv', '--inputs', 'RUN', '-o'),
    ('compare', 'RUN', '--noise-picture'), ('plan', 'diagonal', 'RUN', '-o'), ('dme', 'path', 'RUN', '--figure'),
    ('dme', 'serve', '--machine', 'RUN', '--settings'), ('report', '--compare', 'other.csv', 'RUN', '-o')])
@pytest.mark.parametrize('to', ['RUN', 'folder/../RUN', 'link.svg', 'hard.svg'])
def test_a_file_that_is_read_is_not_overwritten(refused, make_table, tmp_path, monkeypatch, words, to):
    """Not even with --force, whatever its spelling; a measurement cannot be made again."""
    monkeypatch.chdir(tmp_path)
    run = make_table(name='mine.svg')
    make_table(name='other.csv')
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'link.svg').symlink_to(run)
    (tmp_path / 'hard.svg').hardlink_to(run)
    before = run.read_bytes()
    to = to.replace('RUN', 'mine.svg')
    line = refused(*('mine.svg' if word == 'RUN' else word for word in words), to, '--force')
    assert line == f'rosette: {to}: is read by this command; take another name for what it writes\n'
    assert run.read_bytes() == before


@pytest.mark.parametrize('name', ['log/log_0.mcap', 'log/metadata.yaml'])
def test_files_of_a_log_are_not_overwritten(refused, rosette, make_table, tmp_path, name):
    """What a folder of them has besides is."""
    log = tmp_path / 'log'
    assert rosette('import', make_table(), '-o', log).code == 0
    before = (tmp_path / name).read_bytes()
    assert f'{name}: is read by this command' in refused('correct', log, '-o', tmp_path / name, '--force')
    assert (tmp_path / name).read_bytes() == before
    (log / 'c.yaml').write_text('old')
    assert rosette('correct', log, '-o', log / 'c.yaml', '--force').code == 0


@pytest.mark.usefixtures('sketched')
def test_a_table_of_the_report_does_not_replace_its_run(refused, make_table, tmp_path, monkeypatch):
    """That has the name of the table."""
    monkeypatch.chdir(tmp_path)
    run = make_table(name='curves.csv')
    before = run.read_bytes()
    assert 'curves.csv: is read by this command' in refused('report', run, '--tables', '.', '--force')
    assert run.read_bytes() == before


PYTHON = re.compile(r'\b[A-Z]\w*(?:Error|Exception)\b|\bNoneType\b|\bdict\b|\bstr\b|\bint\(\)|\btuple\b|unhashable')
"""Words of the language that the program is written in, which mean nothing to whoever reads an error."""


@pytest.mark.parametrize(('name', 'text', 'words'), [
    ('m.yaml', '- frame_drift', 'expected a mapping with base and effects, found a list'),
    ('m.yaml', '3', 'expected a mapping with base and effects, found a whole number'),
    ('m.yaml', 'base: [!!int ""]', 'expected a number in decimal digits'),
    ('m.yaml', 'effects: [2026-99-99]', 'expected YAML values, found one that is none'),
    ('m.yaml', 'effects: [{own: a, direction: z, expression: "t[0]"}]', "found 't[0]'"),
    ('m.yaml', 'effects: [{own: a, direction: z, expression: "t +"}]', "'t +' cannot be read"),
    ('metadata.yaml', 'other: 1', 'expected a rosbag2 description with rosbag2_bagfile_information'),
    ('metadata.yaml', 'rosbag2_bagfile_information: 3', 'expected a rosbag2 description with '),
    ('metadata.yaml', 'rosbag2_bagfile_information: [', 'expected a rosbag2 description with ')])
def test_an_error_is_said_without_names_of_python(refused, make_table, tmp_path, name, text, words):
    """Whatever was wrong inside: what a file should hold and what it holds."""
    (tmp_path / name).write_text(text)
    line = refused('info', tmp_path) if name == 'metadata.yaml' else refused(
        'evaluate', make_table(), '--model', tmp_path / name)
    assert words in line and not PYTHON.search(line), line


@pytest.mark.parametrize('verb', ['calibrate', 'demo'])
@pytest.mark.parametrize('value', ['0.5', '1', '95', 'nan', 'sure'])
def test_a_probability_that_settles_nothing(refused, verb, value):
    """Of the run that goes on until it is reached."""
    assert f"--until: expected a probability above 0.5 and below 1, found '{value}'" in refused(verb, '--until', value)


def test_a_demo_that_hides_nothing_settles_nothing(refused):
    """As with --open."""
    assert 'demo: --until goes with --hidden only; leave it out' in refused('demo', '--until', '0.95')
