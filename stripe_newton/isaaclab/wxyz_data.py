# SPDX-License-Identifier: Apache-2.0
"""Data of assets and sensors with quaternions in the order (w, x, y, z)."""

from __future__ import annotations

import re
from typing import Any

import torch

from .quaternions import pose_to_wxyz, pose_to_xyzw, to_wxyz, to_xyzw

__all__ = ["WxyzData"]

_QUATERNION = re.compile(r"(^|_)quat(_|$)")
_POSE = re.compile(r"(^|_)(pose|state)(_|$)")


class WxyzData:
    """Data of an asset or sensor: everything is that of the data below, but for what has an orientation.

    By Isaac Lab's names: tensors with ``quat`` in the name are quaternions, those with ``pose`` or ``state`` have one
    in the columns 3 to 6. They are handed out as read-only copies in the order (w, x, y, z). Assigning to a name writes
    the memory below.
    """

    _native: Any  # data of whatever asset or sensor it stands for

    def __init__(self, native: object):
        object.__setattr__(self, "_native", native)

    def __getattr__(self, name: str) -> Any:
        if name == "_native":  # asked for before __init__ by copies and unpickling
            raise AttributeError(name)
        value = getattr(self._native, name)
        if not isinstance(value, torch.Tensor):
            return value
        if _QUATERNION.search(name):
            return to_wxyz(value)
        return pose_to_wxyz(value) if _POSE.search(name) else value

    def __setattr__(self, name: str, value: object) -> None:
        old = getattr(self._native, name, None)
        if not isinstance(old, torch.Tensor) or not isinstance(value, torch.Tensor):
            setattr(self._native, name, value)
        elif _QUATERNION.search(name):
            old.copy_(to_xyzw(value))
        else:
            old.copy_(pose_to_xyzw(value) if _POSE.search(name) else value)

    def __dir__(self) -> list[str]:
        return dir(self._native)
