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
    made, panels = style.figure(4.4, 2)
    above, below = panels[:, 0]
    readings = [step.readings for step in steps]
    for place, (names, p) in enumerate(leading(steps).items()):
        words = contender_words(Contender(names, p[-1]))
        above.plot(readings, p, linewidth=1.0, markersize=3, label=words, **style.look_of(place))
    above.axhline(until, color=style.GREY, linewidth=1.0, linestyle=style.DASHED, label=f'settled, {100 * until:g} %')
    above.set(ylim=(0, 1.05), ylabel='probability')
    above.set_title('Explanations')
    below.plot(readings, [1e6 * step.uncertainty for step in steps], color=style.AFTER, linewidth=1.0, marker='o',
               markersize=3)
    below.set(ylim=(0, None), ylabel='µm', xlabel='readings')
    below.set_title('U (k = 2) of the worst point of the curves')
    for panel in (above, below):
        style.scale(panel)
    style.legend_of(made, [above])
    return made
