# SPDX-License-Identifier: Apache-2.0
"""Functions of torch run with their operations fused, on the CPU."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch

from stripe_newton.envs.hook_graphs.fused.chain_kernels import compile_chains
from stripe_newton.envs.hook_graphs.fused.fusing_mode import FusingMode

__all__ = ["Fused", "run_fused"]


@dataclass
class Fused:
    """A fused run of a function.

    Attributes:
        result: What the function returned.
        traced: The run in which torch computed.
        launched: The run in which the chains' kernels did.
    """

    result: Any
    traced: FusingMode
    launched: FusingMode


def run_fused(
    functions: Mapping[str, Callable[[], Any]], rows: int | tuple[int, ...], restore: Callable[[], None] = lambda: None
) -> dict[str, Fused]:
    """Trace functions, compile all of their chains as one module, and run them by these.

    Args:
        functions: The functions by name.
        rows: Numbers of rows.
        restore: Brings the state back that the functions have changed.
    """
    sizes = (rows,) if isinstance(rows, int) else rows
    device = torch.device("cpu")
    with torch.no_grad():
        traced = {name: FusingMode(device, sizes, launches=False) for name in functions}
        for name, function in functions.items():
            with traced[name]:
                kept = function()  # alive until the end of the run, as in the next one
            del kept
        compile_chains([code for mode in traced.values() for code in mode.codes], "cpu")
        restore()
        found = {}
        for name, function in functions.items():
            mode = FusingMode(device, sizes, launches=True)
            with mode:
                result = function()
            found[name] = Fused(result, traced[name], mode)
    return found
