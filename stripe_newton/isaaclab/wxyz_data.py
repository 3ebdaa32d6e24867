# SPDX-License-Identifier: Apache-2.0
"""Data of assets and sensors with quaternions in the order (w, x, y, z)."""

from __future__ import annotations

import re
from typing import Any

import torch

from stripe_newton.math import combine_frame_transforms, subtract_frame_transforms

from .quaternions import pose_to_wxyz, pose_to_xyzw, to_wxyz, to_xyzw

__all__ = ["WxyzAssetData", "WxyzData"]

_QUATERNION = re.compile(r"(^|_)quat(_|$)")
_DEFAULTS = ("default_root_pose", "default_root_state")
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


class WxyzAssetData(WxyzData):
    """Data of an asset whose prim is below another one that has been moved.

    By Isaac Lab's rule ``default_root_state`` is the pose of the config, in the frame of the prim above. The package
    has it in the frame of the environment.
    """

    _above: torch.Tensor

    def __init__(self, native: object, above: torch.Tensor):
        """Take the data and the pose of the prim above in the environment, (x, y, z, w), shape ``(7,)``."""
        super().__init__(native)
        object.__setattr__(self, "_above", above)

    def __getattr__(self, name: str) -> Any:
        if name not in _DEFAULTS:
            return super().__getattr__(name)
        state = getattr(self._native, name)
        pos, quat = subtract_frame_transforms(*self._frame(state), state[:, :3], state[:, 3:7])
        return pose_to_wxyz(torch.cat((pos, quat, state[:, 7:]), dim=-1))

    def __setattr__(self, name: str, value: object) -> None:
        if name not in _DEFAULTS or not isinstance(value, torch.Tensor):
            super().__setattr__(name, value)
            return
        state = pose_to_xyzw(value)
        pos, quat = combine_frame_transforms(*self._frame(state), state[:, :3], state[:, 3:7])
        getattr(self._native, name).copy_(torch.cat((pos, quat, state[:, 7:]), dim=-1))

    def _frame(self, like: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        above = self._above.to(like).expand(len(like), 7)
        return above[:, :3], above[:, 3:]
