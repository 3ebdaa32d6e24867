# SPDX-License-Identifier: Apache-2.0
"""Packages can be imported first, whatever the order in which others are: none needs another to have been there."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize("module", ["stripe_tasks.forest", "stripe_newton.terrains", "stripe_newton.solvers"])
def test_a_package_can_be_imported_first(module):
    """It brings no library with it that only some users have installed."""
    code = f"import sys, {module}; print(*{{'h5py', 'optuna', 'skrl', 'viser'}}.intersection(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stdout.strip()
