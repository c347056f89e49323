# SPDX-License-Identifier: Apache-2.0
"""The ball-centre table: nothing changes on the way out and in, and bad tables are told apart."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosette_ros.analysis import analyse
from rosette_ros.core.run.errors import InvalidData, RosetteError
from rosette_ros.core.run.geometry import Frame, rotation_matrix
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import ORDERS, plan
from rosette_ros.io.ball_centre_table import format_csv, parse_csv, read_csv, write_csv

FEMTOMETRE = 1e-15
LAST_BIT = 1e-15  # rad, at one turn

TABLE = """\
# schema: rosette-ball-centres/1
# radius_mm: 100
seq,table_position,ball,cmm_position,table_angle_deg,x_mm,y_mm,z_mm,time_s,temperature_C,approach
1,1,1,1,0,100,0,0,0,20.1,1
2,1,2,2,0,-50,86.6,0,30,20.1,1
3,1,3,3,0,-50,-86.6,0,60,20.1,1
4,2,1,2,120,-50,86.6,0,90,20.2,1
5,2,2,3,120,-50,-86.6,0,120,20.2,1
6,2,3,1,120,100,0.1,0,150,20.2,1
7,3,1,3,240,-50,-86.6,0,180,20.3,1
8,3,2,1,240,100,0,0,210,20.3,1
9,3,3,2,240,-50,86.6,0,240,20.3,1
"""


def parse(text):
    """Return the Run of a text."""
    return parse_csv(text.encode(), 'some.csv')


def changed(line, old, new):
    """Return TABLE with a change in one line (counted from 1)."""
    lines = TABLE.splitlines()
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    return '\n'.join(lines)


def rows(change):
    """Return TABLE with `change` applied to the cells of every row."""
    lines = TABLE.splitlines()
    return '\n'.join(lines[:3] + [','.join(change(line.split(','))) for line in lines[3:]])


@st.composite
def runs(draw):
    """Runs of any order, complete or not, with actual or nominal angles."""
    n = draw(st.integers(3, 9))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    scheme = plan(n, draw(st.sampled_from(sorted(ORDERS))), seed=1,
                  turning=draw(st.sampled_from(['forward', 'alternate'])))
    size = scheme.ball.size
    angle = scheme.table_angle
    if draw(st.booleans()):
        angle = angle + 1e-5 * rng.standard_normal(size)
    time = np.cumsum(draw(st.sampled_from([1e-9, 1.0, 31.7, 1e5])) * rng.random(size))
    temperature = rng.uniform(15, 25, size)
    temperature[rng.random(size) < 0.2] = np.nan
    radius = draw(st.floats(0.01, 2))
    run = Run(
        n, radius, scheme.table_position, scheme.ball,
        scheme.centres(radius) + 1e-4 * radius * rng.standard_normal((size, 3)),
        table_angle=angle, time=time, temperature=temperature, approach=scheme.approach,
        repeats=scheme.repeats, repeatability=draw(st.none() | st.floats(1e-9, 1e-5)), repeatability_dof=6.0,
        repeatability_axes=(1e-7, 1.3e-7, 1 / 3e6),
        run_id=draw(st.sampled_from(['', 'rosette_20250101_diagonal', 'Prüfung 3: µm'])))
    keep = np.sort(rng.permutation(size)[:draw(st.integers(3, size))])
    return run if draw(st.booleans()) else run.take(keep)


@settings(max_examples=60, deadline=None)
@given(runs())
def test_round_trip_changes_nothing_that_can_be_measured(run):
    """Coordinates to 1e-15 m, angles to the last bit, everything else exactly."""
    text = format_csv(run)
    back = parse(text)
    assert np.abs(back.centre - run.centre).max() <= FEMTOMETRE
    assert np.abs(back.table_angle - run.table_angle).max() <= LAST_BIT
    for name in ('table_position', 'ball', 'time', 'temperature', 'approach'):
        assert getattr(back, name).tobytes() == getattr(run, name).tobytes(), name
    assert np.ptp(back.table_travel - run.table_travel) <= 1e-12 * max(1, np.ptp(run.table_travel))
    assert (back.n, back.radius, back.run_id) == (run.n, run.radius, run.run_id)
    if run.repeatability is None:
        assert back.repeatability is None
    else:
        assert back.repeatability == pytest.approx(run.repeatability, rel=1e-15)
        assert back.repeatability_dof == 6.0
        assert back.repeatability_axes == pytest.approx(run.repeatability_axes, rel=1e-15)
    assert parse(format_csv(back)).centre.tobytes() == back.centre.tobytes()


def test_heading_and_columns_are_those_of_the_contract():
    """Names, order, 12 decimals of a millimetre."""
    lines = format_csv(parse(TABLE)).splitlines()
    assert lines[:2] == ['# schema: rosette-ball-centres/1', '# radius_mm: 100']
    assert TABLE.splitlines()[2] in lines
    assert lines[-1].split(',')[5:8] == ['-50.000000000000', '86.600000000000', '0.000000000000']


@pytest.mark.parametrize('decimals', range(6))
@pytest.mark.parametrize('n', [7, 11, 16, 360])
def test_few_decimals_mean_the_nominal_angle(n, decimals):
    """51.43 is 360/7: without this a false error motion of 25 µrad appears."""
    scheme = plan(n, 'column').table_position[:n]
    centre = plan(n, 'column').centres(0.1)[:n]
    run = Run(n, 0.1, scheme, np.ones(n, int), centre)
    text = format_csv(run)
    head, table = text.split('approach\n')
    cells = [line.split(',') for line in table.splitlines()]
    for position, row in enumerate(cells):
        row[4] = f'{360 * position / n:.{decimals}f}'
    back = parse(head + 'approach\n' + '\n'.join(map(','.join, cells)))
    assert back.table_angle.tobytes() == run.table_angle.tobytes()


def test_more_decimals_mean_the_actual_angle():
    """120.0003 is not 120; 120.0003 within half a unit of its last decimal is not either."""
    run = parse(changed(7, ',120,', ',120.0003,'))
    assert run.table_angle[3] == np.deg2rad(120.0003)
    assert run.table_angle[4] == 2 * np.pi / 3
    run = parse(changed(7, ',120,', ',1.200003e2,'))
    assert run.table_angle[3] == np.deg2rad(120.0003)
    run = parse(changed(7, ',120,', ',1.2e2,'))
    assert run.table_angle[3] == 2 * np.pi / 3


def test_angles_may_be_in_any_turn():
    """-120° and 480° are the table positions 3 and 2."""
    run = parse(rows(lambda cells: [*cells[:4], {'240': '-120', '120': '480'}.get(
        cells[4], cells[4]), *cells[5:]]))
    np.testing.assert_allclose(run.table_angle[[3, 6]], np.deg2rad([480, -120]), rtol=1e-15)
    assert run.angle_deviation.max() < LAST_BIT


def test_travel_that_cannot_be_told_is_written():
    """A table that went back to approach from below: angles alone would add a turn."""
    run = parse(TABLE)
    assert 'travel' not in format_csv(run)
    travel = np.deg2rad([0, 0, 0, 120, 120, 120, -120, -120, -120.0])
    back = parse(format_csv(run.replace(table_travel=travel)))
    np.testing.assert_allclose(back.table_travel, travel, atol=1e-15)


def test_what_is_optional_may_be_missing():
    """cmm_position, temperature_C and approach; then they are unknown."""
    lines = [line.split(',') for line in TABLE.splitlines()]
    text = '\n'.join(','.join(cells[:3] + cells[4:9]) if len(cells) > 1 else cells[0]
                     for cells in lines)
    run = parse(text)
    assert np.isnan(run.temperature).all()
    assert not run.approach.any()
    assert parse(changed(5, '20.1,1', ' ,')).approach[1] == 0


def test_spreadsheets_are_understood(tmp_path):
    """Byte-order mark, CRLF, quotes, empty lines, other order of columns, +1, 3.0."""
    lines = TABLE.splitlines()
    table = [','.join(f'"{cell}"' for cell in line.split(',')[::-1]) for line in lines[2:]]
    text = '\r\n'.join([*lines[:2], '', *table[:4], '', *table[4:], '', ''])
    path = tmp_path / 'table.csv'
    path.write_bytes(b'\xef\xbb\xbf' + text.replace('"1"', '"+1.0"').encode())
    assert read_csv(path).centre.tobytes() == parse(TABLE).centre.tobytes()


def test_incomplete_run_has_the_balls_of_its_heading():
    """The last ball was never measured: the heading tells that there is one."""
    lines = TABLE.splitlines()
    text = '\n'.join([lines[0], '# balls: 3', *lines[1:3],
                      *(line for line in lines[3:] if line.split(',')[2] != '3')])
    run = parse(text)
    assert (run.n, run.size) == (3, 6)


def test_planned_repeats_are_allowed_by_the_heading():
    """Otherwise a pair that stands twice is an error."""
    again = TABLE + '10,1,1,1,0,100,0,0,300,20,1\n'
    assert parse('# repeated_balls: yes\n' + again).size == 10
    assert parse(format_csv(parse('# repeated_balls: yes\n' + again))).repeats


WRONG = {
    'missing column': (changed(3, 'y_mm,', ''), 'line 3: expected the column y_mm, found seq,'),
    'missing columns': (changed(3, 'ball,', 'b,').replace('z_mm,', 'depth,'),
                        'line 3: expected the columns ball, z_mm, found'),
    'both decimal signs': (changed(5, '86.6', '86,6').replace(',', ';').replace('86;6', '86,6'), "expected a number, "
                                                                                                 "found "
                           "'-86.6'; the coordinates have decimal commas; write all numbers so, and no sign between"),
    'comma for decimals or thousands': (
        TABLE.replace('.1,', ',').replace('86.6', '87').replace('0.1', '0').replace('.2,', ',').replace('.3,', ',')
        .replace(',', ';').replace('240;', '1,240;').replace('210;', '1,210;'),
        "expected a number, found '1,2[14]0'; the coordinates have decimal points; write all numbers so, and no sign"),
    'machine frame misspelt': ('# frame: maschine\n' + TABLE, "line 1: expected frame: table or machine, found "
                                                              "'maschine'"),
    'unknown column': (changed(3, 'temperature_C', 'temperatur_C'),
                       "line 3: expected the column temperature_C, found 'temperatur_C'; rename it"),
    'column twice': (changed(3, 'y_mm', 'x_mm').replace('z_mm', 'z_mm,y_mm'),
                     "line 3: column x_mm: expected it once, found it again as 'x_mm'"),
    'word': (changed(5, '86.6', 'oops'), "line 5: column y_mm: expected a number, found 'oops'"),
    'decimal comma': (changed(5, '86.6', '86,6'), 'line 5: expected 11 cells, found 12; write decimals'),
    'underscore': (changed(5, '86.6', '8_6.6'), "column y_mm: expected a number, found '8_6.6'"),
    'other digits': (changed(5, '86.6', '٨٦'), "line 5: column y_mm: expected a number, found '٨٦'"),
    'empty cell': (changed(5, '86.6', ''), "line 5: column y_mm: expected a number, found ''"),
    'nan': (changed(6, '-86.6', 'NaN'), "line 6: column y_mm: expected a finite number, found nan; "
            'leave out the row of a ball that was not measured'),
    'inf': (changed(6, '60', '-inf'), "line 6: column time_s: expected a finite number, found -inf"),
    'nan temperature': (changed(6, '20.1', 'nan'), "column temperature_C: expected a finite number, found nan; "
                        'leave the cell empty where it is not known'),
    'not whole': (changed(4, '1,1,1,1', '1,1.5,1,1'),
                  "line 4: column table_position: expected a whole number, found 1.5"),
    'zero-based': (changed(4, '1,1,1,1', '1,0,1,1'),
                   'line 4: column table_position: expected at least 1, found 0; indices count from 1'),
    'ball out of range': (changed(12, '9,3,3,2', '9,3,4,2'), 'line 12: column ball: expected at most '
                          '3, as far as table_position goes, found 4; as many table positions as'),
    'ball beyond heading': ('# balls: 3\n' + changed(12, '9,3,3,2', '9,3,4,2'),
                            r'line 13: column ball: expected 1..3, found 4; the heading says "# balls'),
    'huge index': (changed(12, '9,3,3,2', '9,99999999,99999999,2'),
                   'expected 3 to 10000 balls, found 99999999'),
    'n disagrees': ('# balls: 4\n' + TABLE, r'expected a run with 4 balls, as the heading says '
                    r'\("# balls: 4"\), found a complete one with 3; correct the heading'),
    'two balls': ('# balls: 2\n' + TABLE, 'expected 3 to 10000 balls, found 2'),
    'duplicate': (changed(12, '9,3,3,2', '9,3,2,1'), 'line 12: expected each pair of table position '
                  r'and ball once, found table_position 3, ball 2 again \(first in line 11\); remove '
                  'one, or say "# repeated_balls: yes"'),
    'cmm position': (changed(8, '5,2,2,3', '5,2,2,1'), 'line 8: column cmm_position: expected 3 for '
                     r'table_position 2, ball 2 of 3: \(i \+ j - 2\) mod n \+ 1, found 1'),
    'radians': (rows(lambda cells: [*cells[:4], f'{np.deg2rad(float(cells[4])):.6f}', *cells[5:]]),
                'line 7: column table_angle_deg: expected about 120 for table_position 2 of 3, found '
                '2.094395; these are radians; write degrees'),
    'clockwise': (rows(lambda cells: [*cells[:4], str(-float(cells[4])), *cells[5:]]),
                  'line 7: .* the table counts clockwise'),
    'one angle': (changed(7, ',120,', ',12,'), 'line 7: column table_angle_deg: expected about 120 '
                  'for table_position 2 of 3, found 12; is the number of balls right'),
    'time back': (changed(9, '150', '119'), 'line 9: column time_s: expected at least 120, the row '
                  'before, found 119; rows stand in the order of measuring'),
    'seq back': (changed(9, '6,2', '5,2'), 'line 9: column seq: expected more than 5, the row before'),
    'approach': (changed(9, '20.2,1', '20.2,2'),
                 r'line 9: column approach: expected 1, -1 or 0 \(unknown\), found 2'),
    'no schema': (TABLE.partition('\n')[2], 'expected "# schema: rosette-ball-centres/1" in the first lines, found '
                                            'none; '
                  'add that line; `rosette plan --balls 12 --radius-mm 182.5 --order diagonal --csv-template` prints'),
    'other schema': (changed(1, '/1', '/2'), "line 1: expected .*, found 'rosette-ball-centres/2'"),
    'no radius': (TABLE.replace('# radius_mm: 100\n', ''), 'expected "# radius_mm: ...", the nominal'),
    'radius word': (changed(2, '100', 'wide'), "line 2: expected radius_mm: a positive number, found 'w"),
    'radius sign': (changed(2, '100', '-100'), 'line 2: expected radius_mm: a positive number'),
    'other frame': (rows(lambda cells: [*cells[:5], str(float(cells[5]) + 400), *cells[6:]]),
                    r'line 4: column x_mm, y_mm, z_mm: expected a place near \(100.000, 0.000, 0\) '
                    r'for table_position 1, ball 1, found \(500.000, 0.000, 0.000\)'),
    'key twice': ('# radius_mm: 5\n' + TABLE, r'line 3: expected radius_mm once, found it again \(first '
                  r'in line 1\)'),
    'misspelt key': ('# repeatability: 5\n' + TABLE, "line 1: expected the key repeatability_um, found "
                     "'# repeatability: 5'; correct it"),
    'yes or no': ('# repeated_balls: 1\n' + TABLE, 'expected repeated_balls: yes or no, found'),
    'simulated': ('# simulated: 1\n' + TABLE, 'expected simulated: yes or no, found'),
    'balls not whole': ('# balls: 3.5\n' + TABLE, 'line 1: expected balls: a whole number, found'),
    'short row': (TABLE.rstrip()[:-8], 'line 12: expected 11 cells, found 9; is the row cut off'),
    'late remark': (TABLE + '# end\n', "line 13: expected a reading, found '# end'"),
    'too wide': (TABLE.replace('approach\n', f'approach{"," * 10_000}\n'),
                 'line 3: expected at most 10000 columns, found 10011; save those that are needed'),
    'tiny repeatability': ('# repeatability_um: 1e-300\n' + TABLE, 'expected repeatability_um: a positive number, '
                                                                   'found'),
    'open quote': (changed(5, '86.6', '"86.6'), 'line 5: expected cells with closed quotes'),
    'only heading': ('\n'.join(TABLE.splitlines()[:2]), 'expected a line with the names of the col'),
    'no rows': ('\n'.join(TABLE.splitlines()[:3]), 'expected rows of ball centres, found none'),
    'empty': ('', 'some.csv: is empty; expected a table of ball centres'),
    'blank': (' \n\n', 'some.csv: is empty'),
}


@pytest.mark.parametrize('name', sorted(WRONG))
def test_wrong_tables_are_refused_with_words(name):
    """Where, what was wanted, what came, what to do."""
    text, words = WRONG[name]
    with pytest.raises(InvalidData, match=words) as caught:
        parse(text)
    assert str(caught.value).startswith('some.csv: ')
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('data', 'words'), [
    (b'\x89MCAP0\r\n\0\0', 'some.csv: is a binary file, or text in UTF-16; expected a table of ball centres as text'),
    (TABLE.replace('5,2,2,3', '5,2,2,ä').encode('latin-1'), "line 8: column cmm_position: expected a number, found "
                                                            "'ä'"),
])
def test_other_files_are_refused_with_words(data, words):
    """Binary, or another encoding."""
    with pytest.raises(InvalidData, match=words):
        parse_csv(data, 'some.csv')


@settings(max_examples=150, deadline=None)
@given(place=st.integers(0, len(TABLE) - 1), length=st.integers(0, 12),
       text=st.text(alphabet='0123456789.,-+eE#":;\n nainfx_é\0\u2028', max_size=8))
def test_changed_tables_never_end_in_another_error(place, length, text):
    """Whatever stands in the file: a Run or one clear line."""
    try:
        parse(TABLE[:place] + text + TABLE[place + length:])
    except RosetteError as error:
        assert str(error).startswith('some.csv: ')
        assert '\n' not in str(error)


def test_file_is_written_once_and_whole(tmp_path):
    """An existing file is kept; --force replaces it; nothing is left beside it."""
    run, path = parse(TABLE), tmp_path / 'table.csv'
    write_csv(run, path)
    with pytest.raises(InvalidData, match='table.csv: exists already; take another name or use force=True'):
        write_csv(run.take([0, 1]), path)
    assert read_csv(path).size == 9
    write_csv(run.take([0, 1]), path, force=True)
    assert path.read_text().count('\n') == 6
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InvalidData, match='cannot be written: No such file'):
        write_csv(run, tmp_path / 'nowhere' / 'table.csv')
    with pytest.raises(InvalidData, match='expected a table that can be read, found No such file'):
        read_csv(tmp_path / 'nothing.csv')


def test_a_run_id_cannot_write_lines_of_its_own():
    """Ids come from the wire: a line break in one must not become a heading."""
    run = parse(TABLE).replace(run_id='evil\n# balls: 7\n1,1')
    assert parse(format_csv(run)).run_id == 'evil # balls: 7 1,1'
    assert len(re.findall('^# balls', format_csv(run), re.MULTILINE)) == 1


def test_remarks_and_other_peoples_columns_are_passed_over():
    """A remark, a key and a column that this format does not know do not matter."""
    text = '# measured by X\n# operator: Y\n' + TABLE
    lines = text.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith('seq'))
    lines = [f'{line},form' if k == at else f'{line},0.3' if k > at else line
             for k, line in enumerate(lines)]
    plain = parse_csv(TABLE.encode(), 'some.csv')
    rich = parse_csv('\n'.join(lines).encode(), 'some.csv')
    assert np.array_equal(plain.centre, rich.centre)


def test_pauses_survive_the_table():
    """`pauses_before` names the first row after each pause; it is written only where there is one."""
    session = np.array([1, 1, 2, 2, 3, 3, 3, 3, 3])
    run = parse_csv(TABLE.encode()).replace(session=session)
    text = format_csv(run)
    assert '# pauses_before: 3, 5\n' in text
    assert parse_csv(text.encode()).session.tolist() == session.tolist()
    assert 'pauses_before' not in format_csv(run.replace(session=None))


@pytest.mark.parametrize('cell', ['1', '10', 'x', '2.5', '-3', '9' * 30])
def test_pauses_that_are_no_rows_are_refused(cell):
    """In words: which line, which numbers."""
    text = TABLE.replace('\nseq,', f'\n# pauses_before: {cell}\nseq,')
    with pytest.raises(InvalidData, match=r'pauses_before: numbers of rows in 2\.\.9, separated by commas'):
        parse_csv(text.encode())


def same(run, other):
    """Return whether all numbers of two runs are the same."""
    return all(np.array_equal(getattr(run, name), getattr(other, name), equal_nan=True) for name in (
        'table_position', 'ball', 'centre', 'table_angle', 'time', 'temperature', 'approach', 'radius'))


PADDED = '\n'.join([*(line + ',' * (13 - line.count(',')) for line in TABLE.splitlines()), *3 * [13 * ',']])
GERMAN = TABLE.replace(',', ';').replace('.', ',').replace('radius_mm: 100', 'radius_mm: 100,0')
SHEETS = {
    'padded by Excel': (PADDED, ()),
    'quoted heading': (TABLE.replace('# radius_mm: 100', '"# radius_mm: 100",,'), ()),
    'semicolons': (TABLE.replace(',', ';'), ('the table was read with semicolons between cells',)),
    'tabs': (TABLE.replace(',', '\t'), ('the table was read with tabs between cells',)),
    'decimal commas': (GERMAN + 3 * (10 * ';' + '\n'), (
        'the table was read with semicolons between cells and decimal commas',)),
}


@pytest.mark.parametrize('text, notes', SHEETS.values(), ids=SHEETS)
def test_what_spreadsheets_save_is_read_and_said(text, notes):
    """The same numbers as of the plain table."""
    run = parse(text)
    assert same(run, parse(TABLE))
    assert run.notes == notes


def test_a_row_without_coordinates_is_a_ball_that_was_not_measured():
    """In any separator; a row with only some of them is a mistake."""
    text = changed(8, ',-50,-86.6,0,120,', ',,,,,')
    assert text.count('\n') == TABLE.rstrip().count('\n')
    for one in (text, text.replace(',', ';')):
        assert parse(one).size == 8
    with pytest.raises(InvalidData, match="line 8: column y_mm: expected a number, found ''"):
        parse(changed(8, ',-50,-86.6,0,120,', ',-50,,,120,'))


def test_coordinates_in_the_machine_frame_are_aligned():
    """The frame is fitted to the readings: the same curves; where the counting is mirrored, the axis points down."""
    rng = np.random.default_rng(3)
    scheme = plan(6, 'diagonal')
    centre = scheme.centres(0.1825) + rng.normal(0, 1e-6, (36, 3))
    run = Run(6, 0.1825, scheme.table_position, scheme.ball, centre, repeatability=1e-6)
    frame = Frame(rotation_matrix([0.3, -0.2, 2.0]), np.array([0.4, 0.1, -0.3]))
    moved = format_csv(run.replace(centre=frame.to_outer(centre))).replace('schema', 'frame: machine\n# schema', 1)
    found = parse(moved)
    words = ('the table frame was fitted to all readings; its axis, about which positions and balls are counted '
             'counter-clockwise, is ({}) in the machine frame')
    assert found.notes == (words.format(', '.join(f'{value:.3f}' for value in frame.rotation[:, 2])),)
    one, other = (analyse(run).error_motions for run in (run, found))
    np.testing.assert_allclose(other.values[:, :3], one.values[:, :3], rtol=0, atol=1e-10)
    np.testing.assert_allclose(other.values[:, 3:], one.values[:, 3:], rtol=0, atol=1e-9)
    mirrored = format_csv(run.replace(centre=centre * [1, -1, 1])).replace('schema', 'frame: machine\n# schema', 1)
    assert '-1.000) in the machine frame' in parse(mirrored).notes[0]
    with pytest.raises(InvalidData, match='expected a place near'):
        parse(mirrored.replace('frame: machine', 'frame: table'))
