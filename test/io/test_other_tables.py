# SPDX-License-Identifier: Apache-2.0
"""Tables as people and spreadsheets write them are read and said, or refused with what is wrong."""

import re

import numpy as np
import pytest
from test_ball_centre_table import TABLE, changed, parse, rows, same

from rosette_ros.cli.main import main
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Frame, rotation_matrix
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import format_csv, parse_csv
from rosette_ros.words.reading_words import remark_words


def columns_of(text, names):
    """Return TABLE with only some columns, under other names."""
    lines = [line.split(',') for line in text.splitlines()]
    chosen = [lines[2].index(column) for column in names]
    return '\n'.join([*map(','.join, lines[:2]), ','.join(names.values()),
                      *(','.join(cells[at] for at in chosen) for cells in lines[3:])])


FIVE = {'table_position': 'table_position', 'ball': 'ball', 'x_mm': 'x_mm', 'y_mm': 'y_mm', 'z_mm': 'z_mm'}
SPOKEN = {'table_position': 'Table Position', 'ball': 'Ball', 'x_mm': 'X', 'y_mm': 'y [mm]', 'z_mm': 'Z (mm)'}
ABSENT = ('not in the table: seq (the rows are taken in measuring order), table_angle_deg (the table angles are taken '
          'as the nominal ones), time_s (the readings are counted instead of seconds, and effects in time are per '
          'reading)')
EXPORTED = parse_csv(TABLE.encode()).replace(
    rotation=np.eye(3), session=[1, 1, 1, 2, 2, 2, 3, 3, 3], repeatability=1e-7, repeatability_axes=(9e-8, 1e-7, 2e-7),
    run_id='Prüfung')


def excel(text, separator=';', decimal=',', encoding='cp1252'):
    """Return a table as a spreadsheet with other signs saves it that has read it with commas between cells."""
    rows = [[re.sub(r'^ ?(-?[0-9]+)[.]([0-9]+)$', rf'\g<1>{decimal}\g<2>', cell) for cell in line.split(',')]
            for line in text.splitlines()]
    width = max(map(len, rows))
    return '\r\n'.join(separator.join([*row, *[''] * (width - len(row))]) for row in rows).encode(encoding)


def test_five_columns_suffice():
    """Angle, time and seq follow or are said to be missing; names as people write them are said; empty columns too."""
    plain = parse(TABLE)
    empty = rows(lambda cells: ['', *cells[1:4], '', *cells[5:8], '', '', ''])
    for text, words in ((columns_of(TABLE, FIVE), ()), (empty, ()), (columns_of(TABLE, SPOKEN), (
            "columns were read as follows: 'Table Position' as table_position, "
            "'Ball' as ball, 'X' as x_mm, 'y [mm]' as y_mm, "
            "'Z (mm)' as z_mm",)), ('# ' + columns_of(TABLE, FIVE).replace('\ntable_pos', '\n# table_pos')[2:], ())):
        run = parse(text)
        assert run.notes == (*words, ABSENT)
        assert run.centre.tobytes() == plain.centre.tobytes() and run.time.tolist() == list(range(9))
        assert run.table_angle.tolist() == plain.table_angle.tolist() and run.remarks == plain.remarks


def test_its_own_export_survives_spreadsheets():
    """Saved again with semicolons and decimal commas, tabs, each line as one cell, or below lines of a title."""
    text = format_csv(EXPORTED)
    assert all(one in text for one in ('axes_um', 'pauses', 'table_axis'))
    quoted = '\r\n'.join(f'"{line}"' if ',' in line else line for line in text.splitlines()).encode()
    titled = b'Messprotokoll;;\r\n;;\r\n' + excel(text)
    for data, words in (
            (excel(text), 'semicolons between cells and decimal commas'), (excel(text, '\t'), 'tabs between cells and'),
            (excel(text, ';', '.'), 'semicolons between cells'), (b'sep=;\r\n' + excel(text), 'and decimal commas'),
            (b'"sep=|"\r\n' + excel(text, '|'), "'|' between cells and decimal commas"), (quoted, 'one quoted cell'),
            (titled, "passed over above the names of the columns: 'Messprotokoll'"), (excel(text), 'Windows-1252'),
            (re.sub('(?m)$', ',', text).encode(), '')):
        run = parse_csv(data, 'some.csv')
        assert same(run, EXPORTED) and run.run_id == 'Prüfung', data[:200]
        assert run.repeatability_axes == EXPORTED.repeatability_axes and np.array_equal(run.session, EXPORTED.session)
        assert np.array_equal(run.rotation, np.eye(3)) and any(words in note for note in (*run.notes, ''))


def test_lengths_and_times_may_have_units_of_their_own():
    """By the name of the column or of radius_...; the factor is said."""
    plain = parse(TABLE)
    for unit, factor in (('cm', 10), ('m', 1000), ('um', 1e-3), ('inch', 25.4), ('in', 25.4)):
        text = rows(lambda cells, by=factor: [*cells[:5], *(repr(float(one) / by) for one in cells[5:8]), *cells[8:]])
        run = parse(text.replace('_mm,', f'_{unit},').replace('radius_mm: 100', f'radius_{unit}: {100 / factor!r}'))
        assert np.abs(run.centre - plain.centre).max() < 1e-15 and run.radius == pytest.approx(0.1, rel=1e-15)
        assert f"'x_{unit}' times {factor:g} as x_mm" in ' '.join(run.notes), run.notes
        assert f'radius_{unit} times {factor:g} as radius_mm' in run.notes
    for unit, factor in (('ms', 1e-3), ('min', 60), ('h', 3600)):
        text = rows(lambda cells, by=factor: [*cells[:8], repr(float(cells[8]) / by), *cells[9:]])
        run = parse(text.replace('time_s', f'time_{unit}'))
        assert run.time == pytest.approx(plain.time) and f"'time_{unit}' times {factor:g} as time_s" in run.notes[0]


def test_wrong_units_are_named_with_their_factor():
    """In coordinates or radius, in either frame; where both are in it, the readings are in doubt."""
    frame = Frame(rotation_matrix([0.3, -0.2, 2.0]), np.array([0.4, 0.1, -0.3]))
    run = parse(TABLE).replace(radius=0.1825, centre=1.825 * parse(TABLE).centre)
    moved = format_csv(run.replace(centre=frame.to_outer(run.centre))).replace('schema', 'frame: machine\n# schema', 1)
    for text in (format_csv(run), moved):
        for unit, factor in (('m', 1000), ('um', 1e-3), ('cm', 10), ('inch', 25.4)):
            lines = [line.split(',') for line in text.splitlines()]
            scaled = '\n'.join(','.join([*cells[:5], *(repr(float(one) / factor) for one in cells[5:8]), *cells[8:]])
                               if cells[0].isdigit() else ','.join(cells) for cells in lines)
            radius = f'radius_mm: {182.5 / factor!r}'
            with pytest.raises(InvalidData, match='columns x_mm, y_mm, z_mm: .* R = 182.5 mm, as radius_mm says, found '
                               rf'R = .*; these are {unit}, of {factor:g} mm: name the columns x_{unit}, y_{unit}, z'):
                parse(scaled)
            with pytest.raises(InvalidData, match=f'radius_mm: expected about 182.5 mm, .* is {unit}, of {factor:g} '
                                                  'mm'):
                parse(text.replace('radius_mm: 182.5', radius))
            both = parse(scaled.replace('radius_mm: 182.5', radius))
            remarks = list(map(remark_words, both.remarks))
            assert any(f'{unit} (R = 182.5 mm)' in one for one in remarks) or unit == 'um', remarks


def test_times_that_no_ball_takes_are_doubted():
    """The unit that they seem to have is named."""
    for unit, factor, begin in (('ms', 1e3, 0), ('ms', 1e3, 1.76e12), ('minutes', 1 / 60, 0), ('hours', 1 / 3600, 0),
                                ('days', 1 / 86400, 46000), ('µs', 1e6, 0), ('ns', 1e9, 1.76e18)):
        text = rows(lambda cells, by=factor, at=begin: [*cells[:8], repr(at + float(cells[8]) * by), *cells[9:]])
        remarks = list(map(remark_words, parse(text).remarks))
        assert any(f'is time_s in {unit}, which would be 30' in one for one in remarks), (unit, begin)
    for cell in ('08:30:15', '30. Mai', '2026-05-14 08:30'):
        with pytest.raises(InvalidData, match='it looks like a date or a time of day, which spreadsheets make of'):
            parse(changed(6, ',60,', f',{cell},'))


def test_rounding_is_found_before_the_frame_is_turned():
    """Coordinates of the machine to 1 µm, or to 0.0001 inch, in a table that stands askew."""
    rng, scheme = np.random.default_rng(3), plan(6, 'diagonal')
    run = Run(6, 0.1825, scheme.table_position, scheme.ball, scheme.centres(0.1825) + rng.normal(0, 1e-6, (36, 3)))
    frame = Frame(rotation_matrix([0.3, -0.2, 2.0]), np.array([0.4, 0.1, -0.3]))
    for unit, factor, digits, step in (('mm', 1.0, 3, '1 µm'), ('inch', 25.4, 4, '2.54 µm')):
        lines = format_csv(run.replace(centre=frame.to_outer(run.centre))).replace('_mm,', f'_{unit},').splitlines()
        rounded = [','.join([*cells[:5], *(f'{float(one) / factor:.{digits}f}' for one in cells[5:8]), *cells[8:]])
                   if (cells := line.split(','))[0].isdigit() else line for line in lines]
        read = parse('\n'.join(['# frame: machine', *rounded]))
        remarks = read.remarks
        assert any(remark_words(one).startswith(f'readings are rounded to {step}') for one in remarks), remarks
        assert read.rounding == pytest.approx(1e-3 * factor * 10.0**-digits / 12**0.5)
        assert fit(read).sigma >= read.rounding


def test_import_and_info_say_what_was_taken(tmp_path, capsys):
    """Of the table, and of the log that was made of it."""
    path = tmp_path / 'table.csv'
    path.write_bytes(excel(columns_of(TABLE, SPOKEN)))
    said = ('semicolons between cells and decimal commas', "'Table Position' as table_position", 'readings are counted')
    for words in (('info', path), ('import', path, '-o', tmp_path / 'log'), ('info', tmp_path / 'log'),
                  ('info', tmp_path / 'log', '--json')):
        assert main([str(word) for word in words]) == 0
        got = ' '.join(capsys.readouterr().out.split())
        assert all(one in got for one in said), (words, got)


def test_the_template_that_an_error_advises_works(capsys):
    """As it is printed; with the coordinates filled in it is a table."""
    with pytest.raises(InvalidData) as caught:
        parse(TABLE.partition('\n')[2])
    words = re.search('`rosette (.*?)`', str(caught.value))[1].split()
    assert main(words) == 0
    head, lines = capsys.readouterr().out.split('approach\n')
    scheme = plan(12, 'diagonal')
    filled = [','.join([*line.split(',')[:5], *map(repr, centre), *line.split(',')[8:]])
              for line, centre in zip(lines.splitlines(), scheme.centres(182.5).tolist())]
    run = parse(f'{head}approach\n' + '\n'.join(filled))
    assert run.is_complete and run.notes == ('not in the table: ' + ABSENT[ABSENT.index('time_s'):],)


def test_the_end_of_summer_time_is_named():
    """Local times that go back by an hour cannot be told apart; with their zone they can."""
    def local(cells, zoned):
        minutes, seconds = divmod(int(cells[8]), 60)
        hour = 2 - (minutes >= 2)
        return [*cells[:8], f'2026-10-25 0{hour}:{minutes:02d}:{seconds:02d}{f"+0{hour}:00" * zoned}', *cells[9:]]
    with pytest.raises(InvalidData, match='column time_s: expected at least 90, the row before, found -3480; was the '
                                          r'clock set back, as at the end of summer time\? Write every time with its '
                                          r'zone, such as \+02:00'):
        parse(rows(lambda cells: local(cells, zoned=False)))
    run = parse(rows(lambda cells: local(cells, zoned=True)))
    assert run.time.tolist() == [30 * place for place in range(9)]


def test_formulas_of_a_spreadsheet_are_named():
    """Cells that were saved to stay as they are."""
    with pytest.raises(InvalidData, match=r"found '=\"1\"'; it is a formula of a spreadsheet; save the values"):
        parse(rows(lambda cells: [f'="{cell}"' for cell in cells]).replace(',', ';'))
