# SPDX-License-Identifier: Apache-2.0
"""The picture of the way to a cause, by itself and in the report of a run that was measured until it is known."""

import pytest
from figure_texts import faults, texts_of
from summaries import summary_of

from rosette_ros.core.diagnosis.posterior import Explanation
from rosette_ros.core.planning.next_readings import SettlingStep
from rosette_ros.presentation.plots.plan_plots import way_to_the_cause
from rosette_ros.presentation.report import Source, report_html


def test_every_text_can_be_read():
    """The leading explanations by their titles, the limit, U."""
    steps = [SettlingStep(144, (
        Explanation(('frame_drift',), 0.5), Explanation(('frame_warmup', 'plate_expansion'), 0.4), Explanation((), 0.1),
    ), 1e-7), SettlingStep(156, (Explanation(('frame_drift',), 0.97),), 9e-8)]
    made = way_to_the_cause(steps, 0.95)
    assert faults(made) == []
    texts = [text for text, _, _ in texts_of(made)]
    assert {'linear probe drift', 'warm-up of the machine and thermal expansion of the plate',
            'no further effect', 'settled, 95 %'} <= {' '.join(text.split()) for text in texts}


@pytest.mark.usefixtures('sketched')
def test_a_report_has_the_way_where_readings_were_added():
    """One that was asked once, after its plan, has none."""
    pages = [report_html(summary_of('drift', 6), Source('run', (), until=0.95, asked=asked)) for asked in (
        (30, 36), (36,), ())]
    assert ['The way to the cause: probability' in one for one in pages] == [True, False, False]
