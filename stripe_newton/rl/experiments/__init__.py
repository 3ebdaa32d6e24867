# SPDX-License-Identifier: Apache-2.0
"""Experiments over many runs: sweeps over fields and seeds, and comparisons of the runs' curves and configs."""
