# SPDX-License-Identifier: Apache-2.0
"""An evaluation as JSON, schema rosette-evaluation/1: one place for every door."""

import math

from rosette_ros.core.records import CURVES, ISO_NAMES

SCHEMA = 'rosette-evaluation/1'
COVERAGE_FACTOR = 2
"""k of expanded uncertainties, about 95 % (GUM 6.2)."""


def evaluation_json(report):
    """Return a Report as a mapping for JSON, SI; what is not finite becomes None.

    u holds standard uncertainties; expanded ones are `coverage_factor` times as large.
    """
    run, fit, motions = report.run, report.fit, report.error_motions
    return finite({
        'schema': SCHEMA, 'run_id': run.run_id, 'n': run.n, 'radius_m': run.radius,
        'mean_radius_m': fit.mean_radius, 'readings': run.size, 'completeness': run.completeness,
        'angle_rad': motions.angle.tolist(),
        **{f'{curve}_{_unit(curve)}': motions[curve].tolist() for curve in CURVES},
        'u': {f'{curve}_{_unit(curve)}': motions.uncertainty(curve).tolist() for curve in CURVES},
        'coverage_factor': COVERAGE_FACTOR, 'iso_names': dict(ISO_NAMES),
        'plate_m': report.plate.tolist(), 'cmm_m': report.cmm.tolist(), 'fit': fit_json(fit),
        'effects': _effects_json(report), 'gauge': list(report.gauge)})


def finite(value):
    """Return nested lists and dicts with None in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _unit(curve):
    return 'm' if curve.startswith('ct') else 'rad'


def fit_json(fit):
    """Return what was fitted and how well; for every mapping that speaks of a fit."""
    run = fit.run
    return {
        'rms_m': fit.rms, 'sigma_m': fit.sigma, 'sigma_source': fit.sigma_source, 'dof': fit.dof,
        'rank': fit.rank, 'model': list(fit.model.names), 'model_hash': fit.model.hash,
        'repeatability_m': run.repeatability, 'repeatability_dof': run.repeatability_dof,
        'reduced_chi_square': fit.reduced_chi_square, 'lack_of_fit_p': fit.lack_of_fit_p}


def _effects_json(report):
    """Return effects by name; one that stands twice is told apart by its fixed parameters."""
    names = [term.name for term in report.model.terms]
    keys = [name if names.count(name) == 1 else str(term)
            for name, term in zip(names, report.model.terms, strict=True)]
    return {key: {parameter.name: {'value': parameter.value, 'u': parameter.u,
                                   'unit': parameter.unit} for parameter in effect.parameters}
            for key, effect in zip(keys, report.effects, strict=True)}
