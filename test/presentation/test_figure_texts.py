# SPDX-License-Identifier: Apache-2.0
"""The texts of every figure of a report can be read: whole, in its panel, none over another one."""

import numpy as np
import pytest
from figure_texts import faults, texts_of
from summaries import summary_of

from rosette_ros.core.diagnosis.recovered_shape import Shape, ShapeCurve
from rosette_ros.core.effects.effect import Setting
from rosette_ros.presentation.plots.plot_style import figure
from rosette_ros.presentation.plots.residual_plots import shapes
from rosette_ros.presentation.report import pictures_of

pytestmark = pytest.mark.long


def test_faults_are_seen():
    """Of texts that were put so."""
    made, [[panel]] = figure(2.0)
    panel.set_axis_off()
    for x, text in ((0.5, 'one'), (0.51, 'other'), (0.99, 'cut off')):
        made.text(x, 0.5, text, fontsize=9)
    made.text(0.1, 0.1, 'tiny', fontsize=6)
    assert faults(made) == ['cut off: beyond the figure', 'tiny: 6.0 points', 'one: over other']
    assert len(texts_of(made)) == 4


@pytest.mark.parametrize('run', [('drift', 8), ('clean', 6), ('drift', 12, 'diagonal')])
def test_every_text_can_be_read(run):
    """Few balls and many, orders that show effects and one that does not."""
    summary = summary_of(*run)
    pictures = pictures_of(summary)
    assert {name: found for name, made in pictures.items() if (found := faults(made))} == {}


def test_every_axis_of_the_noise_has_its_quantity():
    """Each panel has others."""
    made = pictures_of(summary_of('drift', 8))['noise']
    assert all(panel.get_xlabel() and panel.get_ylabel() for panel in made.axes)
    assert sum('where noise lies' in text for text, _, _ in texts_of(made)) == 1


def test_no_curve_crosses_what_multiplies_it():
    """Nor does the name of a shape, however long."""
    curve = ShapeCurve('x', 'ball 12', np.array([1e-6, 0.0]), np.array([1e-7, 1e-7]), None)
    shape = Shape('form', Setting(), 'a function of time for each ball, of which one is shown', '', 'time', 's',
                  np.array([0.0, 3600.0]), (curve, curve, curve))
    made = shapes([shape, shape])
    assert faults(made) == []
    carriers = [box for text, box, _ in texts_of(made) if text == '× ball 12']
    assert len(carriers) == 6
    assert not any(panel.bbox.overlaps(box) for panel in made.axes for box in carriers)
