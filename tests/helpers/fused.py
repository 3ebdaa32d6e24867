# SPDX-License-Identifier: Apache-2.0
"""Functions of torch run with their operations fused."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import warp as wp

from stripe_newton.envs.hook_graphs.fused import chain_kernels
from stripe_newton.envs.hook_graphs.fused.chain import ChainCode
from stripe_newton.envs.hook_graphs.fused.chain_kernels import compile_chains
from stripe_newton.envs.hook_graphs.fused.fusing_mode import FusingMode

__all__ = ["Fused", "compile_for_gpu", "gpu_codes", "run_fused"]


@dataclass
class Fused:
    """A fused run of a function.

    Attributes:
        result: What the function returned.
        left: What ``memory`` gave after the run.
        traced: The run in which torch computed.
        launched: The run in which the chains' kernels did.
    """

    result: Any
    left: Any
    traced: FusingMode
    launched: FusingMode


def run_fused(
    functions: Mapping[str, Callable[[], Any]],
    rows: int | tuple[int, ...],
    restore: Callable[[], None] = lambda: None,
    memory: Callable[[], Any] = lambda: None,
    device: str = "cpu",
) -> dict[str, Fused]:
    """Trace functions, compile all of their chains as one module, and run them by these.

    Args:
        functions: The functions by name.
        rows: Numbers of rows.
        restore: Brings the state back that the functions change; called before each run.
        memory: Returns what is to be kept of the state after a run.
        device: Device of the tensors.
    """
    sizes = (rows,) if isinstance(rows, int) else rows
    where = torch.device(device)
    with torch.no_grad():
        traced = {name: FusingMode(where, sizes, launches=False) for name in functions}
        for name, function in functions.items():
            restore()
            with traced[name]:
                kept = function()  # alive until the end of the run, as in the next one
            del kept
        compile_chains([code for mode in traced.values() for code in mode.codes], device)
        found = {}
        for name, function in functions.items():
            mode = FusingMode(where, sizes, launches=True)
            restore()
            with mode:
                result = function()
            found[name] = Fused(result, memory(), traced[name], mode)
    return found


def gpu_codes(
    functions: Mapping[str, Callable[[], Any]], rows: int | tuple[int, ...], restore: Callable[[], None] = lambda: None
) -> list[ChainCode]:
    """The distinct chains of functions, in the code for a GPU; arguments as for :func:`run_fused`."""
    sizes = (rows,) if isinstance(rows, int) else rows
    codes: dict[str, ChainCode] = {}
    for function in functions.values():
        mode = FusingMode(torch.device("cpu"), sizes, launches=False)
        mode.for_cuda = True
        restore()
        with torch.no_grad(), mode:
            kept = function()
        del kept
        codes |= {code.digest: code for code in mode.codes}
    return list(codes.values())


def compile_for_gpu(codes: Sequence[ChainCode], folder: Path) -> str:
    """PTX of chains; the compiler needs no GPU."""
    module, _ = chain_kernels.module_of(codes, fuse_fp=True)
    (path,) = wp.compile_aot_module(module, arch=90, module_dir=folder, use_ptx=True)
    return Path(path).read_text(encoding="utf-8")
