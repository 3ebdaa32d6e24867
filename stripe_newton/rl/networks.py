# SPDX-License-Identifier: Apache-2.0
"""The networks of an algorithm of rsl_rl."""

from __future__ import annotations

from typing import Any

from rsl_rl.models import MLPModel

__all__ = ["networks_of"]

_NAMES = ("actor", "critic"), ("student", "teacher")


def networks_of(algorithm: Any) -> dict[str, MLPModel]:
    """By name: actor and critic, or student and teacher; the first is the policy."""
    names = next(names for names in _NAMES if hasattr(algorithm, names[0]))
    return {name: getattr(algorithm, name) for name in names}
