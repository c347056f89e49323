# SPDX-License-Identifier: Apache-2.0
"""The studio: a page in the browser on which a run, its model and a cell are looked at."""
