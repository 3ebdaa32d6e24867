# SPDX-License-Identifier: Apache-2.0
"""Quaternion order of the Isaac Lab dialect: (w, x, y, z) outside, (x, y, z, w) inside.

Whatever the dialect hands out is a converted copy, which cannot be a view: PyTorch has no strides for a rotated axis.
A write to it in place would be lost without a word, so such tensors refuse it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch

__all__ = ["ReadOnlyTensor", "pose_to_wxyz", "pose_to_xyzw", "to_wxyz", "to_xyzw"]


class ReadOnlyTensor(torch.Tensor):
    """A tensor that refuses to be written in place, also through its views; all other results are plain tensors."""

    @classmethod
    def __torch_function__(
        cls,
        func: Callable[..., Any],
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        kwargs = kwargs or {}
        name = getattr(func, "__name__", "")
        in_place = name == "__setitem__" or name.startswith("__i") or (name.endswith("_") and not name.endswith("__"))
        written = kwargs.get("out", args[0] if in_place and args else None)
        if isinstance(written, ReadOnlyTensor) and name != "requires_grad_":
            raise RuntimeError(
                "this tensor is a converted copy of the simulation's state: writing it would change nothing. "
                "Write a clone() of it, and set states by the write_*_to_sim methods"
            )
        with torch._C.DisableTorchFunctionSubclass():
            result = func(*args, **kwargs)
        return _keep_views(result, args)


def _keep_views(result: Any, args: tuple[Any, ...]) -> Any:
    """``result``, read only where it shares the memory of a read-only argument, plain elsewhere."""
    if isinstance(result, (tuple, list)):
        return type(result)(_keep_views(r, args) for r in result) if type(result) in (tuple, list) else result
    if not isinstance(result, torch.Tensor):
        return result
    memory = result.untyped_storage().data_ptr()
    shared = any(isinstance(a, ReadOnlyTensor) and a.untyped_storage().data_ptr() == memory for a in args)
    return result.as_subclass(ReadOnlyTensor if shared else torch.Tensor)


def to_wxyz(quat: torch.Tensor) -> torch.Tensor:
    """Quaternions (x, y, z, w) as read-only (w, x, y, z), shape ``(..., 4)``."""
    return torch.cat((quat[..., 3:], quat[..., :3]), dim=-1).as_subclass(ReadOnlyTensor)


def to_xyzw(quat: torch.Tensor) -> torch.Tensor:
    """Quaternions (w, x, y, z) as (x, y, z, w), shape ``(..., 4)``."""
    return torch.cat((quat[..., 1:], quat[..., :1]), dim=-1)


def pose_to_wxyz(pose: torch.Tensor) -> torch.Tensor:
    """Poses or states whose columns 3 to 6 are a quaternion (x, y, z, w), read only with (w, x, y, z), ``(..., n)``."""
    parts = (pose[..., :3], pose[..., 6:7], pose[..., 3:6], pose[..., 7:])
    return torch.cat(parts, dim=-1).as_subclass(ReadOnlyTensor)


def pose_to_xyzw(pose: torch.Tensor) -> torch.Tensor:
    """Poses or states whose columns 3 to 6 are a quaternion (w, x, y, z), with (x, y, z, w), shape ``(..., n)``."""
    return torch.cat((pose[..., :3], pose[..., 4:7], pose[..., 3:4], pose[..., 7:]), dim=-1)
