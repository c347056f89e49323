# SPDX-License-Identifier: Apache-2.0
"""Blind tests of the diagnosis: the truth is drawn from physics, the diagnosis sees readings, then both are compared.

Nothing here is taken from the library of effects or from the diagnosis, except where the truth of a library effect's
parameters is asked for: noise kinds and causes are written from physics and judged by it.
"""
