# SPDX-License-Identifier: Apache-2.0
"""What single touches show: the pictures, the page and its words, with touches and without."""

import pytest
from figure_texts import faults
from ideal_cell import ideal_cell
from page_reader import Page
from touched_log import write_touched_log

from rosette_ros.analysis import summarise
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.touch_log import open_refitted
from rosette_ros.presentation.plots.touch_plots import MOST_DOTS, touch_residuals
from rosette_ros.presentation.report import Source, open_source, report_html
from rosette_ros.presentation.report.run_page import NO_TOUCHES, touches_of
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table
from rosette_ros.simulation import Machine, MachineConfig

LOBES = {'kind': 'ball_lobes', 'ball': 3, 'height_um': 0.6, 'order': 2}
DUST = {'kind': 'touch_dust', 'thickness_um': 3, 'touch': 6, 'at_h': 0.25}


@pytest.fixture(scope='module')
def dusty(tmp_path_factory):
    """Return the log of a cell with a lobed ball, and with dust under one touch."""
    folder = tmp_path_factory.mktemp('touched') / 'log'
    write_touched_log(folder, MachineConfig().changed(plate={'balls': 6}, hidden=[LOBES, DUST]))
    return folder


def test_residuals_show_the_dust(dusty):
    """It is the highest dot, at its number; the others are within the scale of the noise."""
    refit = open_refitted(dusty)[1]
    made = touch_residuals(refit)
    panel = made.axes[0]
    x, y = panel.lines[1].get_data()
    assert x[y.argmax()] == 6
    assert 1.5 < y.max() < 3.0
    assert faults(made) == []
    assert ('Touches off', 'table position') in [(name, text[:14]) for name, text in sphere_rows(refit)]


@pytest.mark.usefixtures('sketched')
def test_page_has_an_annex_of_touches(dusty):
    """A figure, a table and sentences; what is not known does not say that there are none."""
    run = Machine(MachineConfig().changed(plate={'balls': 4})).run(plan(4, 'random'))
    page = Page(report_html(summarise(run), open_source(dusty)[1], annexed=True))
    assert 'ball 3 0.3' in page.texts['touches']
    assert 'touch 6: +' in page.texts['touches']
    assert NO_TOUCHES not in page.texts['unknown']
    assert {'figure-touch_residuals', 'table-spheres'} <= set(page.values('id'))


def test_page_says_why_it_shows_no_touches(tmp_path):
    """The log has none, or it cannot be read; a run in memory has no source that could have some."""
    write_touched_log(tmp_path / 'log', MachineConfig().changed(plate={'balls': 4}),
                      change=lambda answer, touches: None)
    assert touches_of(open_source(tmp_path / 'log')[1]) == (None, [NO_TOUCHES])
    assert touches_of(None) == (None, [])
    found, [words] = touches_of(Source(f'{tmp_path}/gone.csv', ()))
    assert found is None
    assert words.startswith(f'Touches are not shown: {tmp_path}/gone.csv: ')


def test_silent_cell_is_drawn(tmp_path):
    """No noise, no form, more touches than dots: nothing is divided by zero, and the largest residuals are chosen."""
    write_touched_log(tmp_path / 'log', ideal_cell(plate={'balls': 15}))
    refit = open_refitted(tmp_path / 'log')[1]
    assert refit.residual.size > MOST_DOTS
    assert len(touch_residuals(refit).axes[1].lines[1].get_xdata()) <= MOST_DOTS
    assert sphere_table(refit).rows[0][:3] == ('1', '15', '7.50000')
