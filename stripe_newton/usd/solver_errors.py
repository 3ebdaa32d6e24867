# SPDX-License-Identifier: Apache-2.0
"""Solver errors: what a solver does not take of a stage, by the path of the prim."""

from __future__ import annotations

import re
from collections.abc import Sequence

__all__ = ["solver_reason"]


def solver_reason(labels: Sequence[str], error: Exception) -> tuple[str, str]:
    """Path of the prim that an error of a solver is about, empty if it is unknown, and the error in one line.

    Args:
        labels: Paths of bodies, joints and shapes.
        error: The error; MuJoCo makes the name ``_World_arm`` of the path ``/World/arm``.
    """
    text = re.sub(r"\s+", " ", str(error)).strip()
    words = set(re.findall(r"[\w/.:-]+", text))
    path = next((label for label in labels if label in words or label.replace("/", "_") in words), "")
    return path, f"the solver does not take it: {text}"
