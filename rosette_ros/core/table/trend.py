# SPDX-License-Identifier: Apache-2.0
"""How what was measured changes from run to run: change points, when a tolerance is reached.

A quantity y (m runs, c components) is modelled as

    y_i = a + b t_i + g (T_i - mean T) + sum over steps s_k [i >= k] + noise of sigma_i = kappa u_i

with the standard uncertainties u of the runs and the run-to-run scatter kappa of each component, from the differences
of neighbours, moderated by those of its like: as far as these differ by chance only, they have one in common.
A step before run k is judged by the fall of the weighted sum of squares: fall / c has an F distribution of c degrees of
freedom and those of kappa where there is none. The probability counts all places and all quantities (Bonferroni): at
one look, FALSE_EVENTS of the histories show a false change, however many curves, balls and runs there are.

Sources: Huber, Robust Statistics (1981), proposal 2, for kappa; Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004), for its
moderation; ILAC-G24 / OIML D 10, method 2 (control chart), for intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.core.run.records import Floats, Ints

FALSE_EVENTS = 0.002
"""Probability that a history without a change shows one, at one look."""
CONSEQUENT = ('clamping', 'frame', 'size')
"""How the plate and the CMM positions lie in the frame of a run, and their size in the scale of the CMM: another plate
lies elsewhere and has another size, and a table whose zero has moved turns both."""
TOGETHER = 12.0
"""A change in a quantity lies at that of another one where the sum of squares is less than that above its best: that
two changes lie close together by chance is far less probable."""
LEAST_RUNS = 8
"""Fewer runs show no change: slope and scatter are not known."""
LEAST_LINE = 3
"""Fewer runs since the last change of a curve give no line that says how far it may be wrong."""
MOST_EVENTS = 30
CUT = 2.0
"""Differences of runs count up to so many standard deviations: up to a fifth of them may be changes."""
EFFICIENCY = 0.6
"""Degrees of freedom of the scatter for each run, by simulation of normal runs."""
ITERATIONS = 30
NO_SCATTER = 1e-6
"""Square of the scatter below which runs agree to the last digit."""
SEEN = 1e-9
"""Share of the square sum of a step that is left beside the others, below which it is one of them but for rounding."""
LEAST_SCATTER = 0.3
"""Run-to-run scatter is taken to be at least so many times the stated uncertainty: few runs may agree by chance."""


@dataclass(frozen=True, eq=False)
class TimeSeries:
    """One quantity over the runs.

    owner: what it belongs to (table, plate, CMM, an effect, the residual, one of CONSEQUENT); name: in
    words; values: (m, c), SI, NaN where a run does not have it; u: (m, c) standard uncertainties; unit: SI; curve,
    per_turn: of which error motion it is which wave, cosine and sine, '' and 0 of what is none."""

    owner: str
    name: str
    values: Floats
    u: Floats
    unit: str = 'm'
    curve: str = ''
    per_turn: int = 0


@dataclass(frozen=True, eq=False)
class Shift:
    """A change of one quantity at an event. size: (c,) new minus old, SI, with u; p: counts all quantities and runs."""

    series: TimeSeries
    size: Floats
    u: Floats
    p: float

    @property
    def strength(self) -> float:
        """Norm of the step in its standard uncertainties."""
        return float(np.sqrt(np.sum((self.size / self.u) ** 2)))

    @property
    def amount(self) -> tuple[float, float]:
        """How large it is, SI, with its standard uncertainty: a number with its sign, of several their length."""
        if self.size.size == 1:
            return float(self.size[0]), float(self.u[0])
        length = float(np.linalg.norm(self.size))
        return length, float(np.linalg.norm(self.size / length * self.u)) if length else float(self.u.max())


@dataclass(frozen=True)
class Event:
    """A change between two runs. run: index of the first run after it; earliest, latest: where else it may lie, by the
    runs before which the sum of squares is less than 4 higher; steps: strongest first, CONSEQUENT last."""

    run: int
    earliest: int
    latest: int
    steps: tuple[Shift, ...]

    @property
    def owners(self) -> tuple[str, ...]:
        """What has changed, that with the greatest sum of squares first, CONSEQUENT last."""
        total: dict[str, float] = {}
        for step in self.steps:
            total[step.series.owner] = total.get(step.series.owner, 0.0) + step.strength ** 2
        return tuple(sorted(total, key=lambda owner: (owner in CONSEQUENT, -total[owner])))

    @property
    def curves(self) -> frozenset[str]:
        """The error motions that have changed."""
        return frozenset(step.series.curve for step in self.steps if step.series.curve)

    def difference(self, curve: str, angle: Floats) -> tuple[Floats, Floats]:
        """Return what has changed of an error motion at table angles, new minus old, m or rad, with its u, (n,) each.

        d = sum over the waves that changed of a cos k phi + b sin k phi; u^2 = sum (u_a cos)^2 + (u_b sin)^2."""
        value, square = np.zeros(len(angle)), np.zeros(len(angle))
        for step in self.steps:
            if step.series.curve == curve:
                wave = np.stack([np.cos(step.series.per_turn * angle), np.sin(step.series.per_turn * angle)], axis=-1)
                value += wave @ step.size
                square += wave**2 @ step.u**2
        return value, np.sqrt(square)


@dataclass(frozen=True)
class Forecast:
    """When a figure reaches a limit.

    level: of the line at the last run; slope: per day, with slope_u; expected, soonest: days from the last run
    (soonest: 95 %, one-sided), infinite where it does not move there; interval: proposed days to the next run."""

    level: float
    slope: float
    slope_u: float
    expected: float
    soonest: float
    interval: float


@dataclass(eq=False)
class _Fit:
    """A quantity in the runs that have it: weights from u and scatter, design of the steps that are known."""

    series: TimeSeries
    runs: Ints  # indices
    y: Floats
    base: Floats
    scatter: Floats  # of each component
    dof: float = np.inf
    steps: list[int] = field(default_factory=list)

    @property
    def weight(self) -> Floats:
        return np.asarray(1.0 / (self.scatter * self.series.u[self.runs]))

    def scan(self, places: Ints) -> Floats:
        """Return the fall of the weighted sum of squares by a step before each run of `places`, (places,)."""
        fall = np.zeros(len(places))
        step = (self.runs[:, None] >= places).astype(float)
        for component, weight in enumerate(self.weight.T):
            q = np.linalg.qr(weight[:, None] * self._design())[0]
            columns = weight[:, None] * step
            columns = columns - q @ (q.T @ columns)
            rest = weight * self.y[:, component]
            rest = rest - q @ (q.T @ rest)
            norm = np.sum(columns**2, axis=0)
            known = norm > SEEN * np.sum((weight[:, None] * step) ** 2, axis=0)
            fall[known] += (columns.T @ rest)[known] ** 2 / norm[known]
            fall[~known] = 0.0
        return fall

    def probability(self, fall: Floats) -> Floats:
        """Return the probability of such a fall at one place without a step."""
        count = self.y.shape[1]
        return np.asarray(scipy.special.fdtrc(count, self.dof, fall / count))

    def _design(self) -> Floats:
        return np.column_stack([self.base, *(self.runs >= place for place in self.steps)])

    def step(self, place: int) -> tuple[Floats, Floats]:
        """Return size and standard uncertainty of the step before a run, (c,)."""
        size, u = [], []
        design = self._design()
        column = self.base.shape[1] + self.steps.index(place)
        for component, weight in enumerate(self.weight.T):
            inverse = np.linalg.pinv(weight[:, None] * design)
            size.append(inverse[column] @ (weight * self.y[:, component]))
            u.append(np.linalg.norm(inverse[column]))
        return np.array(size), np.array(u)


def find_events(days: Floats, quantities: Sequence[TimeSeries], temperature: Floats | None = None,
                false_events: float = FALSE_EVENTS) -> tuple[Event, ...]:
    """Return the changes in a history of runs, in the order of time.

    days: (m,) increasing; temperature: (m,) mean of each run, K or °C, NaN or None where not known. Raises InvalidData
    where the days do not increase."""
    if np.any(np.diff(days) < 0):
        raise InvalidData('trend: expected the runs in the order of time')
    fits = _fits(days, quantities, temperature)
    if not fits:
        return ()
    places = np.arange(1, len(days))
    tests = len(fits) * len(places)
    falls = [fit.scan(places) for fit in fits]
    found = dict[int, list[_Fit]]()
    while sum(map(len, found.values())) < MOST_EVENTS * len(fits):
        p = np.array([fit.probability(fall) for fit, fall in zip(fits, falls, strict=True)])
        likeliest = np.lexsort((-np.array(falls).ravel(), p.ravel()))[0]  # p of large steps is 0 at several places
        best, place = np.unravel_index(likeliest, p.shape)
        if p[best, place] * tests > false_events or (len(found) >= MOST_EVENTS and places[place] not in found):
            break
        fit, run = fits[int(best)], int(places[place])
        run = _same_event(found, run, falls[int(best)])
        found.setdefault(run, []).append(fit)
        fit.steps.append(run)
        falls[int(best)] = fit.scan(places)
    return tuple(_event(run, owners, tests, places) for run, owners in sorted(found.items()))


def _same_event(found: dict[int, list[_Fit]], run: int, fall: Floats) -> int:
    """Return the run of an event at which this quantity may have changed too, else its own best place."""
    for known in sorted(found, key=lambda other: abs(other - run)):
        if fall[known - 1] > fall[run - 1] - TOGETHER:
            return known
    return run


def _event(run: int, fits: Sequence[_Fit], tests: int, places: Ints) -> Event:
    steps, total = list[Shift](), np.zeros(len(places))
    for fit in fits:
        size, u = fit.step(run)
        fit.steps.remove(run)
        fall = fit.scan(places)
        fit.steps.append(run)
        total += fall
        steps.append(Shift(fit.series, size, u, min(1.0, tests * float(fit.probability(fall[run - 1])))))
    likely = places[total > total[run - 1] - 4.0]
    near = [place for place in likely if abs(place - run) <= len(likely)]
    return Event(run, int(min(near)), int(max(near)), tuple(sorted(
        steps, key=lambda step: (step.series.owner in CONSEQUENT, -step.strength))))


def _fits(days: Floats, quantities: Sequence[TimeSeries], temperature: Floats | None) -> list[_Fit]:
    """Return the quantities that at least LEAST_RUNS runs have, with their run-to-run scatter."""
    fits = []
    for quantity in quantities:
        runs = np.flatnonzero(np.all(np.isfinite(quantity.values) & (quantity.u > 0), axis=1))
        if len(runs) >= LEAST_RUNS:
            fits.append(_Fit(quantity, runs, quantity.values[runs], _base(days[runs], temperature, runs),
                             np.ones(quantity.values.shape[1])))
    for like in {_like(fit) for fit in fits}:
        _set_scatter([fit for fit in fits if _like(fit) == like])
    return fits


def _set_scatter(fits: Sequence[_Fit]) -> None:
    """Set scatter and degrees of freedom of quantities that are alike, moderated component by component.

    With s^2 of d degrees of freedom for each, log s^2 spreads by trigamma(d / 2) by chance; what it spreads beyond that
    gives the degrees of freedom d0 of what they have in common, s0^2: (d0 s0^2 + d s^2) / (d0 + d)."""
    for components in _components(fits[0].y.shape[1]):
        own = np.array([run_to_run(fit.y[:, components], fit.series.u[fit.runs][:, components]) for fit in fits])
        dof = EFFICIENCY * np.array([len(fit.runs) * np.ones(own.shape[1]) for fit in fits])
        known = np.log(np.maximum(own, 0.1 * LEAST_SCATTER) ** 2) - scipy.special.digamma(dof / 2) + np.log(dof / 2)
        beyond = float(np.var(known, ddof=1) - np.mean(scipy.special.polygamma(1, dof / 2))) if known.size > 1 else 0.0
        prior = _inverse_trigamma(beyond) if beyond > 0 else np.inf
        common = np.exp(known.mean() + (scipy.special.digamma(prior / 2) - np.log(prior / 2) if beyond > 0 else 0.0))
        share = prior / (prior + dof) if beyond > 0 else np.ones_like(dof)
        scatter = np.sqrt(np.maximum(share * common + (1 - share) * own**2, LEAST_SCATTER**2))
        for fit, one, single in zip(fits, scatter, dof, strict=True):
            fit.scatter[components], fit.dof = one, min(fit.dof, float(np.min(np.minimum(single + prior, dof.sum()))))


def _like(fit: _Fit) -> tuple[str, int]:
    """Return what quantities of one run-to-run scatter have in common: owner and number of components."""
    return fit.series.owner, fit.y.shape[1]


def _components(count: int) -> list[list[int]]:
    """Return which components scatter alike: cos and sin of a harmonic; of a place radius, circle and axis do not."""
    return [[0], [1], [2]] if count == 3 else [list(range(count))]


def _inverse_trigamma(value: float) -> float:
    """Return x with trigamma(x / 2) = value > 0."""
    def lacks(log: float) -> float:
        return float(np.log(scipy.special.polygamma(1, np.exp(log)) / value))

    return 2.0 * float(np.exp(scipy.optimize.brentq(lacks, -20, 40)))


def _base(days: Floats, temperature: Floats | None, runs: Ints) -> Floats:
    """Return the columns that every quantity has: constant, time, temperature where it is known and varies."""
    span = float(np.ptp(days)) or 1.0
    columns = [np.ones(len(days)), (days - days.mean()) / span]
    if temperature is not None and np.all(np.isfinite(temperature[runs])) and np.ptp(temperature[runs]) > 0.1:
        columns.append(temperature[runs] - temperature[runs].mean())
    return np.column_stack(columns)


def run_to_run(values: Floats, u: Floats) -> Floats:
    """Return the scatter between neighbouring runs, (c,), in units of u: a Huber scale of differences, (m, c) of both.

    It solves mean min(d^2 / s^2, CUT^2) = E min(z^2, CUT^2) for normal z: steps and wear hardly change it."""
    square = (np.diff(values, axis=0) / np.hypot(u[1:], u[:-1])) ** 2
    tail = scipy.special.ndtr(-CUT)
    expected = 1 - 2 * tail - 2 * CUT * np.exp(-CUT**2 / 2) / np.sqrt(TWO_PI) + 2 * CUT**2 * tail
    found = np.maximum(np.median(square, axis=0) / scipy.special.ndtri(0.75) ** 2, NO_SCATTER)
    for _ in range(ITERATIONS):
        found = np.maximum(found * np.mean(np.minimum(square / found, CUT**2), axis=0) / expected, NO_SCATTER)
    return np.asarray(np.sqrt(found))


def forecast(days: Floats, curves: Floats, u: Floats, limit: float) -> Forecast:
    """Return when the range of curves that runs show since their last change, (m, n), reaches a limit.

    A straight line by weighted least squares at each angle; u: (m,) of the range. Range and slope are those of the
    fitted curve from the first run to the last, less (square) what noise leaves there, as it widens every range. The
    proposed interval ends before the 95 % bound of the line passes the limit, and is between half and twice the mean
    interval until now (ILAC-G24, a control chart with automatic adjustment). Raises InvalidData where there are fewer
    than LEAST_LINE runs at different times."""
    if len(days) < LEAST_LINE or np.ptp(days) <= 0:
        raise InvalidData(f'forecast: expected at least {LEAST_LINE} runs at different times, found {len(days)}')
    since = days - days[-1]
    lines, covariance, rest = _lines(since, curves, u)
    last, dof = lines[0], len(days) - LEAST_LINE + 1
    scatter = max(1.0, float(np.sum((rest[:, last.argmax()] - rest[:, last.argmin()]) ** 2)) / dof)
    covariance = covariance * scatter
    n = curves.shape[1]
    # mean range of n points, of a u of the range; Blom
    noise = np.sqrt(2.0) * scipy.special.ndtri((n - 0.375) / (n + 0.25))

    def span(at: float) -> float:
        row = np.array([1.0, at])
        return float(np.sqrt(max(0.0, np.ptp(row @ lines) ** 2 - noise**2 * (row @ covariance @ row))))

    level = span(0.0)
    slope = (level - span(since[0])) / -since[0]
    factor = scipy.special.stdtrit(dof, 0.95) if scatter > 1 else scipy.special.ndtri(0.95)
    expected = 0.0 if level >= limit else (limit - level) / slope if slope > 0 else np.inf
    present = float(np.ptp(days)) / (len(days) - 1)

    def bound(ahead: float) -> float:
        row = np.array([1.0, ahead])
        return float(level + ahead * slope + factor * np.sqrt(row @ covariance @ row) - limit)

    horizon = 1000.0 * present
    if bound(0.0) >= 0:
        soonest = 0.0
    else:
        soonest = float(scipy.optimize.brentq(bound, 0.0, horizon)) if bound(horizon) > 0 else np.inf
    interval = float(np.clip(soonest, 0.5 * present, 2.0 * present))
    return Forecast(level, float(slope), float(np.sqrt(covariance[1, 1])), float(expected), soonest, interval)


def course(days: Floats, values: Floats, u: Floats) -> tuple[float, float] | None:
    """Return where a straight line through values, (m,), begins and ends; None where scatter alone shows such a slope
    in FALSE_EVENTS of all histories, or runs are fewer than LEAST_RUNS or all at one time."""
    if len(days) < LEAST_RUNS or np.ptp(days) <= 0:
        return None
    since = days - days[-1]
    lines, covariance, rest = _lines(since, values[:, None], u)
    (last,), (slope,) = lines
    dof = len(days) - 2
    t = abs(slope) / np.sqrt(covariance[1, 1] * max(1.0, float(np.sum(rest**2)) / dof))
    is_event = t > scipy.special.stdtrit(dof, 1 - FALSE_EVENTS / 2)
    return (float(last + since[0] * slope), float(last)) if is_event else None


def _lines(time: Floats, values: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Return straight lines through the columns of values, (m, n), by weighted least squares.

    Their values at time 0 and slopes, (2, n); covariance of both for one column with standard uncertainties u, (m,);
    what they leave in units of u, (m, n)."""
    design = np.column_stack([np.ones(len(time)), time]) / u[:, None]
    covariance = np.linalg.inv(design.T @ design)
    lines = covariance @ (design.T @ (values / u[:, None]))
    return np.asarray(lines), np.asarray(covariance), np.asarray(values / u[:, None] - design @ lines)


def harmonics(angle: Floats, curve: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Return the cosine and sine amplitudes of a curve at n equally spaced angles and their standard uncertainties.

    curve, u: (m, n) or (n,). Returns two arrays (..., K, 2) for 1..K = (n - 1) // 2 per turn: 2/n sum y cos k phi and
    2/n sum y sin k phi; u as of independent points."""
    n = len(angle)
    orders = np.arange(1, (n - 1) // 2 + 1)
    basis = np.stack([np.cos(np.outer(orders, angle)), np.sin(np.outer(orders, angle))], axis=-1)
    values = 2.0 / n * np.einsum('...n,knc->...kc', curve, basis)
    spread = 2.0 / n * np.sqrt(np.einsum('...n,knc->...kc', u**2, basis**2))
    return values, spread
