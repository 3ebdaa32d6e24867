# SPDX-License-Identifier: Apache-2.0
"""Function check: which operations give other bits on a device than torch's own kernels, found by running them.

Torch and Warp may have been built with different versions of CUDA, whose mathematical functions may differ in the last
digit. An operation that does is left to torch, so that the rest of a hook can be fused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import torch

from .chain_kernels import compile_chains
from .fusing_mode import FusingMode
from .trusted import set_differing

__all__ = ["check_functions", "differing_functions"]

SAMPLES = 1 << 14
"""Number of arguments that each function is tried with."""

Function: TypeAlias = "Callable[[torch.Tensor, torch.Tensor], torch.Tensor]"


def _of_one(name: str) -> Function:
    function: Callable[[torch.Tensor], torch.Tensor] = getattr(torch, name)
    return lambda x, y: function(x)


def _of_two(name: str) -> Function:
    function: Callable[[torch.Tensor, torch.Tensor], torch.Tensor] = getattr(torch, name)
    return lambda x, y: function(x, y)


_ONE = (
    "sin", "cos", "tan", "atan", "sinh", "cosh", "tanh", "exp", "sigmoid", "reciprocal", "floor", "ceil", "trunc",
    "round", "frac", "neg", "abs", "sign", "square", "relu",
)  # fmt: skip
_TWO = ("add", "sub", "mul", "div", "atan2", "remainder", "fmod", "maximum", "minimum", "copysign")
_OF_ANY: dict[str, Function] = {
    **{name: _of_one(name) for name in _ONE},
    **{name: _of_two(name) for name in _TWO},
    "clamp": lambda x, y: x.clamp(-0.7, 0.8),
    "rsub": lambda x, y: torch.rsub(x, 3.1),
    "lerp": lambda x, y: torch.lerp(x, y, 0.3) + torch.lerp(x, y, 0.8),
    "addcmul": lambda x, y: torch.addcmul(x, y, y, value=0.3),
    "addcdiv": lambda x, y: torch.addcdiv(x, x, y, value=0.3),
}
_OF_POSITIVE: dict[str, Function] = {
    "log": lambda x, y: torch.log(x),
    "sqrt": lambda x, y: torch.sqrt(x),
    "rsqrt": lambda x, y: torch.rsqrt(x),
    "pow": lambda x, y: x**1.7,
}
_OF_SINES: dict[str, Function] = {
    "asin": lambda x, y: torch.asin(x),
    "acos": lambda x, y: torch.acos(x),
}

_CHECKED: set[str] = set()


def check_functions(device: str) -> None:
    """Find the operations that differ, once for each GPU. On a CPU nothing is recorded, and none is left to torch."""
    if device != "cpu" and device not in _CHECKED:
        _CHECKED.add(device)
        set_differing(device, differing_functions(device))


def differing_functions(device: str) -> set[str]:
    """Names of operations on float32 whose code in chains gives other bits than torch."""
    where = torch.device(device)
    generator = torch.Generator(where).manual_seed(1)
    x, y = (torch.randn(SAMPLES, generator=generator, device=where) for _ in range(2))
    x, y = x * torch.exp(2.0 * y), y + 0.01 * torch.sign(y)
    cases = [(n, f, x) for n, f in _OF_ANY.items()] + [(n, f, x.abs() + 1e-6) for n, f in _OF_POSITIVE.items()]
    cases += [(n, f, x.sin()) for n, f in _OF_SINES.items()]
    traced, launched = (FusingMode(where, (SAMPLES,), launches) for launches in (False, True))
    with torch.no_grad():
        with traced:
            expected = _results(traced, cases, y)
        compile_chains(traced.codes, device)
        with launched:
            found = _results(launched, cases, y)
    pairs = zip(cases, found, expected, strict=True)
    return {name for (name, _, _), one, two in pairs if not torch.equal(one.nan_to_num(), two.nan_to_num())}


def _results(mode: FusingMode, cases: list[tuple[str, Function, torch.Tensor]], y: torch.Tensor) -> list[torch.Tensor]:
    found = []
    for _, function, x in cases:
        found.append(function(x, y))
        mode.flush()
    return found
