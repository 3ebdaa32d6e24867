# SPDX-License-Identifier: Apache-2.0
"""Source for the modifiers of observations: filters, integrators, functions of one's own."""

from __future__ import annotations

from stripe_newton.fusion import bind_term

from .context import ManagerContext
from .observation_cfg import DigitalFilterCfg, IntegratorCfg, ModifierCfg

__all__ = ["modified"]


def modified(context: ManagerContext, path: str, cfg: ModifierCfg, size: int, element: str, fresh: str) -> list[str]:
    """Lines that change one number of a term.

    Args:
        context: Where arrays and parameters are made.
        path: Path of the modifier's config.
        cfg: The modifier.
        size: Numbers of the term.
        element: Source of the number, which mentions its index as ``i``.
        fresh: Name of the array that says whether an episode just began.
    """
    name, array = context.scope.name, context.array
    if isinstance(cfg, DigitalFilterCfg):
        past_x = name(f"{path}_x", array(f"{path}.x", float, len(cfg.B), size))
        past_y = name(f"{path}_y", array(f"{path}.y", float, max(1, len(cfg.A)), size))
        a = [context.parameters.add(f"{path}.A.{k}", v, float) for k, v in enumerate(cfg.A)]
        b = [context.parameters.add(f"{path}.B.{k}", v, float) for k, v in enumerate(cfg.B)]
        lines = [f"if {fresh}[env] != 0:"]
        lines += [f"    {past_x}[env, {k}, i] = {element}" for k in range(len(b))]
        lines += [f"    {past_y}[env, {k}, i] = {element}" for k in range(len(a))]
        lines += [f"{past_x}[env, {k}, i] = {past_x}[env, {k - 1}, i]" for k in range(len(b) - 1, 0, -1)]
        lines += [f"{past_x}[env, 0, i] = {element}"]
        terms = [f"{c} * {past_x}[env, {k}, i]" for k, c in enumerate(b)]
        terms += [f"-{c} * {past_y}[env, {k}, i]" for k, c in enumerate(a)]
        lines += [f"{element} = {' + '.join(terms)}"]
        lines += [f"{past_y}[env, {k}, i] = {past_y}[env, {k - 1}, i]" for k in range(len(a) - 1, 0, -1)]
        return lines + ([f"{past_y}[env, 0, i] = {element}"] if a else [])
    if isinstance(cfg, IntegratorCfg):
        before = name(f"{path}_x", array(f"{path}.x", float, size))
        total = name(f"{path}_y", array(f"{path}.y", float, size))
        dt = context.parameters.add(f"{path}.dt", cfg.dt, float)
        return [
            f"if {fresh}[env] != 0:",
            f"    {before}[env, i] = 0.0",
            f"    {total}[env, i] = 0.0",
            f"{total}[env, i] = {total}[env, i] + 0.5 * ({element} + {before}[env, i]) * {dt}",
            f"{before}[env, i] = {element}",
            f"{element} = {total}[env, i]",
        ]
    call = bind_term(context, cfg.func, cfg.params, path, "modifier", {"value": element})
    return [f"{element} = {call.expression()}"] if call is not None else []
