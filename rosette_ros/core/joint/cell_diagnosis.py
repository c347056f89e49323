# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a cell, from several of its runs: what comes again, and what was there once.

    runs = [searched(name, run) for ...]    what each run says: run_causes.py
    found = diagnose_cell(runs)             the rates of all causes: cell_rates.py; sizes, constants, changes
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.log_evidence import Place
from rosette_ros.core.diagnosis.run_search import RunSearch, with_places
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free import OF, TIMES
from rosette_ros.core.effects.library import effects_of
from rosette_ros.core.joint.cell_rates import CellRates, is_event
from rosette_ros.core.joint.run_causes import RunCauses, causes_in
from rosette_ros.core.model.experience import Experience, KnownCause
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.axes import refuse_other_axes
from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.records import UNLIKELY, Floats, Run
from rosette_ros.core.run.same_readings import is_once_more
from rosette_ros.core.sight.bank import why_not_judged
from rosette_ros.core.sight.limits import LISTED

LIKELY = 0.5
"""Probability from which on a cause is said to be in a run, or a property of the cell."""
FEWEST = 4
"""Runs that a change of the size is looked for in, at least."""
UNIT_RATIO = 100.0
"""Ratio of the radii of plates from which on a wrong unit is the likelier reason."""


@dataclass(frozen=True, eq=False)
class CellRun:
    """One run of a cell, as it was searched.

    conditions: numbers by which sizes may change, such as 'temperature', °C; causes: what it says; base: the fit of the
    model under its noise, places: members of the hypotheses that are kept, by their names; both None and empty where
    only what it says is known.
    """

    name: str
    causes: RunCauses
    conditions: Mapping[str, float] = field(default_factory=dict)
    run: Run | None = None
    base: Fit | None = None
    places: Mapping[tuple[str, ...], tuple[Place, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class CauseInRun:
    """A cause in one run: its probability in the cell, and by this run alone; size and standard uncertainty, m rms over
    all coordinates, NaN where it is not likely there; judged: whether the run says anything of it."""

    p: float
    alone: float
    size: float = np.nan
    u: float = np.nan
    judged: bool = True


@dataclass(frozen=True)
class CommonConstant:
    """A constant of a law from all runs together, as Parameter has it."""

    name: str
    value: float
    u: float
    unit: str


@dataclass(frozen=True)
class SizeChange:
    """How the size of a cause changes with a condition: per unit of it, m, its standard uncertainty, and p of none."""

    condition: str
    slope: float
    u: float
    p: float


@dataclass(frozen=True)
class CellCause:
    """A cause in a cell: what moves with what, by one of some laws.

    bodies, variables: in the words of motions without a name; laws: names, each with the probability that it is the
    property, likeliest first; again: that one of them is a property of the cell; expected: number of runs that have
    it; rate: probability that the next run has it; in_runs: of each run; size, spread: typical size, m rms, and the
    standard deviation of its logarithm; constants: of the likeliest law; changes: of its size.
    """

    bodies: tuple[str, ...]
    variables: tuple[str, ...]
    laws: tuple[tuple[str, float], ...]
    again: float
    expected: float
    rate: float
    in_runs: tuple[CauseInRun, ...]
    size: float = np.nan
    spread: float = np.nan
    constants: tuple[CommonConstant, ...] = ()
    changes: tuple[SizeChange, ...] = ()

    @property
    def name(self) -> str:
        """The likeliest law."""
        return self.laws[0][0]

    @property
    def comes_again(self) -> bool:
        """Whether it is likely a property of the cell."""
        return self.again > LIKELY

    @property
    def judged(self) -> int:
        """The number of runs that say anything of it."""
        return sum(one.judged for one in self.in_runs)


@dataclass(frozen=True, eq=False)
class CellDiagnosis:
    """What the runs of a cell say of it.

    runs: their names; properties: causes that come again, the likeliest first; once: causes that were likely in a run,
    and are none of these; doubtful: that may be properties; hidden: effects that none of the runs can show; rates: all
    of it.
    """

    runs: tuple[str, ...]
    properties: tuple[CellCause, ...]
    once: tuple[CellCause, ...]
    doubtful: tuple[CellCause, ...]
    hidden: tuple[str, ...]
    rates: CellRates

    @property
    def level(self) -> Level:
        """How the cell is: bad where something comes again, doubtful where something was there."""
        if self.properties:
            return Level.BAD
        return Level.DOUBTFUL if self.once else Level.GOOD


def searched(name: str, run: Run, model: Model, conditions: Mapping[str, float] | None = None) -> CellRun:
    """Return a run of a cell as it is searched by itself; raises NotDeterminable."""
    search = RunSearch(run, model)
    posterior, causes = search.posterior, causes_in(search)
    places: dict[tuple[str, ...], tuple[Place, ...]] = {}
    for names, noise in posterior.keys:
        if noise == posterior.best[1]:
            places.setdefault(tuple(dict.fromkeys(names)), posterior.places((names, noise)))
    kept = {names: places[names] for names in causes.hypotheses if names in places}
    known = run.temperature[np.isfinite(run.temperature)]
    stated = {'temperature': float(known.mean())} if known.size else {}
    return CellRun(name, causes, stated | dict(conditions or {}), run, search.base, kept)


def refuse_unlike(runs: Sequence[tuple[str, Run]]) -> None:
    """Refuse runs that are not of one table in one unit, or that are given twice; raises InvalidData."""
    if len(runs) < 2:
        raise InvalidData(f'expected several runs of a cell, found {len(runs)}; a single run is diagnosed by itself')
    refuse_other_axes([(name, one.rotation) for name, one in runs])
    first, one = runs[0]
    for place, (name, other) in enumerate(runs[1:], 1):
        ratio = max(other.radius / one.radius, one.radius / other.radius)
        if ratio > UNIT_RATIO:
            raise InvalidData(f'{name}: expected coordinates in the unit of {first}, found a plate whose radius '
                              f'differs by a factor of {ratio:.0f}, as where one is in another unit; import it anew')
        for before, earlier in runs[:place]:
            if is_once_more(earlier.centre, other.centre):
                raise InvalidData(f'{before} and {name}: expected different runs, found the same ball centres in both; '
                                  'leave one out')


def diagnose_cell(runs: Sequence[CellRun]) -> CellDiagnosis:
    """Return what the runs of a cell say of it, each as it was searched."""
    rates = CellRates([one.causes for one in runs])
    likely = {name: sum(rates.p(k, name) for k in range(len(runs))) for name in rates.prior
              if rates.again(name) > LISTED or any(rates.p(k, name) > LISTED for k in range(len(runs)))}
    sizes = [_sizes(one, rates.posteriors[place]) for place, one in enumerate(runs)]
    causes = [_cause(group, rates, runs, sizes) for group in _grouped(likely, rates)]
    again = tuple(sorted((one for one in causes if one.comes_again), key=lambda one: (-one.again, -one.expected)))
    rest = [one for one in causes if not one.comes_again]
    once = tuple(one for one in rest if any(each.p > LIKELY for each in one.in_runs))
    doubtful = tuple(sorted((one for one in rest if one not in once and one.again > LISTED),
                            key=lambda one: -one.again))
    every = frozenset.intersection(*(one.causes.silent for one in runs))
    first = next((one.run for one in runs if one.run), None)
    hidden = tuple(name for name, effect in (effects_of(first) if first else {}).items()
                   if first and name in every and not why_not_judged(effect, first))
    return CellDiagnosis(tuple(one.name for one in runs), again, once, doubtful, hidden, rates)


def experience_of(rates: CellRates, cell: str = '', table: str = '', cmm: str = '', begin: str = '',
                  end: str = '') -> Experience:
    """Return what the runs of a cell have taught; names and days as of Experience.

    Causes are those that may be properties of it; what it never had comes as often as anywhere."""
    again = [name for name in rates.candidates if rates.again(name) > LISTED]
    each = [run.of_each(p) for run, p in zip(rates.runs, rates.posteriors)]
    causes = []
    for name in sorted(again, key=lambda one: -rates.again(one)):
        size, spread = _typical(rates, name, ())
        causes.append(KnownCause(
            name, rates.rate(name), rates.again(name), sum(one.get(name, 0.0) for one in each),
            sum(name not in run.silent for run in rates.runs), size, spread,
            tuple((one.name, one.value, one.u) for one in _constants(rates, name))))
    return Experience(tuple(causes), cell, table, cmm, len(rates.runs), begin, end)


def statement_of(name: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return the bodies that a cause moves, and the variables with which."""
    if name in LAWS:
        return LAWS[name].moved(Setting()), LAWS[name].driven_by(Setting())
    variables, _, body = name.partition(OF)
    return frozenset([body]), frozenset(variables.split(TIMES))


def _grouped(likely: Mapping[str, float], rates: CellRates) -> list[tuple[str, ...]]:
    """Return causes that move one of the same bodies with the same variables together, the likeliest first; events,
    which do not come again, are causes of their own."""
    groups: list[list[str]] = []
    for name in sorted(likely, key=lambda one: (-rates.again(one), -likely[one])):
        bodies, variables = statement_of(name)
        for group in groups:
            own, with_what = statement_of(group[0])
            if is_event(name) == is_event(group[0]) and variables == with_what and not bodies.isdisjoint(own):
                group.append(name)
                break
        else:
            groups.append([name])
    return [tuple(group) for group in groups]


def _cause(names: tuple[str, ...], rates: CellRates, runs: Sequence[CellRun],
           sizes: Sequence[Mapping[str, tuple[float, float]]]) -> CellCause:
    """Return what is said of causes that say the same."""
    in_runs = []
    for place, one in enumerate(runs):
        p, alone = rates.p(place, *names), one.causes.of(names)
        judged = not one.causes.silent.issuperset(names)
        found = next((sizes[place][name] for name in names if name in sizes[place]), (np.nan, np.nan))
        in_runs.append(CauseInRun(p, alone, *(found if p > LIKELY else (np.nan, np.nan)), judged))
    bodies, variables = statement_of(names[0])
    laws = tuple((name, rates.again(name)) for name in names)
    expected = sum(one.p for one in in_runs)
    size, spread = _typical(rates, names[0], in_runs)
    unlikely = [rates.rate(name) for name in names]
    return CellCause(tuple(sorted(bodies)), tuple(sorted(variables)), laws, rates.again_of(names), expected,
                     min(sum(unlikely), 1.0), tuple(in_runs), size, spread, _constants(rates, names[0]),
                     tuple(_changes(in_runs, runs)))


def _typical(rates: CellRates, name: str, in_runs: Iterable[CauseInRun]) -> tuple[float, float]:
    """Return the typical size of a cause, m rms, and the standard deviation of its logarithm."""
    found = rates.size(name)
    if not math.isnan(found[0]):
        return found
    known = [np.log(one.size) for one in in_runs if one.size > 0]
    return (float(np.exp(np.mean(known))), float(np.std(known))) if known else (np.nan, np.nan)


def _constants(rates: CellRates, name: str) -> tuple[CommonConstant, ...]:
    """Return the constants of the law of a property, from all runs together."""
    out, units = [], {one.name: one for one in LAWS[name].searched} if name in LAWS else {}
    for what, (values, p) in rates.constants(name).items():
        if units[what].kind == 'choice':
            best = int(np.argmax(p))
            if p[best] >= 1 - LISTED:
                out.append(CommonConstant(what, float(values[best]), 0.0, units[what].unit))
            continue
        mean, width = float(p @ values), np.gradient(values)  # of one value the runs tell no more than its neighbours
        u = float(np.sqrt(p @ ((values - mean)**2 + width**2 / 12)))
        out.append(CommonConstant(what, mean, u, units[what].unit))
    return tuple(out)


def _sizes(one: CellRun, p: Floats) -> dict[str, tuple[float, float]]:
    """Return the size of each cause of the likeliest hypothesis of a run in the cell, and its uncertainty, m rms."""
    best = [one.causes.hypotheses[k] for k in np.argsort(-p).tolist()]
    names = next((some for some in best if some in one.places), ())
    if one.base is None or not names:
        return {}
    try:
        fitted = with_places(one.base, one.places[names])
    except NotDeterminable:
        return {}
    return sizes_in(fitted, len(one.base.effects))


def sizes_in(fitted: Fit, known: int = 0) -> dict[str, tuple[float, float]]:
    """Return the size of each effect of a fit beyond the first `known`, m rms over all coordinates, with its standard
    uncertainty, sizes of one name added in squares."""
    squares: dict[str, float] = {}
    slopes: dict[str, Floats] = {}
    start, scale = 0, fitted.weighted_sigma
    for place, (term, effect) in enumerate(zip(fitted.model.terms, fitted.effects)):
        width = len(term.effect.amplitudes(fitted.run, effect.setting))
        own = slice(start, start + width)
        start += width
        if place < known:
            continue
        columns = fitted.joint.columns[own].reshape(width, -1)
        slope = columns @ effect.displacement.reshape(-1) / effect.displacement.size
        name = effect.name if term.effect.name in LAWS else _free_name(effect.setting)
        squares[name] = squares.get(name, 0.0) + effect.rms**2
        every = slopes.setdefault(name, np.zeros(len(fitted.joint.cofactor)))
        every[own] = slope
    out = {}
    for name, square in squares.items():
        size = float(np.sqrt(square))
        variance = float(slopes[name] @ fitted.joint.cofactor @ slopes[name])
        out[name] = size, scale * max(variance, 0.0)**0.5 / max(size, 1e-300)
    return out


def _free_name(setting: Mapping[str, float | str]) -> str:
    return f'{setting["of"]}{OF}{setting["along"]}'


def _changes(in_runs: Sequence[CauseInRun], runs: Sequence[CellRun]) -> Iterable[SizeChange]:
    """Yield how a size changes with each condition that all runs which have it state, where that is no chance.

    The size scatters from run to run by more than its uncertainty: the residual of the line says by how much."""
    known = [(one, each) for one, each in zip(runs, in_runs) if each.size > 0]
    if len(known) < FEWEST:
        return
    size: Floats = np.array([each.size for _, each in known])
    u: Floats = np.array([each.u for _, each in known])
    for condition in dict.fromkeys(name for one, _ in known for name in one.conditions):
        if not all(condition in one.conditions for one, _ in known):
            continue
        values: Floats = np.array([one.conditions[condition] for one, _ in known])
        off = values - values.mean()
        if not np.ptp(values) > 0:
            continue
        slope = float(off @ size / (off @ off))
        left = size - size.mean() - slope * off
        variance = max(float(left @ left) / (len(known) - 2), float(np.mean(u**2)))
        error = float(np.sqrt(variance / (off @ off)))
        p = float(2 * scipy.special.stdtr(len(known) - 2, -abs(slope) / max(error, 1e-300)))
        if p < UNLIKELY:
            yield SizeChange(condition, slope, error, p)
