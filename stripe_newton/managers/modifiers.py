# SPDX-License-Identifier: Apache-2.0
"""Observation modifiers: digital filters, integrators and users' functions, with their configs and source code."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Code, bind_term, block, code

from .context import ManagerContext

__all__ = ["DigitalFilterCfg", "IntegratorCfg", "ModifierBase", "ModifierCfg", "modifier_lines"]


class ModifierBase:
    """Base of modifiers in torch that have a state, made as ``func(cfg, data_dim, device)``.

    Attributes:
        cfg: The config.
        data_dim: Shape of the data, ``(num_envs, size)``.
        device: Device of the data.
    """

    def __init__(self, cfg: ModifierCfg, data_dim: tuple[int, ...], device: str):
        """Keep the arguments."""
        self.cfg, self.data_dim, self.device = cfg, data_dim, device

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Begin new episodes in the environments ``env_ids``; None means all of them. The default does nothing."""

    def __call__(self, data: torch.Tensor, **params: Any) -> torch.Tensor:
        """The modified data; ``data``, shape ``data_dim``, is not changed."""
        raise NotImplementedError(f"{type(self).__name__} has no __call__")


@configclass
class ModifierCfg:
    """Modifier of the numbers of a term.

    ``func`` is a Warp function of one number, ``func(env, value, ...) -> float``; or a torch function of all,
    ``func(data, **params)``, or a class derived from :class:`ModifierBase`. With a torch modifier all modifiers and the
    noise of the term are computed in torch.
    """

    func: Callable[..., object] | None = None
    """The function."""
    params: dict[str, Any] = {}
    """Further arguments of the function."""


@configclass
class DigitalFilterCfg(ModifierCfg):
    """Digital filter: ``y_n = sum_k B_k x_{n-k} - sum_k A_{k+1} y_{n-1-k}``.

    In the first step of an episode all past values are those of that step.
    """

    A: Sequence[float] = ()
    """Feedback coefficients; without any the filter has a finite response."""
    B: Sequence[float] = (1.0,)
    """Feed-forward coefficients, one or more."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.B:
            yield "B", "is empty, must have the coefficient of the present value at least"


@configclass
class IntegratorCfg(ModifierCfg):
    """Integrator by the trapezoidal rule: ``y_n = y_{n-1} + (x_n + x_{n-1}) / 2 dt``, zero where an episode begins."""

    dt: float = MISSING
    """Time step [s]."""


def modifier_lines(
    context: ManagerContext, path: str, cfg: ModifierCfg, size: int, element: Code, fresh: Code
) -> list[Code]:
    """Lines that modify one number of a term.

    Args:
        context: Context that makes arrays and parameters.
        path: Path of the modifier's config.
        cfg: The modifier.
        size: Number of values of the term.
        element: Source code of the value, with its index as ``i``.
        fresh: Name of the array that is not 0 where an episode just began.
    """
    if isinstance(cfg, DigitalFilterCfg):
        return _filter_lines(context, path, cfg, size, element, fresh)
    if isinstance(cfg, IntegratorCfg):
        return _integrator_lines(context, path, cfg, size, element, fresh)
    call = bind_term(context, cfg.func, cfg.params, path, "modifier", {"value": element})
    return [code("{} = {}", element, call.expression())] if call is not None else []


def _filter_lines(
    context: ManagerContext, path: str, cfg: DigitalFilterCfg, size: int, element: Code, fresh: Code
) -> list[Code]:
    """Lines of a digital filter. The newest past value comes first; past values move up by one in each step."""
    name, array, add = context.scope.name, context.array, context.parameters.add
    past_x = name(f"{path}_x", array(f"{path}.x", float, len(cfg.B), size))
    past_y = name(f"{path}_y", array(f"{path}.y", float, max(1, len(cfg.A)), size))
    a = [add(f"{path}.A.{k}", v, float) for k, v in enumerate(cfg.A)]
    b = [add(f"{path}.B.{k}", v, float) for k, v in enumerate(cfg.B)]

    def past(values: Code, k: int) -> Code:
        return code("{}[env, {}, i]", values, k)

    def set_to(target: Code, value: Code) -> Code:
        return code("{} = {}", target, value)

    start = [set_to(past(past_x, k), element) for k in range(len(b))]
    start += [set_to(past(past_y, k), element) for k in range(len(a))]
    terms = [code("{} * {}", c, past(past_x, k)) for k, c in enumerate(b)]
    terms += [code("-{} * {}", c, past(past_y, k)) for k, c in enumerate(a)]
    return [
        *block(code("if {}[env] != 0:", fresh), start),
        *(set_to(past(past_x, k), past(past_x, k - 1)) for k in range(len(b) - 1, 0, -1)),
        set_to(past(past_x, 0), element),
        set_to(element, code(" + ".join(["{}"] * len(terms)), *terms)),
        *(set_to(past(past_y, k), past(past_y, k - 1)) for k in range(len(a) - 1, 0, -1)),
        *([set_to(past(past_y, 0), element)] if a else []),
    ]


def _integrator_lines(
    context: ManagerContext, path: str, cfg: IntegratorCfg, size: int, element: Code, fresh: Code
) -> list[Code]:
    """Lines of an integrator."""
    before = context.scope.name(f"{path}_x", context.array(f"{path}.x", float, size))
    total = context.scope.name(f"{path}_y", context.array(f"{path}.y", float, size))
    dt = context.parameters.add(f"{path}.dt", cfg.dt, float)
    last, sum_ = code("{}[env, i]", before), code("{}[env, i]", total)
    return [
        *block(code("if {}[env] != 0:", fresh), [code("{} = 0.0", last), code("{} = 0.0", sum_)]),
        code("{} = {} + 0.5 * ({} + {}) * {}", sum_, sum_, element, last, dt),
        code("{} = {}", last, element),
        code("{} = {}", element, sum_),
    ]
