# SPDX-License-Identifier: Apache-2.0
"""Locomotion: heading, uprightness and velocities of a torso on its way to a target.

Conventions are those of :mod:`stripe_newton.math`.
"""

from __future__ import annotations

import torch

from .rotations import euler_xyz_from_quat, normalize, quat_apply, quat_apply_inverse, quat_mul, wrap_to_pi

__all__ = [
    "compute_heading_and_up",
    "compute_rot",
]


def compute_heading_and_up(
    torso_rotation: torch.Tensor,
    inv_start_rot: torch.Tensor,
    to_target: torch.Tensor,
    vec0: torch.Tensor,
    vec1: torch.Tensor,
    up_idx: int,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Heading and up projections: how upright a torso is, and how well it faces a target.

    Args:
        torso_rotation: Orientation of the torso in the world, ``(N, 4)``.
        inv_start_rot: Inverse of its orientation at rest, ``(N, 4)``.
        to_target: Vector from the torso to the target in the world, ``(N, 3)`` [m].
        vec0: Forward axis of the torso at rest, ``(N, 3)``.
        vec1: Up axis of the torso at rest, ``(N, 3)``.
        up_idx: Index of the world's up axis, 2 for Z up.

    Returns:
        Orientation relative to rest ``(N, 4)``; component of the torso's up axis along the world's up ``(N,)``, 1 when
        upright; cosine ``(N,)`` of the angle between forward axis and direction to the target; up axis ``(N, 3)`` and
        forward axis ``(N, 3)`` in the world.
    """
    torso_quat = quat_mul(torso_rotation, inv_start_rot)
    up_vec = quat_apply(torso_quat, vec1)
    heading_vec = quat_apply(torso_quat, vec0)
    heading_proj = (heading_vec * normalize(to_target)).sum(dim=-1)
    return torso_quat, up_vec[..., up_idx], heading_proj, up_vec, heading_vec


def compute_rot(
    torso_quat: torch.Tensor,
    velocity: torch.Tensor,
    ang_velocity: torch.Tensor,
    targets: torch.Tensor,
    torso_positions: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Velocities in a torso's frame, its Euler angles, and the angle to a target.

    Args:
        torso_quat: Orientation of the torso in the world, ``(N, 4)``.
        velocity: Linear velocity in the world frame, ``(N, 3)`` [m/s].
        ang_velocity: Angular velocity in the world frame, ``(N, 3)`` [rad/s].
        targets: Position of the target in the world, ``(N, 3)`` [m].
        torso_positions: Position of the torso in the world, ``(N, 3)`` [m].

    Returns:
        Linear ``(N, 3)`` and angular velocity ``(N, 3)`` in the torso's frame; roll, pitch and yaw, each ``(N,)`` in
        [-pi, pi]; yaw of the target as seen from the torso, ``(N,)`` in (-pi, pi], 0 when it faces the target.
    """
    vel_loc = quat_apply_inverse(torso_quat, velocity)
    angvel_loc = quat_apply_inverse(torso_quat, ang_velocity)
    roll, pitch, yaw = euler_xyz_from_quat(torso_quat)
    to_target = targets - torso_positions
    angle_to_target = wrap_to_pi(torch.atan2(to_target[..., 1], to_target[..., 0]) - yaw)
    return vel_loc, angvel_loc, roll, pitch, yaw, angle_to_target
