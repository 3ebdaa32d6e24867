# SPDX-License-Identifier: Apache-2.0
"""Term parameters: parameters of a config, split among the functions of a term that has several."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

import warp as wp

from stripe_newton.fusion import StructRegistry

__all__ = ["params_for", "unknown_params"]

_GIVEN = ("env", "rng", "out", "action", "processed", "command", "step_dt")
"""Arguments that managers give, and configs do not."""


def params_for(structs: StructRegistry, func: wp.Function, params: Mapping[str, object]) -> dict[str, object]:
    """The parameters that a Warp function may take."""
    taken = _parameters(structs, func)
    return {k: v for k, v in params.items() if k in taken}


def unknown_params(
    structs: StructRegistry, path: str, functions: Iterable[wp.Function | None], params: Mapping[str, object]
) -> list[str]:
    """A problem for each parameter that no function of a term takes. Functions that are None are skipped."""
    there = [f for f in functions if f is not None]
    names = sorted({n for f in there for n in f.input_types} - set(_GIVEN))
    taken = set().union({"asset_cfg"}, *(_parameters(structs, f) for f in there))
    problems = []
    for key in params.keys() - taken:
        near = difflib.get_close_matches(key, names, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"they take {', '.join(names) or 'none'}"
        problems.append(f"{path}.params.{key}: no function of the term has such an argument; {hint}")
    return problems


def _parameters(structs: StructRegistry, func: wp.Function) -> set[str]:
    """Names of all parameters from which the arguments of a function can be found."""
    names = {*func.input_types, *structs.parameters(func)}
    for name in func.input_types:
        if name == "term_ids":
            names.add("term_keys")
        if name in ("joint_ids", "body_ids"):
            names.add("asset_cfg")
        for suffix in ("_joint_ids", "_body_ids"):
            if name.endswith(suffix):
                names |= {name.removesuffix(suffix), f"{name.removesuffix(suffix)}_cfg"}
    return names
