# SPDX-License-Identifier: Apache-2.0
"""Layout: the rows of an asset in the arrays of a model, found once in the builder of one environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import newton
import torch
import warp as wp

from stripe_newton.configclass import ConfigError
from stripe_newton.math import combine_frame_transforms

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["Layout", "articulation_layouts", "select_layout"]


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

    def place_root(
        self, builder: newton.ModelBuilder, pos: Sequence[float] | None, rot: Sequence[float] | None
    ) -> None:
        """Put a free root at its initial pose; a fixed one stands where it was spawned.

        Args:
            builder: Builder of one environment.
            pos: Position [m]; None keeps the file's.
            rot: Orientation (x, y, z, w); None keeps the file's.
        """
        if not self.floating:
            return
        start = self.root_coord
        if pos is not None:
            builder.joint_q[start : start + 3] = [float(x) for x in pos]
        if rot is not None:
            builder.joint_q[start + 3 : start + 7] = [float(x) for x in rot]
        builder.body_q[self.bodies[0]] = wp.transform(*builder.joint_q[start : start + 7])

    def write_root_pose(self, sim: Simulation, pose: torch.Tensor, ids: torch.Tensor) -> None:
        """Set root poses; a fixed root moves with the frame it is fixed to."""
        if self.floating:
            sim.per_env(sim.state.joint_q)[ids, self.root_coord : self.root_coord + 7] = pose
        else:
            # A fixed joint keeps two frames together, one on the root and one in the world: the latter is moved here.
            anchor = sim.per_env(sim.model.joint_X_c)[ids, self.joints[0]]
            frame = combine_frame_transforms(pose[:, :3], pose[:, 3:7], anchor[:, :3], anchor[:, 3:7])
            sim.per_env(sim.model.joint_X_p)[ids, self.joints[0]] = torch.cat(frame, dim=-1)
            sim.roots_moved = True  # the solver has its own copy of the frames, which the next step brings up to date

    def write_root_velocity(self, sim: Simulation, velocity: torch.Tensor, ids: torch.Tensor) -> None:
        """Set root velocities; a fixed root has none."""
        if self.floating:
            sim.per_env(sim.state.joint_qd)[ids, self.root_dof : self.root_dof + 6] = velocity


def select_layout(layouts: Sequence[Layout], path: str, root_path: str | None, where: str) -> Layout:
    """The one articulation at or below a prim.

    Args:
        layouts: All articulations.
        path: Path of the prim.
        root_path: Path of the articulation's root below it; None for the only one that there is.
        where: The asset, for errors.

    Raises:
        ConfigError: if there is none, or several and ``root_path`` chooses none of them.
    """
    inside = [x for x in layouts if x.path == path or x.path.startswith(path + "/")]
    if root_path is not None:
        inside = [x for x in inside if x.path == path + root_path]
    if not inside:
        there = ", ".join(x.path for x in layouts) or "none"
        wanted = f"{path}{root_path or ''}"
        places = "prim_path" if root_path is None else "prim_path and articulation_root_prim_path"
        hint = f"check {places}, and that the file applies PhysicsArticulationRootAPI"
        raise ConfigError([f"{where}: no articulation or rigid body at '{wanted}', there is {there}; {hint}"])
    if len(inside) > 1:
        roots = ", ".join(x.path[len(path) :] or "/" for x in inside)
        hint = "choose one by articulation_root_prim_path"
        raise ConfigError([f"{where}: {len(inside)} articulations below it ({roots}); {hint}"])
    return inside[0]


def articulation_layouts(builder: newton.ModelBuilder) -> list[Layout]:
    """One layout for each articulation of ``builder``; a free rigid body is an articulation of one body."""
    spans = zip(builder.articulation_start, builder.articulation_end, builder.articulation_label, strict=True)
    return [_layout(builder, range(start, end), label) for start, end, label in spans]


def _layout(builder: newton.ModelBuilder, joints: range, label: str) -> Layout:
    coord_starts = [*builder.joint_q_start, builder.joint_coord_count]
    dof_starts = [*builder.joint_qd_start, builder.joint_dof_count]
    root = joints[0]
    floating = builder.joint_type[root] == newton.JointType.FREE and builder.joint_parent[root] == -1
    first = root + 1 if floating else root
    names = []
    short = _short_names([builder.joint_label[j] for j in joints])
    for joint in range(first, joints.stop):
        count = sum(builder.joint_dof_dim[joint])
        name = short[joint - root]
        own = [name] if count == 1 else name.split("+")  # joints of an MJCF file that share a body
        names += own if len(own) == count else [f"{name}:{k}" for k in range(count)]
    # Bodies in the order of their joints; one on which two joints end, as in a loop, counts once.
    bodies = list(dict.fromkeys(builder.joint_child[j] for j in joints))
    return Layout(
        path=label,
        joints=joints,
        bodies=bodies,
        body_names=_short_names([builder.body_label[b] for b in bodies]),
        coords=range(coord_starts[first], coord_starts[joints.stop]),
        dofs=range(dof_starts[first], dof_starts[joints.stop]),
        joint_names=names,
        floating=floating,
        root_coord=coord_starts[root] if floating else -1,
        root_dof=dof_starts[root] if floating else -1,
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
