# SPDX-License-Identifier: Apache-2.0
"""Paths of the checkout, and the environment variables of programs that a test starts from it."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
HELPERS = ROOT / "tests" / "helpers"
TOOLS = ROOT / "tools"

PYTHONPATH = os.pathsep.join(str(ROOT / name) for name in (".", "kernels", "tasks"))
"""Value of ``PYTHONPATH`` with which a program finds the packages, as pyproject.toml sets it for pytest."""
