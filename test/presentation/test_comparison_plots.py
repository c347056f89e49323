# SPDX-License-Identifier: Apache-2.0
"""Bars of models, candidates and visibility, differences of runs, and figures as parts of a page."""

import os
import subprocess
import sys
from types import SimpleNamespace as record

import numpy as np
import pytest

from rosette_ros.cli.main import main
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import CURVES
from rosette_ros.presentation.plots import comparison_plots
from rosette_ros.presentation.plots.plot_style import figure, label_of, scale
from rosette_ros.presentation.plots.result_plots import differences
from rosette_ros.presentation.report.page_parts import inline_svgs


def widths(made):
    """Return the lengths of all bars, in order of drawing."""
    return [bar.get_width() for panel in made.axes for container in panel.containers for bar in container]


def test_ladder_shows_fit_and_cross_validation_beside_the_repeatability():
    """In µm."""
    made = comparison_plots.ladder([
        record(added=added, fit=record(model=Model(), rms=rms), cross_validation=error)
        for added, rms, error in (('', 3e-7, 3.2e-7), ('drift', 1e-7, 1.1e-7))], 0.9e-7, 40)
    assert widths(made) == pytest.approx([0.3, 0.1, 0.32, 0.11])
    [known] = [line for line in made.axes[0].lines if 'repeatability' in str(line.get_label())]
    assert known.get_xdata()[0] == pytest.approx(0.09)
    assert 'µm' in made.axes[0].get_xlabel()


def test_candidates_go_from_before_to_after():
    """Claimed ones have a look of their own."""
    made = comparison_plots.candidates([
        record(name='a', before=3e-7, after=1e-7, claimed=True),
        record(name='b', before=1e-7, after=1.1e-7, claimed=False)], 1e-7)
    lines = {line.get_label(): line for line in made.axes[0].lines}
    assert lines['without it'].get_xdata() == pytest.approx([0.3, 0.1])
    assert lines['with it: identified'].get_xdata() == pytest.approx([0.1])
    assert lines['with it: not identified'].get_xdata() == pytest.approx([0.11])
    assert lines['with it: identified'].get_marker() != lines['with it: not identified'].get_marker()


def test_visibility_names_what_is_hidden_and_what_is_not_judged():
    """In words, not by colour alone."""
    present, best = ([record(name=name, typical_share=share, hidden=share < 0.05,
                             reason='no time' if name == 'c' else '') for name, share in zip('abcd', shares)]
                     for shares in ([0.8, 0.01, 0.0, 0.0], [0.9, 0.2, 0.0, 0.7]))
    made = comparison_plots.visibility(present, best)
    texts = {text.get_text(): text for panel in made.axes for text in panel.texts}
    assert texts['hidden'].get_color() != texts['not judged'].get_color()
    assert widths(made) == pytest.approx([0.8, 0.01, 0.0, 0.0])
    filled, hollow = made.axes[0].patches
    assert filled.get_facecolor() != hollow.get_facecolor() == made.legends[0].legend_handles[1].get_facecolor()
    marks = [panel.lines[0].get_xdata() for panel in made.axes]
    np.testing.assert_equal(np.concatenate(marks), [0.9, 0.2, np.nan, 0.7])
    assert made.axes[0].texts[0].xy == (0.2, 1), 'to the right of the mark that it would cross'
    assert made.axes[1].texts[1].xy == (0.0, 1), 'before a mark that is farther away'


def test_differences_are_drawn_in_their_panels():
    """µm and µrad, with what noise explains as a band."""
    rng = np.random.default_rng(0)
    values = 1e-7 * rng.standard_normal((3, 6, 6))
    made = differences(['a', 'b', 'c'], nominal_angles(6), values, np.full(6, 1e-8))
    for panel, curve in zip(made.axes, CURVES, strict=True):
        assert panel.get_title(loc='left').startswith(curve)
        drawn = [line for line in panel.lines if line.get_marker() != 'None' and len(line.get_xdata()) == 7]
        for line, one in zip(drawn, values, strict=True):
            np.testing.assert_allclose(line.get_ydata()[:-1], 1e6 * one[:, CURVES.index(curve)])


def test_scales_have_round_numbers_or_the_given_ones():
    """With minus signs; grid and numbers where they are asked for."""
    made, [[panel]] = figure(3)
    panel.set(xlim=(0, 1), ylim=(-1, 1))
    scale(panel, {0.5: 'half'}, numbers='y')
    made.canvas.draw()
    assert panel.get_xticks().tolist() == [0.5]
    assert not panel.xaxis.get_major_ticks()[0].label1.get_visible()
    assert {'−0.5', '0.0', '0.5'} <= {text.get_text() for text in panel.get_yticklabels()}


@pytest.mark.parametrize(('text', 'label'), [
    ('a$b$', r'a\$b\$'), ('_run', ' _run'), ('two\nlines\x00', 'two lines'), (r'\frac', '/frac')])
def test_labels_are_no_formulas(text, label):
    """Nor hidden ones, nor several lines."""
    assert label_of(text) == label


def test_a_figure_becomes_part_of_a_page():
    """No head, no namespace; ids of its own; text stays text; the same each time."""
    def make():
        made, [[panel]] = figure(2)
        panel.plot([0, 1], [0, 1], marker='o')
        panel.set_title('a title')
        return inline_svgs({'name': made})['name']
    svg = make()
    assert svg.startswith('<svg ') and svg.rstrip().endswith('</svg>')
    assert 'xmlns' not in svg and 'http' not in svg and 'metadata' not in svg
    assert '>a title</text>' in svg
    assert 'id="name-' in svg and 'id="figure' not in svg
    assert make() == svg


PLAN = 'plan row --balls 4 --radius-mm 9 --format png --figures'.split()


@pytest.fixture(scope='module')
def plain(tmp_path_factory):
    """Return the figures of a plan as this process draws them."""
    folder = tmp_path_factory.mktemp('plain')
    assert main([*PLAN, str(folder / 'figures')]) == 0
    return drawn(folder / 'figures')


def drawn(folder):
    """Return the figures in a folder."""
    return {path.name: path.read_bytes() for path in folder.glob('*.png')}


@pytest.mark.parametrize(('settings', 'place'), [
    ('font.family: serif\nfont.size: 22\naxes.facecolor: black\nsavefig.transparent: True\nlines.linewidth: 6\n',
     'here'),
    ('# no UTF-8: \xb5\xff\xfe\nsvg.fonttype: broken\ntext.usetex: True\nfont.family: Nonexistent\n', 'named')])
def test_a_figure_is_the_same_whatever_the_matplotlibrc_says(plain, tmp_path, settings, place):
    """Fonts that are not there, TeX, another look: they are for the figures of their owner."""
    (tmp_path / 'matplotlibrc').write_text(settings, encoding='latin-1')
    done = subprocess.run(
        [sys.executable, '-m', 'rosette_ros.cli.main', *PLAN, tmp_path / 'told'], capture_output=True, text=True,
        timeout=300, cwd=tmp_path if place == 'here' else None, check=False,
        env={**os.environ, 'MATPLOTLIBRC': str(tmp_path) if place == 'named' else ''})
    assert (done.returncode, done.stderr) == (0, '')
    assert plain and plain == drawn(tmp_path / 'told')
