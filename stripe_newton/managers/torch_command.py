# SPDX-License-Identifier: Apache-2.0
"""Torch command: a user's command term, and its copy in the structs that Warp terms read."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
import warp as wp

from stripe_kernels.data import CommandData, Pose2dCommandData, PoseCommandData, VelocityCommandData
from stripe_newton.fusion.warp_types import StructInstance

from .command_term import CommandTerm
from .context import ManagerContext

__all__ = ["TorchCommand"]

_VELOCITY = {"heading_target": "heading_target", "is_heading": "is_heading_env", "is_standing": "is_standing_env"}
_PLACE = {"pos": "pos_command_w", "heading": "heading_command_w"}
"""Fields of the structs, and the attributes of a term that have their values."""


class TorchCommand:
    """A user's command term, mirrored for Warp terms.

    Three numbers are a velocity, and seven a pose; a term with ``pos_command_w`` and ``heading_command_w`` has a
    position on the ground.

    Attributes:
        term: The term.
        data: Its command and its clock.
    """

    def __init__(self, context: ManagerContext, path: str, term: CommandTerm, data: CommandData):
        self.term, self.data = term, data
        self._context, self._path = context, path
        self._mirrors: list[tuple[torch.Tensor, Callable[[], torch.Tensor]]] = []
        self._mirror(data.command, lambda: term.command)
        self._mirror(data.time_left, lambda: term.time_left)
        self._mirror(data.counter, lambda: term.command_counter)

    def structs(self) -> Iterator[StructInstance]:
        """The structs of the kinds that the command is, mirrored from now on."""
        if self._size == 3:
            velocity = VelocityCommandData()
            velocity.command = self.data.command
            self._add(velocity, _VELOCITY, {"heading_target": float, "is_heading": wp.bool, "is_standing": wp.bool})
            yield velocity
        if self._size == 7:
            pose = PoseCommandData()
            pose.pose = self._context.array(f"{self._path}.pose", wp.transform)
            self._mirror(pose.pose, self._pose)
            yield pose
        if all(hasattr(self.term, attribute) for attribute in _PLACE.values()):
            place = Pose2dCommandData()
            place.command = self.data.command
            self._add(place, _PLACE, {"pos": wp.vec3, "heading": float})
            yield place

    def copy(self) -> None:
        """Copy the command to where Warp terms read it."""
        for target, source in self._mirrors:
            target.copy_(source())

    @property
    def _size(self) -> int:
        return int(self.data.command.shape[1])

    def _mirror(self, array: wp.array, source: Callable[[], torch.Tensor]) -> None:
        self._mirrors.append((self._context.torch(array), source))

    def _add(self, struct: StructInstance, attributes: dict[str, str], kinds: dict[str, type]) -> None:
        """Give a struct its arrays; those of attributes that the term lacks stay zero."""
        for name, attribute in attributes.items():
            array = self._context.array(f"{self._path}.{name}", kinds[name])
            setattr(struct, name, array)
            if hasattr(self.term, attribute):
                self._mirror(array, lambda attribute=attribute: getattr(self.term, attribute))  # type: ignore[misc]

    def _pose(self) -> torch.Tensor:
        """The pose with its quaternion (x, y, z, w)."""
        command = self.term.command
        if not getattr(self.term.cfg, "scalar_first", False):
            return command
        return torch.cat((command[:, :3], command[:, 4:], command[:, 3:4]), dim=-1)
