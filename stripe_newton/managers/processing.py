# SPDX-License-Identifier: Apache-2.0
"""Source for what lies between a term and the policy: noise and delay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from stripe_kernels.mdp import random
from stripe_kernels.processing import (
    NOISE_ABS,
    NOISE_ADD,
    NOISE_SCALE,
    combine_noise,
    sample_constant,
    sample_gaussian,
    sample_uniform,
)
from stripe_newton.noise import ConstantNoiseCfg, GaussianNoiseCfg, NoiseCfg, UniformNoiseCfg

from .context import ManagerContext

__all__ = ["delayed", "noisy", "sampled"]

_KINDS: dict[type, tuple[Any, str, str | None]] = {
    ConstantNoiseCfg: (sample_constant, "bias", None),
    UniformNoiseCfg: (sample_uniform, "n_min", "n_max"),
    GaussianNoiseCfg: (sample_gaussian, "mean", "std"),
}
_OPERATIONS = {"add": int(NOISE_ADD), "scale": int(NOISE_SCALE), "abs": int(NOISE_ABS)}


def sampled(
    context: ManagerContext, where: str, cfg: NoiseCfg, size: int, rng: str = "rng", stream: str = "env"
) -> str:
    """Expression of a draw of a noise for element ``i``, of stream ``stream``; empty after a problem was noted."""
    kind = next((k for k in _KINDS if isinstance(cfg, k)), None)
    if kind is None:
        names = ", ".join(k.__name__ for k in _KINDS)
        context.problems.append(f"{where}: is {type(cfg).__name__}, must be one of {names}")
        return ""
    function, *fields = _KINDS[kind]
    arguments = []
    for field in fields:
        value = torch.as_tensor(getattr(cfg, field) if field else 0.0, dtype=torch.float32).flatten()
        path = f"{where}.{field or 'unused'}"
        if value.numel() == 1:
            arguments.append(context.parameters.add(path, float(value), float))
        elif value.numel() == size:
            array = context.shared(path, float, size)
            context.torch(array).copy_(value)
            arguments.append(f"{context.scope.name(path, array)}[i]")
        else:
            context.problems.append(f"{path}: has {value.numel()} numbers, the term {size}; give one or {size}")
            return ""
    return f"{context.scope.function(function)}({stream}, {rng}, {', '.join(arguments)})"


def noisy(
    context: ManagerContext, where: str, cfg: NoiseCfg, size: int, target: str, rng: str = "rng", stream: str = "env"
) -> list[str]:
    """Lines that put noise on ``target``, which mentions the element as ``i``."""
    draw = sampled(context, where, cfg, size, rng, stream)
    operation = _OPERATIONS.get(cfg.operation, 0)
    return [f"{target} = {context.scope.function(combine_noise)}({target}, {draw}, {operation})"] if draw else []


@dataclass
class _Delay:
    """A ring of past values, and how far back an episode reads in it."""

    context: ManagerContext
    size: int
    depth: int
    ring: str
    head: str
    lag: str
    filled: str
    bounds: str

    def step(self, target: str) -> list[str]:
        """Lines that put the value of each element ``i`` of ``target`` in and the delayed one in its place."""
        ring, head, depth = self.ring, self.head, self.depth
        return [
            f"{head}[env] = ({head}[env] + 1) % {depth}",
            f"past = ({head}[env] - {self.lag}[env] + {depth}) % {depth}",
            f"fresh = wp.bool({self.filled}[env] == 0)",
            f"for i in range({self.size}):",
            "    if fresh:",
            f"        for k in range({depth}):",
            f"            {ring}[env, k, i] = {target}",
            f"    {ring}[env, {head}[env], i] = {target}",
            f"    {target} = {ring}[env, past, i]",
            f"{self.filled}[env] = 1",
        ]

    def reset(self, zero: bool = False) -> list[str]:
        """Lines that draw a lag; the ring is refilled with the first value, or is zero."""
        draw = self.context.scope.function(random.uniform_range)
        span = f"{draw}(env, rng, {self.bounds})"
        lag = f"wp.clamp(int(wp.floor({span})), 0, {self.depth - 1})"
        lines = [f"{self.lag}[env] = {lag}", f"{self.filled}[env] = {int(zero)}"]
        if zero:
            lines += [
                f"for k in range({self.depth}):",
                f"    for i in range({self.size}):",
                f"        {self.ring}[env, k, i] = 0.0",
            ]
        return lines


def delayed(context: ManagerContext, where: str, size: int, cfg: Any) -> _Delay:
    """The delay of a term whose config has ``delay_min_lag`` and ``delay_max_lag`` [steps]."""
    import warp as wp

    depth = cfg.delay_max_lag + 1
    name, array = context.scope.name, context.array
    bounds = context.parameters.add(f"{where}.delay", (cfg.delay_min_lag, cfg.delay_max_lag + 0.9999), wp.vec2)
    return _Delay(
        context,
        size,
        depth,
        name(f"{where}_ring", array(f"{where}.ring", float, depth, size)),
        name(f"{where}_head", array(f"{where}.head", int)),
        name(f"{where}_lag", array(f"{where}.lag", int)),
        name(f"{where}_filled", array(f"{where}.filled", int)),
        bounds,
    )
