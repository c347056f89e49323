# SPDX-License-Identifier: Apache-2.0
"""rosette compare-curves: a run against its own curves as files of others have them."""

import json

import numpy as np
import pytest
from simulated import simulated_table

import rosette_ros as rosette_api
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.curve_table import read_curves


def test_a_run_against_its_own_table_and_against_one_of_the_maker(rosette, tmp_path):
    """Its curves as CSV are the same; with an offset and in arcsec still; a wave of 2 µm is said."""
    run = simulated_table()
    own = tmp_path / 'own.csv'
    own.write_text(rosette('evaluate', run, '--csv').out)
    found = json.loads(rosette('compare-curves', run, own, '--json').out)
    assert found['schema'] == 'rosette-curve-comparison/1' and len(found['curves']) == 6
    assert max(abs(value) for one in found['curves'].values() for value in one['difference']) < 1e-15
    motions = rosette_api.evaluate(run).curves.motions
    lines = ['# a table of the maker', 'angle_deg,ctz_mm,crz_arcsec,U_crz_arcsec']
    for angle, values in zip(motions.angle, motions.values, strict=True):
        ctz = values[2] + 5e-6 + 2e-6 * np.cos(2 * angle)
        lines.append(f'{np.rad2deg(angle)},{1e3 * ctz},{np.rad2deg(values[5]) * 3600 + 7},0.2')
    maker = tmp_path / 'maker.csv'
    maker.write_text('\n'.join(lines))
    made = rosette_api.compare_curves(run, maker)
    assert made.made.compared == ('ctz', 'crz')
    assert np.abs(made.made.difference[:, 5]).max() < 1e-12
    assert np.abs(made.made.difference[:, 2]).max() == pytest.approx(2e-6, rel=1e-6)
    assert 'Differ by more than U: ctz.' in made.sentences() and 'Within U: crz.' in made.sentences()
    words = ' '.join(rosette('compare-curves', run, maker).out.split())
    assert 'Differ by more than U: ctz' in words and 'how a plate is clamped' in words
    assert rosette('compare-curves', run, maker, '--csv').out.startswith('table_angle_deg,ctz_um,crz_urad,U_ctz_um')


def test_a_table_without_curves_says_what_is_wanted(tmp_path):
    """Columns and units."""
    path = tmp_path / 'maker.csv'
    path.write_text('angle,ctz\n0,1\n')
    with pytest.raises(InvalidData, match='expected the columns table_angle_deg and some .*, found angle,ctz'):
        read_curves(path)
    path.write_text('angle,ctz_inch\n0,1\n')
    with pytest.raises(InvalidData, match="expected the unit of ctz as one of m, mm, um, nm, found 'inch'"):
        read_curves(path)
    rows = [f'{angle},1,note' for angle in range(0, 360, 60)]
    path.write_text('\n'.join(['angle,ctz_um,remark', *rows, '30,1O,typing error']))
    with pytest.raises(InvalidData, match="maker.csv: line 8: ctz_um: expected a number, found '1O'"):
        read_curves(path)
    path.write_text('\n'.join(['angle,ctz_um,remark', *rows, ',1,']))
    with pytest.raises(InvalidData, match='maker.csv: angle: expected an angle in each row, found an empty one'):
        read_curves(path)
