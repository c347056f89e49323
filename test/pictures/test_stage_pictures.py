# SPDX-License-Identifier: Apache-2.0
"""Bars of models, candidates and visibility, differences of runs, and figures as parts of a page."""

import numpy as np
import pytest

from rosette_ros.core.geometry import nominal_angles
from rosette_ros.core.records import CURVES
from rosette_ros.pictures import stages
from rosette_ros.pictures.curves import LAYOUT
from rosette_ros.pictures.style import figure, label_of, panels, round_numbers, scale
from rosette_ros.pictures.svg import inline_svg
from rosette_ros.pictures.verification import differences


def widths(made):
    """Return the lengths of all bars, in order of drawing."""
    return [bar.get_width() for container in made.axes[0].containers for bar in container]


def test_ladder_shows_fit_and_held_out_beside_the_repeatability():
    """In µm."""
    made = stages.ladder(['base model', '+ drift'], [3e-7, 1e-7], [3.2e-7, 1.1e-7], 0.9e-7, 1e-8)
    assert widths(made) == pytest.approx([0.3, 0.1, 0.32, 0.11])
    [known] = [line for line in made.axes[0].lines if 'repeatability' in str(line.get_label())]
    assert known.get_xdata()[0] == pytest.approx(0.09)
    assert 'µm' in made.axes[0].get_xlabel()


def test_candidates_go_from_before_to_after():
    """Claimed ones have a look of their own."""
    made = stages.candidates(['a', 'b'], [3e-7, 1e-7], [1e-7, 1.1e-7], [True, False], 1e-7)
    lines = {line.get_label(): line for line in made.axes[0].lines}
    assert lines['without it'].get_xdata() == pytest.approx([0.3, 0.1])
    assert lines['with it: claimed'].get_xdata() == pytest.approx([0.1])
    assert lines['with it: not claimed'].get_xdata() == pytest.approx([0.11])
    assert lines['with it: claimed'].get_marker() != lines['with it: not claimed'].get_marker()


def test_visibility_names_what_is_hidden_and_what_is_not_judged():
    """In words, not by colour alone."""
    made = stages.visibility(['a', 'b', 'c'], [0.8, 0.01, np.nan], [0.9, 0.7, np.nan])
    texts = [text.get_text().strip() for text in made.axes[0].texts]
    assert 'hidden' in texts and 'not judged' in texts
    assert widths(made)[:3] == pytest.approx([0.8, 0.01, 0.0])


def test_differences_are_drawn_in_their_panels():
    """µm and µrad, with what noise explains as a band."""
    rng = np.random.default_rng(0)
    values = 1e-7 * rng.standard_normal((3, 6, 6))
    made = differences(['a', 'b', 'c'], nominal_angles(6), values, np.full(6, 1e-8))
    for panel, curve in zip(made.axes, LAYOUT, strict=True):
        assert panel.get_title(loc='left').startswith(curve)
        drawn = [line for line in panel.lines if line.get_marker() != 'None' and len(line.get_xdata()) == 7]
        for line, one in zip(drawn, values, strict=True):
            np.testing.assert_allclose(line.get_ydata()[:-1], 1e6 * one[:, CURVES.index(curve)])


@pytest.mark.parametrize(('low', 'high', 'steps', 'texts'), [
    (-0.31, 0.42, 4, ['−0.2', '0.0', '0.2', '0.4']), (0, 100, 5, ['0', '20', '40', '60', '80', '100']),
    (20.0, 20.1, 5, ['20.00', '20.05', '20.10']),
    (3e-6, -3e-6, 3, ['−0.000002', '0.000000', '0.000002'])])
def test_round_numbers(low, high, steps, texts):
    """As many decimals as the step has; never -0."""
    assert list(round_numbers(low, high, steps).values()) == texts


def test_numbers_stand_where_they_belong():
    """Each text at its value."""
    made = figure(3, 3, None)
    panel = panels(made)[0, 0]
    panel.set(xlim=(0, 1), ylim=(-1, 1))
    scale(panel)
    found = {text.get_text(): text.get_position() for text in panel.texts}
    assert found['0.4'] == (0.4, 0)
    assert found['−0.5'] == (0, -0.5)


@pytest.mark.parametrize(('text', 'label'), [
    ('a$b$', r'a\$b\$'), ('_run', ' _run'), ('two\nlines\x00', 'two lines'), (r'\frac', '/frac')])
def test_labels_are_no_formulas(text, label):
    """Nor hidden ones, nor several lines."""
    assert label_of(text) == label


def test_a_figure_becomes_part_of_a_page():
    """No head, no namespace; ids of its own; text stays text; the same each time."""
    def make():
        made = figure(3, 2, None)
        panel = panels(made)[0, 0]
        panel.plot([0, 1], [0, 1], marker='o')
        panel.set_title('a title')
        return inline_svg(made, 'name', 'what "it" shows')
    svg = make()
    assert svg.startswith('<svg ') and svg.rstrip().endswith('</svg>')
    assert 'xmlns' not in svg and 'http' not in svg and 'metadata' not in svg
    assert 'aria-label="what &quot;it&quot; shows"' in svg
    assert '>a title</text>' in svg
    assert 'id="name-' in svg and 'id="figure' not in svg
    assert make() == svg
