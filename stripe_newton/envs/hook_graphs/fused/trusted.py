# SPDX-License-Identifier: Apache-2.0
"""Trusted operations: those whose code in chains gives torch's bits on a device."""

from __future__ import annotations

import torch

from .call import Call
from .rows import Unsupported

__all__ = ["require_trusted", "set_differing"]

_DIFFERING: dict[torch.device, frozenset[str]] = {}

_EXACT_POWERS = (0, 1, 2, 3, -1, -2)
"""Exponents for which a power is products and a quotient."""


def set_differing(device: str, names: set[str]) -> None:
    """Set the operations that are left to torch on a device."""
    _DIFFERING[torch.device(device)] = frozenset(names)


def require_trusted(call: Call) -> None:
    """Check that an operation is none of those that are left to torch.

    Raises:
        Unsupported: if it is.
    """
    differing = _DIFFERING.get(call.device)
    if differing is None or call.name not in differing:
        return
    if call.name == "pow" and call.named.get("exponent") in _EXACT_POWERS:
        return
    raise Unsupported("rounds differently here")
