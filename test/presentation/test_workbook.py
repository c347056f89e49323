# SPDX-License-Identifier: Apache-2.0
"""Results as a workbook: exact numbers with the digits of print, the verdict in its colour, no formulas."""

import io

import pytest

from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.presentation.workbook import workbook

openpyxl = pytest.importorskip('openpyxl')

TABLE = Table('errors', 'Errors', (
    words('name', 'name', ['=SUM(A1)', 'ctz']),
    column('range_um', 'range', [1.23456789, float('nan')], lambda value: f'{value:.2f}', 'µm'),
    column('exact', '', [0.1, 0.2]),
    column('tolerance_um', 'tolerance', [0.35, 0.5], lambda value: f'{1000 * value:.0f} nm', 'µm')),
              levels=('bad', ''), note='A note.')


def test_a_workbook_holds_exact_numbers_and_no_formula():
    """A text that begins as a formula does stays a text; what is not known is an empty cell."""
    data = workbook(openpyxl, ('The model fits.', 'Nothing to do.'), 'good', (TABLE, TABLE), 'run 7')
    made = openpyxl.load_workbook(io.BytesIO(data))
    assert made.sheetnames == ['Result', 'errors', 'errors 2']
    first = made['Result']
    assert [first.cell(row, 1).value for row in (1, 2, 3)] == ['The model fits.', 'Nothing to do.', 'Run: run 7']
    assert first['A1'].fill.fgColor.rgb.endswith('C8E6C9')
    sheet = made['errors']
    assert [one.value for one in sheet[2]] == ['name', 'range / µm', 'exact', 'tolerance / µm']
    assert sheet['A3'].value == "'=SUM(A1)" and sheet['A3'].data_type == 's'
    assert (sheet['B3'].value, sheet['B3'].number_format, sheet['B4'].value) == (1.23456789, '0.00', None)
    assert (sheet['D3'].value, sheet['D3'].number_format) == (0.35, 'General'), 'shown in another unit'
    assert sheet['A6'].value == 'A note.' and sheet.freeze_panes == 'A3'
