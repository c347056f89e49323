# SPDX-License-Identifier: Apache-2.0
"""The library of effects: each writes only its own physics; adding and fitting belong to fit."""
