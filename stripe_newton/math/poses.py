# SPDX-License-Identifier: Apache-2.0
"""Poses: functions on batches of positions and orientations of frames in frames.

Conventions are those of :mod:`stripe_newton.math`.
"""

from __future__ import annotations

import torch

from .rotations import (
    axis_angle_from_quat,
    matrix_from_quat,
    quat_apply,
    quat_apply_inverse,
    quat_from_angle_axis,
    quat_inv,
    quat_mul,
)

__all__ = [
    "apply_delta_pose",
    "combine_frame_transforms",
    "compute_pose_error",
    "rigid_body_twist_transform",
    "subtract_frame_transforms",
    "transform_points",
]


def combine_frame_transforms(
    t01: torch.Tensor, q01: torch.Tensor, t12: torch.Tensor | None = None, q12: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Combine poses: pose of frame 2 in frame 0, from those of 1 in 0 and of 2 in 1.

    Args:
        t01: Position of frame 1 in frame 0, ``(..., 3)`` [m].
        q01: Orientation of frame 1 in frame 0, ``(..., 4)``.
        t12: Position of frame 2 in frame 1, ``(..., 3)`` [m]; None means zero.
        q12: Orientation of frame 2 in frame 1, ``(..., 4)``; None means the identity.

    Returns:
        Position ``(..., 3)`` and orientation ``(..., 4)`` of frame 2 in frame 0.

    Example:
        >>> here = torch.tensor([1.0, 0.0, 0.0])
        >>> turn = torch.tensor([0.0, 0.0, 1.0, 0.0])  # half a turn about z
        >>> combine_frame_transforms(here, turn, torch.tensor([0.25, 0.0, 0.0]))[0]
        tensor([0.7500, 0.0000, 0.0000])
    """
    t02 = t01 if t12 is None else t01 + quat_apply(q01, t12)
    q02 = q01 if q12 is None else quat_mul(q01, q12)
    return t02, q02


def subtract_frame_transforms(
    t01: torch.Tensor, q01: torch.Tensor, t02: torch.Tensor | None = None, q02: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Relative pose: pose of frame 2 in frame 1, from those of 1 and 2 in frame 0.

    Args:
        t01: Position of frame 1 in frame 0, ``(..., 3)`` [m].
        q01: Orientation of frame 1 in frame 0, ``(..., 4)``.
        t02: Position of frame 2 in frame 0, ``(..., 3)`` [m]; None means zero.
        q02: Orientation of frame 2 in frame 0, ``(..., 4)``; None means the identity.

    Returns:
        Position ``(..., 3)`` and orientation ``(..., 4)`` of frame 2 in frame 1.
    """
    q10 = quat_inv(q01)  # not the conjugate: callers may pass quaternions that drifted from unit length
    t12 = quat_apply(q10, -t01 if t02 is None else t02 - t01)
    q12 = q10 if q02 is None else quat_mul(q10, q02)
    return t12, q12


def compute_pose_error(
    t01: torch.Tensor, q01: torch.Tensor, t02: torch.Tensor, q02: torch.Tensor, rot_error_type: str = "axis_angle"
) -> tuple[torch.Tensor, torch.Tensor]:
    """Pose error: what leads from pose 1 to pose 2, both in frame 0 and the error too.

    Args:
        t01: Position of pose 1, ``(..., 3)`` [m].
        q01: Orientation of pose 1, ``(..., 4)``.
        t02: Position of pose 2, ``(..., 3)`` [m].
        q02: Orientation of pose 2, ``(..., 4)``.
        rot_error_type: ``"axis_angle"`` or ``"quat"``.

    Returns:
        Position error ``(..., 3)`` [m] and orientation error: a rotation vector ``(..., 3)`` [rad], or a quaternion
        ``(..., 4)``.

    Raises:
        ValueError: if ``rot_error_type`` is something else.
    """
    turn = quat_mul(q02, quat_inv(q01))
    if rot_error_type == "quat":
        return t02 - t01, turn
    if rot_error_type == "axis_angle":
        return t02 - t01, axis_angle_from_quat(turn)
    raise ValueError(f"compute_pose_error: rot_error_type '{rot_error_type}' is neither 'axis_angle' nor 'quat'")


def apply_delta_pose(
    source_pos: torch.Tensor, source_rot: torch.Tensor, delta_pose: torch.Tensor, eps: float = 1.0e-6
) -> tuple[torch.Tensor, torch.Tensor]:
    """Displace poses: the inverse of :func:`compute_pose_error`.

    Args:
        source_pos: Positions ``(..., 3)`` [m].
        source_rot: Orientations ``(..., 4)``.
        delta_pose: Displacements [m] and rotation vectors [rad], ``(..., 6)``, in the frame of the poses.
        eps: Rotations by no more than this angle [rad] are left out: they have no direction.

    Returns:
        Positions ``(..., 3)`` and orientations ``(..., 4)``.
    """
    angle = torch.linalg.vector_norm(delta_pose[..., 3:6], dim=-1)
    turn = quat_from_angle_axis(torch.where(angle > eps, angle, torch.zeros_like(angle)), delta_pose[..., 3:6])
    return source_pos + delta_pose[..., 0:3], quat_mul(turn, source_rot)


def rigid_body_twist_transform(
    v0: torch.Tensor, w0: torch.Tensor, t01: torch.Tensor, q01: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Velocities of a rigid body at another point and in another frame.

    Args:
        v0: Linear velocity of the body's point at the origin of frame 0, in frame 0, ``(..., 3)`` [m/s].
        w0: Angular velocity in frame 0, ``(..., 3)`` [rad/s].
        t01: Position of frame 1 in frame 0, ``(..., 3)`` [m].
        q01: Orientation of frame 1 in frame 0, ``(..., 4)``.

    Returns:
        Linear velocity ``(..., 3)`` of the body's point at the origin of frame 1, and angular velocity ``(..., 3)``,
        both in frame 1.
    """
    moved = v0 + torch.linalg.cross(w0, t01)
    return quat_apply_inverse(q01, moved), quat_apply_inverse(q01, w0)


def transform_points(
    points: torch.Tensor, pos: torch.Tensor | None = None, quat: torch.Tensor | None = None
) -> torch.Tensor:
    """Points in the frame in which their own frame has a pose.

    Args:
        points: ``(P, 3)`` or ``(N, P, 3)`` [m].
        pos: Position of their frame, ``(3,)`` or ``(N, 3)`` [m]; None means zero.
        quat: Orientation of their frame, ``(4,)`` or ``(N, 4)``; None means the identity.

    Returns:
        Points ``(N, P, 3)``, or ``(P, 3)`` if neither points nor pose have a batch of more than one.

    Raises:
        ValueError: if a shape is none of these.
    """
    if points.dim() not in (2, 3):
        raise ValueError(f"transform_points: expected points (P, 3) or (N, P, 3), got {list(points.shape)}")
    out = points if points.dim() == 3 else points.unsqueeze(0)
    if quat is not None:
        if quat.dim() not in (1, 2):
            raise ValueError(f"transform_points: expected quat (4,) or (N, 4), got {list(quat.shape)}")
        out = out @ matrix_from_quat(quat.reshape(-1, 4)).transpose(-1, -2)
    if pos is not None:
        if pos.dim() not in (1, 2):
            raise ValueError(f"transform_points: expected pos (3,) or (N, 3), got {list(pos.shape)}")
        out = out + pos.reshape(-1, 1, 3)
    if points.dim() == 2 and out.shape[0] == 1:
        return out.squeeze(0)
    return out
