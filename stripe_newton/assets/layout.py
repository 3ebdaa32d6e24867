# SPDX-License-Identifier: Apache-2.0
"""Where an asset lies in the arrays of a model: found once in the builder of one environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import newton
import torch

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["Layout", "articulation_layouts"]


@dataclass
class Layout:
    """Rows of one articulation, as indices into one environment's part of each array."""

    path: str
    """Prim path of the articulation root."""
    joints: range
    """Joints, the root joint first."""
    bodies: list[int]
    """Bodies in joint order, the root body first."""
    body_names: list[str]
    """Their names: the last part of their prim paths, or more of it where that is ambiguous."""
    coords: range
    """Coordinates of the joints after a free root."""
    dofs: range
    """Degrees of freedom of the joints after a free root."""
    joint_names: list[str]
    """One name a degree of freedom; a joint with several gives ``name:0``, ``name:1``, ..., in an MJCF file its own."""
    floating: bool
    """Whether the root is free."""
    root_coord: int
    """First coordinate of a free root, its pose."""
    root_dof: int
    """First degree of freedom of a free root, its twist."""

    @property
    def body_slice(self) -> slice | list[int]:
        """The bodies as a slice where they are contiguous, so that indexing with it gives a view."""
        first, last = self.bodies[0], self.bodies[-1]
        return slice(first, last + 1) if self.bodies == list(range(first, last + 1)) else self.bodies

    def body_rows(self, body_ids: Sequence[int] | slice | None, device: str) -> torch.Tensor:
        """Bodies of the asset by index, as rows of the environment: int64, shape ``(n,)``."""
        rows = torch.tensor(self.bodies, device=device)
        if body_ids is None:
            return rows
        return rows[body_ids if isinstance(body_ids, slice) else torch.as_tensor(body_ids, device=device)]

    def write_root_pose(self, sim: Simulation, pose: torch.Tensor, ids: torch.Tensor) -> None:
        """Set root poses; a fixed root moves with the frame it is fixed to."""
        if self.floating:
            sim.per_env(sim.state.joint_q)[ids, self.root_coord : self.root_coord + 7] = pose
        else:
            from stripe_newton.math import combine_frame_transforms

            anchor = sim.per_env(sim.model.joint_X_c)[ids, self.joints[0]]
            frame = combine_frame_transforms(pose[:, :3], pose[:, 3:7], anchor[:, :3], anchor[:, 3:7])
            sim.per_env(sim.model.joint_X_p)[ids, self.joints[0]] = torch.cat(frame, dim=-1)
            sim.roots_moved = True

    def write_root_velocity(self, sim: Simulation, velocity: torch.Tensor, ids: torch.Tensor) -> None:
        """Set root velocities; a fixed root has none."""
        if self.floating:
            sim.per_env(sim.state.joint_qd)[ids, self.root_dof : self.root_dof + 6] = velocity


def articulation_layouts(builder: newton.ModelBuilder) -> list[Layout]:
    """One layout for each articulation of ``builder``; a free rigid body is an articulation of one body."""
    spans = zip(builder.articulation_start, builder.articulation_end, builder.articulation_label, strict=True)
    return [_layout(builder, range(start, end), label) for start, end, label in spans]


def _layout(builder: newton.ModelBuilder, joints: range, label: str) -> Layout:
    ends = (
        builder.joint_q_start[1:] + [builder.joint_coord_count],
        builder.joint_qd_start[1:] + [builder.joint_dof_count],
    )
    root = joints[0]
    floating = builder.joint_type[root] == newton.JointType.FREE and builder.joint_parent[root] == -1
    first = root + 1 if floating else root
    coord_start = ends[0][root] if floating else builder.joint_q_start[root]
    dof_start = ends[1][root] if floating else builder.joint_qd_start[root]
    names = []
    short = _short_names([builder.joint_label[j] for j in joints])
    for joint in range(first, joints.stop):
        count = sum(builder.joint_dof_dim[joint])
        name = short[joint - root]
        own = [name] if count == 1 else name.split("+")  # joints of an MJCF file that share a body
        names += own if len(own) == count else [f"{name}:{k}" for k in range(count)]
    bodies = list(dict.fromkeys(builder.joint_child[j] for j in joints))
    return Layout(
        path=label,
        joints=joints,
        bodies=bodies,
        body_names=_short_names([builder.body_label[b] for b in bodies]),
        coords=range(coord_start, ends[0][joints[-1]]),
        dofs=range(dof_start, ends[1][joints[-1]]),
        joint_names=names,
        floating=floating,
        root_coord=builder.joint_q_start[root] if floating else -1,
        root_dof=builder.joint_qd_start[root] if floating else -1,
    )


def _short_names(labels: list[str]) -> list[str]:
    """The shortest endings of the paths that tell them apart; those of a path with a unique last part are that part."""
    out = []
    for label in labels:
        parts = label.split("/")
        for depth in range(1, len(parts) + 1):
            name = "/".join(parts[-depth:])
            if sum(other == label or other.endswith("/" + name) for other in labels) <= 1:
                break
        out.append(name)
    return out
