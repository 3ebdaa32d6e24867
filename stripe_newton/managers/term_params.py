# SPDX-License-Identifier: Apache-2.0
"""Which of a term's parameters are meant for which of its functions."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

from stripe_kernels.data import ActionData, ArticulationData, Parameter

__all__ = ["params_for", "unknown_params"]

_GIVEN = ("env", "rng", "out", "action", "processed", "command", "step_dt")


def params_for(func: Any, params: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters that a Warp function may take."""
    return {k: v for k, v in params.items() if _takes(func, k)}


def unknown_params(path: str, functions: Iterable[Any], params: Mapping[str, Any]) -> list[str]:
    """A problem for each parameter that none of a term's functions takes; None among them are skipped."""
    there = [f for f in functions if f is not None]
    names = sorted({n for f in there for n in f.input_types} - set(_GIVEN))
    problems = []
    for key in params:
        if key != "asset_cfg" and not any(_takes(f, key) for f in there):
            near = difflib.get_close_matches(key, names, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"they take {', '.join(names) or 'none'}"
            problems.append(f"{path}.params.{key}: no function of the term has such an argument; {hint}")
    return problems


def _takes(func: Any, key: str) -> bool:
    types: dict[str, Any] = func.input_types
    names = {n + suffix for n in types for suffix in ("", "_cfg", "_name")}
    for name in types:
        for suffix in ("_joint_ids", "_body_ids"):
            if name.endswith(suffix):
                names |= {name.removesuffix(suffix), name.removesuffix(suffix) + "_cfg"}
    structs = {t for t in types.values() if hasattr(t, "vars")}
    naming = {
        "asset_cfg": bool({"joint_ids", "body_ids"} & types.keys()) or ArticulationData in structs,
        "action_name": ActionData in structs,
        "address": Parameter in structs,
        "command_name": bool(structs - {ActionData, ArticulationData, Parameter}),
        "term_keys": "term_ids" in types,
        "term_name": Parameter in structs,
    }
    return key in names or naming.get(key, False)
