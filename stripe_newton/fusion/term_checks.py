# SPDX-License-Identifier: Apache-2.0
"""Term checks: problems of a term's function and config, found once its arguments are.

Each problem is a line with the path of the term, what is wrong and what would be right::

    rewards.alive.func: 'alive' returns int, a reward must be annotated '-> float'
    rewards.pose.params.stdd: 'pose' has no such argument; did you mean 'std'?
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence

from .term_binding import TermBinding
from .warp_types import SCALARS

__all__ = ["term_problems"]

_RETURNS: dict[str, type] = {
    "reward": float,
    "metric": float,
    "termination": bool,
    "curriculum": float,
    "modifier": float,
}
"""Return types, by the kind of term; other kinds return nothing."""


def term_problems(binding: TermBinding, kind: str, of_arguments: Sequence[str]) -> list[str]:
    """All problems of a term, in the order of its config: function, arguments, other parameters.

    Args:
        binding: The term, with the parameters that its arguments have taken.
        kind: Kind of term, as for :func:`bind_term`.
        of_arguments: Problems that came up while the arguments were found.
    """
    return [
        *_function_problems(binding, kind),
        *of_arguments,
        *_body_problems(binding),
        *_param_problems(binding),
    ]


def _function_problems(binding: TermBinding, kind: str) -> Iterator[str]:
    """Problems of the function's signature."""
    function = binding.function.func
    wanted, returned = _RETURNS.get(kind), function.__annotations__.get("return")
    if isinstance(returned, str):  # of a module with postponed annotations
        returned = eval(returned, function.__globals__)
    returned = SCALARS.get(returned, returned)
    if wanted is not None and returned is not wanted:
        has = f"returns {getattr(returned, '__name__', returned)}" if returned else "has no return annotation"
        yield f"{binding.where}.func: '{binding.name}' {has}, a {kind} must be annotated '-> {wanted.__name__}'"
    if kind == "event" and returned not in (None, type(None)):
        yield f"{binding.where}.func: '{binding.name}' returns a value, which is no event: an event returns nothing"
    if kind == "observation" and "out" not in binding.types:
        yield (
            f"{binding.where}.func: '{binding.name}' has no argument 'out: wp.array[float]', to which an observation "
            "writes its values"
        )


def _body_problems(binding: TermBinding) -> Iterator[str]:
    """Problems of a term that pairs bodies of the asset with bodies of a sensor: both choices must be equal."""
    ids, sensor_ids = (binding.counts.get(n) for n in ("body_ids", "sensor_body_ids"))
    if None not in (ids, sensor_ids) and ids != sensor_ids:
        text = f"sensor_cfg names {sensor_ids} bodies, asset_cfg {ids}; they must be the same, in the same order"
        yield f"{binding.where}.params: {text}"
    ours, others = (binding.chosen.get(n, []) for n in ("body_ids", "sensor_body_ids"))
    if ours != others and sorted(ours) == sorted(others):
        text = f"sensor_cfg names {', '.join(others)}, asset_cfg {', '.join(ours)}; set preserve_order in both"
        yield f"{binding.where}.params: {text}"


def _param_problems(binding: TermBinding) -> Iterator[str]:
    """Problems of parameters that no argument uses."""
    arguments = [n for n in binding.types if n not in ("env", "out", "rng")]
    for extra in binding.params.keys() - binding.taken - {"asset_cfg"}:
        near = difflib.get_close_matches(extra, arguments, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else f"; it takes {', '.join(arguments) or 'none'}"
        yield f"{binding.where}.params.{extra}: '{binding.name}' has no such argument{hint}"
