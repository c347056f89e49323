# SPDX-License-Identifier: Apache-2.0
"""The noise of a run in words, and what to do about it."""

from rosette_ros.core.diagnosis.verdict import OTHER_UNIT, NoiseFacts
from rosette_ros.core.number_words import micrometres
from rosette_ros.words.effect_words import names


def noise_words(noise: NoiseFacts) -> list[str]:
    """Return in what the noise of a run is other than white and equal."""
    out = []
    if noise.resolution:
        out.append(f'the readings are rounded to {micrometres(noise.resolution)}')
    if noise.worse:
        worse = names(f'along {_axes(axes)} is {ratio:.1f} times' for axes, ratio in noise.worse)
        out.append(f'the scatter {worse} that along {_axes(noise.than)}')
    if noise.tail:
        out.append(f'single {noise.tail}s are farther off than a normal distribution allows (Student, '
                   f'{noise.tail_dof:g} degrees of freedom)')
    if noise.noisiest:
        where, *alike = noise.noisiest
        same = f' (this run cannot tell it from {" or ".join(alike)})' if alike else ''
        out.append(f'{where} scatters {noise.factor:.1f} times as much as the others{same}')
    if noise.walk:
        out.append(f'the frame drifts at random by {micrometres(noise.walk)} over the run (random walk)')
    elif noise.wander:
        out.append(f'the frame drifts to and fro by {micrometres(noise.wander)} within about {noise.readings:.0f} '
                   'readings')
    elif noise.correlation:
        out.append(f'autocorrelation (lag 1) {noise.correlation:+.1f}'.replace('-', '−'))
    return out


def noise_actions(noise: NoiseFacts) -> list[str]:
    """Return what to do about each of these."""
    out = []
    if noise.resolution:
        out.append('export the coordinates with more digits')
    if noise.worse:
        axes = names(_axes(one) for one, _ in noise.worse)
        out.append(f'check the probe and the slide of {axes} (the readings are weighted accordingly)'
                   if max(ratio for _, ratio in noise.worse) < OTHER_UNIT else 'check that x, y and z have one unit')
    if noise.tail:
        out.append('clean balls and stylus (readings that stand out have less weight)')
    if noise.noisiest:
        out.append(f'check {noise.noisiest[0]}')
    if noise.walk or noise.wander or noise.correlation:
        out.append('look for draughts, vibration and changes of temperature of the frame, or measure faster')
    return out


def _axes(letters: str) -> str:
    return names(letters)
