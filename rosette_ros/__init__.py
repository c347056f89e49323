# SPDX-License-Identifier: Apache-2.0
"""Calibrates rotary tables by the three-rosette method, and finds what a model of the cell leaves out.

`import rosette_ros as rosette` gives the interface for Python (docs/python.md), loaded when it is used."""

import importlib
import os
from typing import TYPE_CHECKING, Any

from rosette_ros.invocation import __version__ as __version__

if TYPE_CHECKING:  # for editors and type checkers; _PLACES says the same
    from rosette_ros.api.archived_runs import archived_runs as archived_runs
    from rosette_ros.api.cells import CellDiagnosed as CellDiagnosed
    from rosette_ros.api.curve_sources import CurvesCompared as CurvesCompared
    from rosette_ros.api.curve_sources import compare_curves as compare_curves
    from rosette_ros.api.documents import certify as certify
    from rosette_ros.api.documents import report as report
    from rosette_ros.api.effect_library import EffectList as EffectList
    from rosette_ros.api.effect_library import add_effect as add_effect
    from rosette_ros.api.effect_library import add_reader as add_reader
    from rosette_ros.api.effect_library import effects as effects
    from rosette_ros.api.effect_library import model as model
    from rosette_ros.api.evaluating import Budgeted as Budgeted
    from rosette_ros.api.evaluating import Compared as Compared
    from rosette_ros.api.evaluating import Corrected as Corrected
    from rosette_ros.api.evaluating import Diagnosed as Diagnosed
    from rosette_ros.api.evaluating import ErrorCurves as ErrorCurves
    from rosette_ros.api.evaluating import Evaluation as Evaluation
    from rosette_ros.api.evaluating import JointEvaluation as JointEvaluation
    from rosette_ros.api.evaluating import Ladder as Ladder
    from rosette_ros.api.evaluating import budget as budget
    from rosette_ros.api.evaluating import compare as compare
    from rosette_ros.api.evaluating import correct as correct
    from rosette_ros.api.evaluating import diagnose as diagnose
    from rosette_ros.api.evaluating import evaluate as evaluate
    from rosette_ros.api.evaluating import ladder as ladder
    from rosette_ros.api.measurement import Measurement as Measurement
    from rosette_ros.api.measurement import read as read
    from rosette_ros.api.plans import Advised as Advised
    from rosette_ros.api.plans import NextSteps as NextSteps
    from rosette_ros.api.plans import Plan as Plan
    from rosette_ros.api.plans import PlansCompared as PlansCompared
    from rosette_ros.api.plans import advise as advise
    from rosette_ros.api.plans import next_readings as next_readings
    from rosette_ros.api.plans import plan as plan
    from rosette_ros.api.result import PackageMissing as PackageMissing
    from rosette_ros.api.result import Result as Result
    from rosette_ros.api.simulating import simulate as simulate
    from rosette_ros.core.effects import courses as courses
    from rosette_ros.core.effects import motions as motions
    from rosette_ros.core.effects.effect import Course as Course
    from rosette_ros.core.effects.effect import Motion as Motion
    from rosette_ros.core.effects.effect import PhysicalEffect as PhysicalEffect
    from rosette_ros.core.effects.effect import Quantity as Quantity
    from rosette_ros.core.effects.effect import Searched as Searched
    from rosette_ros.core.effects.effect import Setting as Setting
    from rosette_ros.core.effects.effect import grid as grid
    from rosette_ros.core.model.model import Model as Model
    from rosette_ros.core.run.errors import InvalidConfig as InvalidConfig
    from rosette_ros.core.run.errors import InvalidData as InvalidData
    from rosette_ros.core.run.errors import InvalidModel as InvalidModel
    from rosette_ros.core.run.errors import InvalidPlan as InvalidPlan
    from rosette_ros.core.run.errors import NotDeterminable as NotDeterminable
    from rosette_ros.core.run.errors import RosetteError as RosetteError
    from rosette_ros.core.run.records import ErrorMotions as ErrorMotions
    from rosette_ros.core.run.records import Run as Run

# The matrices are small: more than one thread of the linear algebra library mostly waits for the others, and the last
# digits of a sum depend on their number. It is read once, when numpy is imported.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

_PLACES = {
    'api.archived_runs': 'archived_runs',
    'api.cells': 'CellDiagnosed',
    'api.curve_sources': 'CurvesCompared compare_curves',
    'api.documents': 'certify report',
    'api.effect_library': 'EffectList add_effect add_reader effects model',
    'api.evaluating':
        'Budgeted Compared Corrected Diagnosed ErrorCurves Evaluation JointEvaluation Ladder budget compare correct '
        'diagnose evaluate ladder',
    'api.measurement': 'Measurement read',
    'api.plans': 'Advised NextSteps Plan PlansCompared advise next_readings plan',
    'api.result': 'PackageMissing Result',
    'api.simulating': 'simulate',
    'core.effects.effect': 'Course Motion PhysicalEffect Quantity Searched Setting grid',
    'core.model.model': 'Model',
    'core.run.errors':
        'InvalidConfig InvalidData InvalidModel InvalidPlan NotDeterminable RosetteError',
    'core.run.records': 'ErrorMotions Run',
}
_PLACE = {name: module for module, names in _PLACES.items() for name in names.split()}
_MODULES = ('courses', 'motions')
__all__ = [*_PLACE, *_MODULES]


def __getattr__(name: str) -> Any:
    """Load what is used of the interface."""
    if name in _MODULES:
        return importlib.import_module(f'rosette_ros.core.effects.{name}')
    if name not in _PLACE:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    found = globals()[name] = getattr(importlib.import_module(f'rosette_ros.{_PLACE[name]}'), name)
    return found


def __dir__() -> list[str]:
    return [*globals(), *__all__]
