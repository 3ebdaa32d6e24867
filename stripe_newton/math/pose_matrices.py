# SPDX-License-Identifier: Apache-2.0
"""Pose matrices: poses as homogeneous matrices ``(..., 4, 4)``, and ways between them.

The names, ``frame_A`` among them, are Isaac Lab's.
"""

from __future__ import annotations

import math

import torch

from .rotations import axis_angle_from_quat, matrix_from_quat, quat_from_angle_axis, quat_from_matrix

__all__ = [
    "interpolate_poses",
    "interpolate_rotations",
    "make_pose",
    "pose_in_A_to_pose_in_B",
    "pose_inv",
    "transform_poses_from_frame_A_to_frame_B",
    "unmake_pose",
]


def make_pose(pos: torch.Tensor, rot: torch.Tensor) -> torch.Tensor:
    """Pose matrices ``(..., 4, 4)`` of positions ``(..., 3)`` [m] and rotation matrices ``(..., 3, 3)``.

    Raises:
        ValueError: if the shapes are not these, or their leading dimensions differ.
    """
    if pos.shape[-1:] != (3,) or rot.shape[-2:] != (3, 3) or pos.shape[:-1] != rot.shape[:-2]:
        raise ValueError(
            f"make_pose: expected positions (..., 3) and rotations (..., 3, 3), got {tuple(pos.shape)} and "
            f"{tuple(rot.shape)}"
        )
    pose = torch.zeros((*pos.shape[:-1], 4, 4), dtype=pos.dtype, device=pos.device)
    pose[..., :3, :3] = rot
    pose[..., :3, 3] = pos
    pose[..., 3, 3] = 1.0
    return pose


def unmake_pose(pose: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Positions ``(..., 3)`` [m] and rotation matrices ``(..., 3, 3)`` of pose matrices ``(..., 4, 4)``, as views."""
    return pose[..., :3, 3], pose[..., :3, :3]


def pose_inv(pose: torch.Tensor) -> torch.Tensor:
    """Inverse of pose matrices ``(..., 4, 4)``."""
    pos, rot = unmake_pose(pose)
    back = rot.transpose(-1, -2)
    return make_pose(-(back @ pos.unsqueeze(-1)).squeeze(-1), back)


def pose_in_A_to_pose_in_B(pose_in_A: torch.Tensor, pose_A_in_B: torch.Tensor) -> torch.Tensor:
    """Pose matrices ``(..., 4, 4)`` in frame B, from those in frame A and that of A in B."""
    return pose_A_in_B @ pose_in_A


def transform_poses_from_frame_A_to_frame_B(
    src_poses: torch.Tensor, frame_A: torch.Tensor, frame_B: torch.Tensor
) -> torch.Tensor:
    """Carry pose matrices ``(T, 4, 4)`` along: they are to ``frame_A`` as ``src_poses`` are to ``frame_B``.

    Args:
        src_poses: Poses in the world, ``(T, 4, 4)``.
        frame_A: Pose ``(4, 4)`` of the frame that the result belongs to.
        frame_B: Pose ``(4, 4)`` of the frame that ``src_poses`` belong to.
    """
    return frame_A.unsqueeze(0) @ (pose_inv(frame_B).unsqueeze(0) @ src_poses)


def interpolate_rotations(R1: torch.Tensor, R2: torch.Tensor, num_steps: int, axis_angle: bool = True) -> torch.Tensor:
    """Rotation matrices ``(num_steps + 1, 3, 3)`` from ``R1`` to ``R2``, both ``(3, 3)``, at equal steps.

    Args:
        R1: First rotation.
        R2: Last rotation.
        num_steps: Number of steps, 1 or more.
        axis_angle: Whether turns by less than 0.05 rad are not divided: all but nothing is then ``R2``, as in Isaac
            Lab. False divides these too.
    """
    turn = axis_angle_from_quat(quat_from_matrix(R2 @ R1.transpose(-1, -2)))
    angle = torch.linalg.vector_norm(turn)
    if axis_angle and angle < 0.05:
        return R2.expand(num_steps + 1, 3, 3).clone()
    fractions = torch.arange(num_steps, dtype=R1.dtype, device=R1.device) / num_steps
    turns = matrix_from_quat(quat_from_angle_axis(fractions * angle, turn.expand(num_steps, 3)))
    return torch.cat((turns @ R1, R2.unsqueeze(0)))


def interpolate_poses(
    pose_1: torch.Tensor,
    pose_2: torch.Tensor,
    num_steps: int | None = None,
    step_size: float | None = None,
    perturb: bool = False,
) -> tuple[torch.Tensor, int]:
    """Pose matrices along the straight way from one pose to another, both ``(4, 4)``.

    Args:
        pose_1: First pose.
        pose_2: Last pose.
        num_steps: Number of poses between the two; None means by ``step_size``.
        step_size: Distance [m] between neighbours at most.
        perturb: Whether to move the positions between by up to half a step along the way, at random.

    Returns:
        Poses ``(num_steps + 2, 4, 4)``, both ends among them, and ``num_steps``.

    Raises:
        ValueError: unless just one of ``num_steps`` (0 or more) and ``step_size`` is given, the latter for poses at
            different positions.
    """
    (pos1, rot1), (pos2, rot2) = unmake_pose(pose_1), unmake_pose(pose_2)
    way = pos2 - pos1
    if num_steps is None:
        length = float(torch.linalg.vector_norm(way))
        if step_size is None or length == 0.0:
            raise ValueError("interpolate_poses: give num_steps, or step_size for poses at different positions")
        num_steps = math.ceil(length / step_size)
    elif step_size is not None or num_steps < 0:
        raise ValueError("interpolate_poses: give num_steps, 0 or more, or step_size, not both")
    if num_steps == 0:
        return torch.stack((pose_1, pose_2)), 0
    steps = num_steps + 1
    grid = torch.arange(steps, dtype=torch.float32, device=pos1.device)
    if perturb:
        grid[1:-1] += torch.rand(steps - 2, device=pos1.device) - 0.5
    positions = torch.cat((pos1 + grid.unsqueeze(-1) * (way / steps), pos2.unsqueeze(0)))
    return make_pose(positions, interpolate_rotations(rot1, rot2, steps)), num_steps
