# SPDX-License-Identifier: Apache-2.0
"""Archives: many runs of many cells, a row each, in Parquet files."""
