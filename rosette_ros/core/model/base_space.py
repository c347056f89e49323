# SPDX-License-Identifier: Apache-2.0
"""Which way of solving the base model a run allows."""

import numpy as np

from rosette_ros.core.errors import InvalidModel
from rosette_ros.core.model.base_model import BaseSpace, CompleteSpace
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Whitening
from rosette_ros.core.model.normal_space import NormalSpace
from rosette_ros.core.model.reduced_space import ReducedSpace, Reduction
from rosette_ros.core.records import Run


def base_space(run: Run, lever: float, terms: tuple[str, ...] = BASE_TERMS,
               whitening: Whitening | None = None) -> BaseSpace:
    """Return the space of the base model on a run: by FFT or by frequency where it can be, else by normal equations.

    lever: radius at which rotations act, m; terms: subset of BASE_TERMS; whitening: of the noise, None where it is
    white and equal; what a space makes of columns stands in white coordinates. Raises NotDeterminable, with what cannot
    be determined, for too little data.
    """
    unknown = [term for term in terms if term not in BASE_TERMS]
    if unknown:
        raise InvalidModel(f'base: wanted some of {", ".join(BASE_TERMS)}, got {unknown[0]!r}')
    whitening = whitening or Whitening(run.size, np.ones(3))
    if whitening.by_axis and whitening.sd[0] == whitening.sd[1]:
        if run.is_complete:
            return CompleteSpace(run, lever, terms, whitening)
        reduction = Reduction.of(run)
        if reduction and set(terms) == {*BASE_TERMS}:
            return ReducedSpace(run, lever, reduction, whitening)
    return NormalSpace(run, lever, terms, whitening)
