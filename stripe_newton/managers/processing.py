# SPDX-License-Identifier: Apache-2.0
"""Noise and delay of observations and actions: their source code and arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
import warp as wp

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
from stripe_newton.fusion import Code, block, code
from stripe_newton.noise import ConstantNoiseCfg, GaussianNoiseCfg, NoiseCfg, UniformNoiseCfg

from .context import ManagerContext

__all__ = ["KINDS_OF_NOISE", "Delay", "DelayCfg", "NoiseSource", "delay_of"]

_KINDS: dict[type, tuple[wp.Function, str, str | None]] = {
    ConstantNoiseCfg: (sample_constant, "bias", None),
    UniformNoiseCfg: (sample_uniform, "n_min", "n_max"),
    GaussianNoiseCfg: (sample_gaussian, "mean", "std"),
}
KINDS_OF_NOISE = tuple(_KINDS)
"""Configs of noise that kernels draw; other noise is the user's, in torch."""
_OPERATIONS = {"add": int(NOISE_ADD), "scale": int(NOISE_SCALE), "abs": int(NOISE_ABS)}


@dataclass(frozen=True)
class NoiseSource:
    """Source code of the noise of a term.

    Attributes:
        context: Context that makes parameters and arrays.
        path: Path of the noise's config.
        cfg: The noise.
        size: Number of values of the term.
        rng: Name of the array of random streams.
        stream: Source code of the index of the stream.
    """

    context: ManagerContext
    path: str
    cfg: NoiseCfg
    size: int
    rng: Code
    stream: str = "env"

    def draw(self) -> Code | None:
        """Expression that draws the noise of value ``i``; None if a problem has been added to the context."""
        kind = next((k for k in _KINDS if isinstance(self.cfg, k)), None)
        if kind is None:
            names = ", ".join(k.__name__ for k in _KINDS)
            self.context.problems.append(f"{self.path}: is {type(self.cfg).__name__}, must be one of {names}")
            return None
        function, *fields = _KINDS[kind]
        arguments = [self._number(field) for field in fields]
        if any(argument is None for argument in arguments):
            return None
        return self.context.scope.call(function, self.stream, self.rng, *filter(None, arguments))

    def _number(self, field: str | None) -> Code | None:
        """Expression of a number of the config, or of its element ``i`` if it has one for each value of the term."""
        context, path = self.context, f"{self.path}.{field or 'unused'}"
        value = torch.as_tensor(getattr(self.cfg, field) if field else 0.0, dtype=torch.float32).flatten()
        if value.numel() == 1:
            return context.parameters.add(path, float(value), float)
        if value.numel() == self.size:
            array = context.shared(path, float, self.size)
            context.torch(array).copy_(value)
            return code("{}[i]", context.scope.name(path, array))
        text = f"has {value.numel()} numbers, the term {self.size}; give one or {self.size}"
        context.problems.append(f"{path}: {text}")
        return None

    def apply(self, target: Code) -> list[Code]:
        """Lines that apply the noise to ``target``, the expression of value ``i``."""
        draw, operation = self.draw(), _OPERATIONS.get(self.cfg.operation, 0)
        if draw is None:
            return []
        return [code("{} = {}", target, self.context.scope.call(combine_noise, target, draw, operation))]


class DelayCfg(Protocol):
    """Config of a term with a delay."""

    delay_min_lag: int
    """Least delay [steps]."""
    delay_max_lag: int
    """Largest delay [steps]."""


@dataclass(frozen=True)
class Delay:
    """Source code of a delay: a ring of past values, read as many steps back as the episode's lag."""

    context: ManagerContext
    size: int
    depth: int
    ring: Code
    head: Code
    lag: Code
    filled: Code
    bounds: Code

    def step(self, target: Code, again: bool = False) -> list[Code]:
        """Lines that push each value ``i`` of ``target`` into the ring and replace it by the delayed one.

        Args:
            target: The value of index ``i``.
            again: Replace the last value that was pushed instead.
        """
        ring, head, depth = self.ring, self.head, self.depth
        advance = [] if again else [code("{head}[env] = ({head}[env] + 1) % {depth}", head=head, depth=depth)]
        return [
            *advance,
            code("past = ({}[env] - {}[env] + {}) % {}", head, self.lag, depth, depth),
            code("fresh = wp.bool({}[env] == 0)", self.filled),
            *block(
                code("for i in range({}):", self.size),
                [
                    *block(
                        code("if fresh:"),
                        block(code("for k in range({}):", depth), [code("{}[env, k, i] = {}", ring, target)]),
                    ),
                    code("{}[env, {}[env], i] = {}", ring, head, target),
                    code("{} = {}[env, past, i]", target, ring),
                ],
            ),
            code("{}[env] = 1", self.filled),
        ]

    def reset(self, zero: bool = False) -> list[Code]:
        """Lines that draw the lag of an episode. Its first value fills the ring, or with ``zero`` zeros do."""
        draw = self.context.scope.call(random.uniform_range, "env", self.context.code("{rng}"), self.bounds)
        lines = [
            code("{}[env] = wp.clamp(int(wp.floor({})), 0, {})", self.lag, draw, self.depth - 1),
            code("{}[env] = {}", self.filled, int(zero)),
        ]
        if zero:
            clear = block(code("for i in range({}):", self.size), [code("{}[env, k, i] = 0.0", self.ring)])
            lines += block(code("for k in range({}):", self.depth), clear)
        return lines


def delay_of(context: ManagerContext, path: str, size: int, cfg: DelayCfg) -> Delay:
    """The delay of a term of ``size`` numbers at a path of the config."""
    name, array = context.scope.name, context.array
    depth = cfg.delay_max_lag + 1
    # The upper bound is just below the next whole number: rounded down, a uniform draw gives each lag the same chance.
    bounds = context.parameters.add(f"{path}.delay", (cfg.delay_min_lag, cfg.delay_max_lag + 0.9999), wp.vec2)
    return Delay(
        context,
        size,
        depth,
        ring=name(f"{path}_ring", array(f"{path}.ring", float, depth, size)),
        head=name(f"{path}_head", array(f"{path}.head", int)),
        lag=name(f"{path}_lag", array(f"{path}.lag", int)),
        filled=name(f"{path}_filled", array(f"{path}.filled", int)),
        bounds=bounds,
    )
