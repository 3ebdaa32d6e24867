# SPDX-License-Identifier: Apache-2.0
"""Report of runs: one HTML file with curves, times, films and changed settings, written while a run trains."""
