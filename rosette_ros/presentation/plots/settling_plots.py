# SPDX-License-Identifier: Apache-2.0
"""The way to what is known: probabilities of the leading explanations, and U, against the readings of a run."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from rosette_ros.core.planning.next_readings import Contender, Step, leading
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.words.settling_words import contender_words


def way_to_the_cause(steps: Sequence[Step], until: float) -> Figure:
    """Return a figure of the probabilities of the leading explanations, and of U, after the readings of each step.

    until: the probability from which on an explanation is settled."""
    made = style.figure(4.4, left=0.08, bottom=0.1, right=0.975, top=0.93, hspace=0.35)
    above, below = style.panels(made, 2, 1)[:, 0]
    readings = [step.readings for step in steps]
    for place, (names, p) in enumerate(leading(steps).items()):
        words = contender_words(Contender(names, p[-1]))
        above.plot(readings, p, color=style.COLOURS[place % len(style.COLOURS)], linewidth=1.0,
                   marker=style.MARKERS[place % len(style.MARKERS)], markersize=3, label=words)
    above.axhline(until, color=style.GREY, linewidth=1.0, linestyle=style.DASHED, label=f'settled, {100 * until:g} %')
    above.set(ylim=(0, 1.05), ylabel='probability')
    style.title(above, 'Explanations')
    below.plot(readings, [1e6 * step.uncertainty for step in steps], color=style.AFTER, linewidth=1.0, marker='o',
               markersize=3)
    below.set(ylim=(0, None), ylabel='µm', xlabel='readings')
    style.title(below, 'U (k = 2) of the worst point of the curves')
    for panel in (above, below):
        style.scale(panel)
    style.legend_of(made, [above])
    return made
