# SPDX-License-Identifier: Apache-2.0
"""Spaces: gymnasium spaces from the short forms that configs use."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
import torch
from gymnasium import spaces

__all__ = ["SpaceSpec", "nested_mismatches", "to_space"]

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


def nested_mismatches(path: str, value: object, space: spaces.Space, num_envs: int) -> Iterator[str]:
    """Differences between observations of all environments and the space of one, which may be nested.

    Args:
        path: What the observations are called.
        value: Tensors that lead with the environment, in dicts and tuples as the space has them.
        space: The space.
        num_envs: Number of environments.
    """
    if isinstance(space, spaces.Dict):
        if not isinstance(value, dict) or set(value) != set(space.spaces):
            found = ", ".join(map(str, value)) if isinstance(value, dict) else type(value).__name__
            yield f"{path}: is {found or 'empty'}, must be a dict of {', '.join(space.spaces)}"
        else:
            for name, part in space.spaces.items():
                yield from nested_mismatches(f"{path}['{name}']", value[name], part, num_envs)
    elif isinstance(space, spaces.Tuple):
        if not isinstance(value, (tuple, list)) or len(value) != len(space.spaces):
            yield f"{path}: is {type(value).__name__}, must be a tuple of {len(space.spaces)}"
        else:
            for number, part in enumerate(space.spaces):
                yield from nested_mismatches(f"{path}[{number}]", value[number], part, num_envs)
    elif not isinstance(value, torch.Tensor):
        yield f"{path}: is {type(value).__name__}, must be a tensor"
    elif tuple(value.shape) != (num_envs, *(space.shape or ())):
        yield f"{path}: has shape {tuple(value.shape)}, must have {(num_envs, *(space.shape or ()))}"
