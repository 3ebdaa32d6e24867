# SPDX-License-Identifier: Apache-2.0
"""Input devices of the Isaac Lab dialect: nobody touches them."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any

import torch

__all__ = ["DeviceBase", "HaplyDevice", "Se2Device", "Se3Device"]


class DeviceBase:
    """A device without input."""

    class TrackingTarget(Enum):
        """Parts of a body that a headset follows, as configs of devices name them."""

        HAND_LEFT = 0
        HAND_RIGHT = 1
        HEAD = 2
        CONTROLLER_LEFT = 3
        CONTROLLER_RIGHT = 4

    def __init__(self, *args: object, **kwargs: object):
        """Take the arguments of any device."""

    def reset(self) -> None:
        """Do nothing."""

    def add_callback(self, key: Any, func: Callable[..., object]) -> None:
        """Do nothing: no key is ever pressed."""

    def advance(self) -> torch.Tensor:
        """Nothing in the commands of the device."""
        return torch.zeros(0)


class Se2Device(DeviceBase):
    """A device that commands a velocity in the plane."""

    def advance(self) -> torch.Tensor:
        """Standstill: speeds along x and y and about z, shape ``(3,)``."""
        return torch.zeros(3)


class Se3Device(DeviceBase):
    """A device that moves a hand with a gripper."""

    def advance(self) -> torch.Tensor:
        """No motion, and an open gripper: displacement, rotation vector and 1, shape ``(7,)``."""
        return torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class HaplyDevice(DeviceBase):
    """A handle that is held in space."""

    def advance(self) -> torch.Tensor:
        """Position, quaternion (x, y, z, w) and three buttons that nobody presses, shape ``(10,)``."""
        return torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])

    def push_force(self, forces: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
        """Do nothing: nobody feels the forces. Returns the first of them, or zero if there is none."""
        return forces[0] if len(forces) else torch.zeros(3)
