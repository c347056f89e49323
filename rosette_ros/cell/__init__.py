# SPDX-License-Identifier: Apache-2.0
"""A whole cell on this computer: supervisor and client."""
