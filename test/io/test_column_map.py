# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs, written by hand after their documentation, are read by a map of their columns."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from test_ball_centre_table import TABLE, parse, rows

from rosette_ros.cli import data
from rosette_ros.cli.main import main
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.typed_words import typed
from rosette_ros.io.ball_centre_table import parse_csv, read_csv
from rosette_ros.io.column_map import ColumnMap, format_columns
from rosette_ros.io.csv_parser import proposal_for, read_columns
from rosette_ros.io.foreign.formats import READERS


@pytest.fixture(autouse=True)
def as_a_command():
    """Errors name options, as in a shell; in Python arguments (test/api)."""
    with typed():
        yield


FOREIGN = Path(__file__).parent / 'foreign'
CENTRES = [[100.0012, 0.0004, -0.0011], [-50.0007, 86.6031, 0.0002], [-49.9993, -86.6022, 0.0008],
           [-50.0003, 86.6018, -0.0006], [-50.0009, -86.6027, 0.0005], [100.0004, -0.0013, 0.0009]]
TIMES = [0, 31, 62, 100, 131, 162]
COUNTED = [0, 1, 2, 3, 4, 5]
MAPS = {
    'calypso_chr.txt': ('name=id,axis=idsymbol,value=actual,pattern=Ball{ball}_T{table}', COUNTED),
    'pcdmis.csv': ('name=Feature,axis=Axis,value=Meas,pattern=POS{table}_SPH{ball}', COUNTED),
    'plain.csv': ('ball=Kugel,angle=Drehwinkel [°],time=Zeit,x=X,y=Y,z=Z', TIMES),
    'fields.dfq': ('axis=K2002,value=K0001,time=K0004,table=Table,ball=Ball', TIMES),
    'values.dfq': ('time=K0004,name=K2002,value=K0001,pattern=Kugel{ball}_Tisch{table}.{axis}', TIMES),
    'results.qif': ('time=TimeStamp,x=x,y=y,z=z,name=FeatureName,pattern=P{table} Ball {ball}', TIMES)}


@pytest.mark.parametrize('name', MAPS)
def test_a_table_of_another_program_is_read_by_its_map(name, tmp_path, capsys):
    """Two of three table positions of three balls, in mm and inch; the map is written, and read again."""
    words, times = MAPS[name]
    path, file = FOREIGN / name, tmp_path / 'map.yaml'
    given = f'{words},radius_mm=100,balls=3'
    assert main(['import', str(path), '--columns', given, '--save', str(file)]) == 0
    assert f'evaluate {path} --columns {file}' in capsys.readouterr().out
    run = read_csv(path, read_columns(str(file)))
    assert (run.n, run.radius) == (3, 0.1)
    assert (run.table_position.tolist(), run.ball.tolist()) == ([1, 1, 1, 2, 2, 2], [1, 2, 3, 1, 2, 3])
    np.testing.assert_allclose(1e3 * run.centre, CENTRES, atol=2e-6)  # inches with 7 decimals
    assert run.time.tolist() == times
    assert any(one.startswith(f'columns were taken by a map: {words}') for one in run.notes)


@pytest.mark.parametrize('name', MAPS)
def test_the_columns_are_proposed(name):
    """From the names of the columns and of the features; the error of a command says the whole proposal, once."""
    words, _ = MAPS[name]
    found = proposal_for((FOREIGN / name).read_bytes(), name)
    assert {**found.entries, 'radius_mm': ''} == dict(one.split('=') for one in f'{words},radius_mm='.split(','))
    with pytest.raises(InvalidData, match=re.escape('expected "# schema: rosette-ball-centres/1" and "# radius_mm: '
                                                    '...", '
                       'the nominal radius of the circle of ball centres, in the first lines, the columns ')) as caught:
        read_csv(FOREIGN / name)
    assert re.search(r"; if these are ball centres, try: rosette import \S+ --columns ('.*'|[\w=,.]+) --save map.yaml$",
                     str(caught.value))


@pytest.mark.parametrize(('name', 'words'), [
    ('calypso_chr.txt', 'CALYPSO characteristics'), ('fields.dfq', 'Q-DAS K-fields (AQDEF)'),
    ('values.dfq', 'Q-DAS K-fields (AQDEF)'), ('results.qif', 'QIF results'),
    ('plain.csv', None), ('pcdmis.csv', None)])
def test_a_file_has_one_format(name, words):
    """One reader takes it, whatever the order of the readers; the notes say which."""
    text = (FOREIGN / name).read_text()
    assert [one for one, read in READERS.items() if read(text, name)] == ([words] if words else [])
    notes = read_csv(FOREIGN / name, read_columns(f'{MAPS[name][0]},radius_mm=100,balls=3')).notes
    assert [one for one in notes if one.startswith('the file was read as')] == (
        [f'the file was read as {words}'] if words else [])


def test_a_map_says_all_that_is_missing_at_once():
    """Of columns and of the heading; of columns that the file has not; of patterns that no name fits."""
    data_of = (FOREIGN / 'plain.csv').read_bytes()
    for words, error in (
            ('x=X,y=Y', 'in the first lines, the columns table_position, ball, z_mm, found x_mm,y_mm; say all of it '
                        'in'),
            ('x=XX,y=Y,z=ZZ', 'line 2: expected the columns XX, ZZ of --columns, found Kugel,X,Y,Z'),
            ('x', 'x: expected a file of columns that can be read'), ('x=X,y', "expected quantity=column,..., found "
                                                                               "'y'"),
            ('x=X,x=Y', 'expected each quantity once'), ('xx=X,y=Y', "'xx'"), ('x=X,pattern={bal}', "pattern: .*'bal'"),
            ('name=Kugel,pattern=K{ball},x=X,y=Y,z=Z', "line 3: expected names such as 'K{ball}', found '3'")):
        with pytest.raises(InvalidData, match=error):
            parse_csv(data_of, 'plain.csv', read_columns(words))


def test_a_unit_in_the_name_of_a_column_is_told_as_it_stands(tmp_path, capsys):
    """Square brackets are no markup."""
    table = tmp_path / 'units.csv'
    table.write_text('N,T,X [mm],Y [mm],Z [mm]\n' + '\n'.join(
        f'{ball},{place},{x},{y},{z}' for ball, place, (x, y, z) in zip((1, 2, 3) * 2, (1, 1, 1, 2, 2, 2), CENTRES)),
        encoding='utf-8')
    columns = 'ball=N,table=T,x=X [mm],y=Y [mm],z=Z [mm],radius_mm=100,balls=3'
    assert main(['import', str(table), '--columns', columns, '-o', str(tmp_path / 'log')]) == 0
    assert f'map: {columns}' in ' '.join(capsys.readouterr().out.split())


def test_a_clockwise_angle_and_other_units():
    """A minus sign before the column turns it; what the map says of a unit or the radius counts, the heading less."""
    text = '# radius_mm: 1\nN;X;Y;Z;R\n' + '\n'.join(
        f'{ball};{x / 10};{y / 10};{z / 10};{-angle}' for ball, angle, (x, y, z) in zip(
            (1, 2, 3, 1, 2, 3), (0, 0, 0, 120, 120, 120), CENTRES))
    run = parse_csv(text.encode(), 't.csv', read_columns('ball=N,x_cm=X,y_cm=Y,z_cm=Z,angle=-R,radius_cm=10,balls=3'))
    assert run.table_position.tolist() == [1, 1, 1, 2, 2, 2] and run.radius == pytest.approx(0.1)
    np.testing.assert_allclose(1e3 * run.centre, CENTRES, atol=1e-12)


def test_values_without_a_measurement_are_passed_over():
    """AQDEF: attributes 255 and 256; QIF: spheres without a place, text that is no XML, units of none."""
    fields = (FOREIGN / 'fields.dfq').read_text()
    columns = read_columns(f'{MAPS["fields.dfq"][0]},radius_mm=100,balls=3')
    more = fields + 'K0001/1 2\nK0002/1 256\nK0001/2 2\nK0002/2 256\n'
    assert parse_csv(more.encode(), 'f', columns).size == 6
    with pytest.raises(InvalidData, match='K2142: expected one unit of all coordinates, found inch, mm'):
        parse_csv(fields.replace('K2142/5 mm', 'K2142/5 inch').encode(), 'f', columns)
    qif = (FOREIGN / 'results.qif').read_text()
    columns = read_columns(f'{MAPS["results.qif"][0]},radius_mm=100,balls=3')
    with pytest.raises(InvalidData, match='expected QIF .XML., found text that is none: '):
        parse_csv(qif[:-20].encode(), 'f', columns)
    with pytest.raises(InvalidData, match='LinearUnit: expected one of mm, cm, m, um, inch, found 0.3048 m'):
        parse_csv(qif.replace('0.0254', '0.3048').encode(), 'f', columns)
    with pytest.raises(InvalidData, match='expected QIF results with measured spheres'):
        parse_csv(qif.replace('Sphere', 'Circle').encode(), 'f', columns)
    with pytest.raises(InvalidData, match='line 41: column ball'):
        parse_csv(qif.replace('P2 Ball 1', 'P2 Ball 4').encode(), 'f', columns)


@pytest.mark.parametrize(('change', 'words'), [
    (('100,0012;0,0004;-0,0011;0;', '100,0012;0,0004;-0,0011;x;'), 'column table_'), (('\n1;', '\nA;'), 'column'),
    (('-0,0011;0;28', '-0,0011;inf;28'), 'column table_'),
    (('-0,0011;0;28.11.2026 08:00:00', '-0,0011'), 'column table_')])
def test_cells_that_are_none_are_refused_where_they_stand(change, words):
    """An angle, a number of a ball that is no number; a row that ends early is no reading."""
    text = (FOREIGN / 'plain.csv').read_text().replace(*change)
    with pytest.raises(InvalidData, match=f'p.csv: line 3: {words}'):
        parse_csv(text.encode(), 'p.csv', read_columns(f'{MAPS["plain.csv"][0]},radius_mm=100,balls=3'))


def test_the_dialogue_asks_on_a_terminal_only(monkeypatch, tmp_path, capsys):
    """Enter takes what is proposed, another answer counts, - leaves out; a table of our own is not asked about."""
    path, file = FOREIGN / 'plain.csv', tmp_path / 'map.yaml'
    answers = {'radius': '100', 'table angle': '', 'temperature': '-', 'frame': ''}
    asked = []

    def answer(question):
        asked.append(question)
        return next((text for key, text in answers.items() if question.startswith(key)), '')

    monkeypatch.setattr('builtins.input', answer)
    assert main(['import', str(path), '--save', str(file)]) == 2
    assert not asked and 'try: rosette import' in capsys.readouterr().err
    for stream in ('stdin', 'stdout'):
        monkeypatch.setattr(f'sys.{stream}.isatty', lambda: True)
    assert data.asked_columns(str(path)).heading == {'radius_mm': '100'}
    assert any('[Drehwinkel [°]]' in one for one in asked)
    told = capsys.readouterr().out
    assert 'Enter takes what stands in [brackets], - leaves it out.' in told and 'Kugel;X;Y;Z;Drehwinkel [°]' in told
    made = data.asked_columns(str(path))
    assert read_columns(str(_written(file, format_columns(made)))) == made
    count = len(asked)
    assert data.asked_columns(str(_written(tmp_path / 'own.csv', TABLE))) is None and len(asked) == count


def _written(path, text):
    path.write_text(text)
    return path


def test_dates_are_seconds_since_the_first():
    """ISO 8601 with a space, T, fractions and a zone, day.month.year; mixed ones are refused as before."""
    for form in ('2026-11-27 08:{:02d}:00', '2026-11-27T08:{:02d}:00+01:00', '20261127T08{:02d}00.0',
                 '7.3.2026 08:{:02d}', '27.11.2026/08:{:02d}:00'):
        text = rows(lambda cells, form=form: [*cells[:8], form.format(int(float(cells[8]) // 30)), *cells[9:]])
        run = parse(text.replace('time_s', 'time'))
        assert run.time.tolist() == [60 * (one // 30) for one in parse(TABLE).time.tolist()], form
        assert 'dates with time of day were taken as seconds since the first' in run.notes
    mixed = rows(lambda cells: [*cells[:8], f'2026-11-27 08:00:00{"Z" * (int(cells[0]) % 2)}', *cells[9:]])
    with pytest.raises(InvalidData, match='line 5: column time_s: expected a time with a zone, as in the rows b'):
        parse(mixed)


def test_names_of_features_are_matched_in_one_go():
    """A pattern of many * and numbers against names that nearly fit; each * ends where what follows comes first."""
    text = 'Feature\tX\tY\tZ\n' + ''.join(f'{"1a" * 28}1{end}\t1\t2\t3\n' for end in ('a', 'b0', 'b1', 'c'))
    started = time.process_time()
    assert proposal_for(text.encode(), 'r.csv').pattern.count('*') == 27
    with pytest.raises(InvalidData, match='expected names such as'):
        parse_csv(text.encode(), 'r.csv', read_columns(
            f'x=X,y=Y,z=Z,name=Feature,pattern={"*a" * 25}{{ball}}x{{table}},radius_mm=100'))
    assert time.process_time() - started < 5


@pytest.mark.parametrize(('pattern', 'name', 'found'), [
    ('*B{ball}*T{table}', 'xB12 A3 T4', {'ball': '12', 'table': '4'}), ('B{ball}01', 'B1201', {'ball': '12'}),
    ('*{ball}*{table}', 'K1 B2', {'ball': '1', 'table': '2'}), ('{axis}value', 'Xvalue', {'axis': 'X'}),
    ('B{ball} {angle}', 'b3 -12,5', {'ball': '3', 'angle': '-12,5'}), ('B{ball}', 'B1b', None), ('a*a', 'a', None)])
def test_what_a_pattern_takes_of_a_name(pattern, name, found):
    """Numbers as a whole, letters large or small, any text for *, and nothing beside."""
    columns = ColumnMap({'name': 'N'}, pattern)
    if found:
        assert columns.readings(['N'], [(1, [name])], '') == ([(1, found)], 0)
    else:
        with pytest.raises(InvalidData, match='line 1: expected names such as'):
            columns.readings(['N'], [(1, [name])], '')


def test_a_pattern_says_each_number_once():
    """Before anything is read with it."""
    with pytest.raises(InvalidData, match=r"--columns: pattern: expected {ball} once, found '{ball}{ball}'"):
        read_columns('x=X,y=Y,z=Z,name=N,pattern={ball}{ball}')


def test_calypso_as_it_is_written_today():
    """xValue, yValue, zValue of a feature among rows of its diameter and form, END behind; proposed, and counted."""
    names = ('planid', 'id', 'idsymbol', 'actual', 'featureid')
    rows = [(f'Ball{ball}_T{table}', symbol, value) for (ball, table), place in zip(
        ((1, 1), (2, 1), (3, 1), (1, 2), (2, 2), (3, 2)), CENTRES)
        for symbol, value in zip(('xValue', 'yValue', 'zValue', 'diameter', 'sphereForm'), (*place, 15.0003, 2e-4))]
    text = '\n'.join(['\t'.join(names), *(
        f'P\t{name}_{symbol}\t{symbol}\t{value}\t{name}' for name, symbol, value in rows), 'END', ''])
    made = proposal_for(text.encode(), 'chr.txt')
    assert made.words().startswith('name=featureid,axis=idsymbol,value=actual,pattern=Ball{ball}_T{table},radius_mm=')
    run = parse_csv(text.encode(), 'chr.txt', read_columns(f'{made.words()},balls=3'))
    np.testing.assert_allclose(1e3 * run.centre, CENTRES, atol=1e-9)
    assert 'passed over: 12 rows of other features' in run.notes


def test_a_row_for_each_quantity_by_its_name_is_proposed():
    """Q-DAS value sets of Table, Ball, X, Y, Z: no name of a feature says which ball it is."""
    rows = [f'{name};{value}' for (table, ball), place in zip(
        ((1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)), CENTRES)
        for name, value in zip(('Table', 'Kugel', 'X', 'Y', 'Z'), (table, ball, *place))]
    text = '\n'.join(['Characteristic;Value', *rows, ''])
    made = proposal_for(text.encode(), 'v.csv')
    assert made.words().startswith('table=Table,ball=Kugel,value=Value,axis=Characteristic,radius_mm=')
    run = parse_csv(text.encode(), 'v.csv', read_columns(f'{made.words()},balls=3'))
    assert run.table_position.tolist() == [1, 1, 1, 2, 2, 2] and run.ball.tolist() == [1, 2, 3, 1, 2, 3]


def test_numbers_of_formats_that_are_none():
    """A factor of QIF that is a word; a characteristic of AQDEF beyond any."""
    qif = (FOREIGN / 'results.qif').read_text()
    with pytest.raises(InvalidData, match='LinearUnit: expected one of mm, cm, m, um, inch, found abc m'):
        parse_csv(re.sub('<Factor>[^<]*</Factor>', '<Factor>abc</Factor>', qif).encode(), 'f')
    fields = (FOREIGN / 'fields.dfq').read_text() + f'K2001/{"9" * 5000} 1\n'
    assert parse_csv(fields.encode(), 'f', read_columns(f'{MAPS["fields.dfq"][0]},radius_mm=100,balls=3')).size == 6


def test_a_qdas_pair_is_read_together(tmp_path):
    """Descriptions and values in two files, whichever is named; errors name file and line of the values."""
    fields = (FOREIGN / 'fields.dfq').read_text().splitlines()
    values, pair = [], {'.dfd': [], '.DFX': []}
    for line in fields:
        key, _, value = line.partition(' ')
        if key.startswith('K0001/'):
            values.append(value)
        elif key == 'K0004/0':
            pair['.DFX'].append('\x0f'.join(f'{one}\x140\x14{value}\x14#0\x14' for one in values))
            values = []
        else:
            pair['.dfd'].append(line)
    for end, lines in pair.items():
        (tmp_path / f'table{end}').write_bytes('\r\n'.join(['K1110 Müller'] * (end == '.dfd') + lines).encode('cp1252'))
    words = f'{MAPS["fields.dfq"][0]},radius_mm=100,balls=3'
    for end in pair:
        run = read_csv(tmp_path / f'table{end}', read_columns(words))
        np.testing.assert_allclose(1e3 * run.centre, CENTRES, atol=1e-9)
        assert run.time.tolist() == TIMES and 'the file was read as Q-DAS K-fields (AQDEF)' in run.notes
    text = (tmp_path / 'table.DFX').read_bytes()
    (tmp_path / 'table.DFX').write_bytes(text.replace(b'86,6031', b'86,60x'))
    with pytest.raises(InvalidData, match=r'table\.DFX: line 2: .*86,60x'):
        read_csv(tmp_path / 'table.dfd', read_columns(words))
    (tmp_path / 'table.DFX').unlink()
    with pytest.raises(InvalidData, match=r'table\.dfd: expected a Q-DAS pair, .* found no table\.dfx beside it'):
        read_csv(tmp_path / 'table.dfd', read_columns(words))
    with pytest.raises(InvalidData, match='none.dfd: expected a table that can be read, found No such file'):
        read_csv(tmp_path / 'none.dfd')


def test_what_to_export_is_said():
    """A QIF document with two results of the same spheres, and a report of PC-DMIS as text."""
    qif = (FOREIGN / 'results.qif').read_text()
    begin, end = qif.index('<MeasurementResults id'), qif.index('</MeasurementResults>') + len('</MeasurementResults>')
    again = qif[begin:end].replace('"30"', '"31"')
    with pytest.raises(InvalidData, match='the same ones in those with id 30 and 31; export each run to a file of its'):
        parse_csv((qif[:end] + again + qif[end:]).encode(), 'f')
    parts = qif[:end] + again.replace('Sphere', 'Circle') + qif[end:]  # other features of the same run
    assert parse_csv(parts.encode(), 'f', read_columns(f'{MAPS["results.qif"][0]},radius_mm=100,balls=3')).size == 6
    report = ('PART NAME  : Rosette\n\nDIM LOC1= LOCATION OF SPHERE POS1_SPH1  UNITS=MM ,$\nGRAPH=OFF  TEXT=OFF\n'
              'AX      NOMINAL       MEAS\nX      182.5000   182.5263\nEND OF DIMENSION LOC1\n')
    with pytest.raises(InvalidData, match='found a PC-DMIS report as text; export the locations as CSV'):
        parse_csv(report.encode(), 'f')
