# SPDX-License-Identifier: Apache-2.0
"""Spaces: gymnasium spaces from the short forms that configs use."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from gymnasium import spaces

__all__ = ["SpaceSpec", "to_space"]

SpaceSpec: TypeAlias = Any
"""A space as a config writes it; see :func:`to_space`."""


def to_space(spec: SpaceSpec) -> spaces.Space:
    """The gymnasium space of a short form.

    Args:
        spec: A space; an int n for an unbounded ``Box`` of n numbers; a list of ints for the shape of one;
            ``{n}`` for ``Discrete(n)``; a list of such sets for ``MultiDiscrete``; a dict or tuple of these.

    Raises:
        ValueError: for anything else.
    """
    if isinstance(spec, spaces.Space):
        return spec
    if _is_size(spec):
        return spaces.Box(-np.inf, np.inf, (int(spec),), np.float32)
    if _is_choice(spec):
        return spaces.Discrete(int(next(iter(spec))))
    if isinstance(spec, list) and spec and all(map(_is_choice, spec)):
        return spaces.MultiDiscrete([next(iter(x)) for x in spec])
    if isinstance(spec, list) and spec and all(map(_is_size, spec)):
        return spaces.Box(-np.inf, np.inf, tuple(map(int, spec)), np.float32)
    if isinstance(spec, dict) and spec:
        return spaces.Dict({key: to_space(value) for key, value in spec.items()})
    if isinstance(spec, tuple) and spec:
        return spaces.Tuple([to_space(value) for value in spec])
    raise ValueError(f"{spec!r} is not a space; give a number of elements, a list of sizes, or a gymnasium space")


def _is_size(spec: object) -> bool:
    """Whether it is a number of elements."""
    return isinstance(spec, (int, np.integer)) and not isinstance(spec, bool) and bool(spec > 0)


def _is_choice(spec: object) -> bool:
    """Whether it is ``{n}``, a choice among n."""
    return isinstance(spec, set) and len(spec) == 1
