# SPDX-License-Identifier: Apache-2.0
"""Recovery from falls: a humanoid gets up from wherever it lies."""
