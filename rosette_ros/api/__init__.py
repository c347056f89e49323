# SPDX-License-Identifier: Apache-2.0
"""The interface for Python, which `import rosette_ros as rosette` gives: what the command line does, as functions.

Every function calls `analysis`, `io` and `presentation`, as the command does, and calculates nothing itself."""
