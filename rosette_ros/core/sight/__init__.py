# SPDX-License-Identifier: Apache-2.0
"""What an order of measurement shows of an effect: columns of candidates, sensitivity."""
