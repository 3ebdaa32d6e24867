# SPDX-License-Identifier: Apache-2.0
"""Math of the Isaac Lab dialect: ``isaaclab.utils.math`` with quaternions ``(w, x, y, z)``.

Names, arguments and values are those of Isaac Lab 2.3; all of them are computed by :mod:`stripe_newton.math`, whose
docstrings hold the details. Leading dimensions broadcast where Isaac Lab demands equal shapes. At a pitch of a quarter
turn, where Isaac Lab's Euler angles are noise, those of here give the same rotation.

The quaternions returned are ordinary tensors that can be written. Functions of tensors alone can be called from
``@torch.jit.script`` functions.
"""

from __future__ import annotations

import logging
import math
from typing import TypeVar

import numpy as np
import torch

from stripe_newton import math as native
from stripe_newton.math import (
    copysign,
    create_rotation_matrix_from_view,
    generate_random_rotation,
    generate_random_transformation_matrix,
    generate_random_translation,
    interpolate_poses,
    interpolate_rotations,
    make_pose,
    matrix_from_euler,
    normalize,
    orthogonalize_perspective_depth,
    pose_in_A_to_pose_in_B,
    pose_inv,
    # Isaac Lab takes four normal samples as (w, x, y, z), stripe_newton as (x, y, z, w): the same numbers.
    random_orientation,
    sample_cylinder,
    sample_gaussian,
    sample_log_uniform,
    sample_triangle,
    sample_uniform,
    saturate,
    scale_transform,
    skew_symmetric_matrix,
    transform_poses_from_frame_A_to_frame_B,
    unmake_pose,
    unproject_depth,
    unscale_transform,
)

logger = logging.getLogger(__name__)

__all__ = [
    "apply_delta_pose",
    "axis_angle_from_quat",
    "combine_frame_transforms",
    "compute_pose_error",
    "convert_camera_frame_orientation_convention",
    "convert_quat",
    "copysign",
    "create_rotation_matrix_from_view",
    "default_orientation",
    "euler_xyz_from_quat",
    "generate_random_rotation",
    "generate_random_transformation_matrix",
    "generate_random_translation",
    "interpolate_poses",
    "interpolate_rotations",
    "is_identity_pose",
    "make_pose",
    "matrix_from_euler",
    "matrix_from_quat",
    "normalize",
    "orthogonalize_perspective_depth",
    "pose_in_A_to_pose_in_B",
    "pose_inv",
    "project_points",
    "quat_apply",
    "quat_apply_inverse",
    "quat_apply_yaw",
    "quat_box_minus",
    "quat_box_plus",
    "quat_conjugate",
    "quat_error_magnitude",
    "quat_from_angle_axis",
    "quat_from_euler_xyz",
    "quat_from_matrix",
    "quat_inv",
    "quat_mul",
    "quat_rotate",
    "quat_rotate_inverse",
    "quat_slerp",
    "quat_unique",
    "random_orientation",
    "random_yaw_orientation",
    "rigid_body_twist_transform",
    "sample_cylinder",
    "sample_gaussian",
    "sample_log_uniform",
    "sample_triangle",
    "sample_uniform",
    "saturate",
    "scale_transform",
    "skew_symmetric_matrix",
    "subtract_frame_transforms",
    "transform_points",
    "transform_poses_from_frame_A_to_frame_B",
    "unmake_pose",
    "unproject_depth",
    "unscale_transform",
    "wrap_to_pi",
    "yaw_quat",
]

Array = TypeVar("Array", torch.Tensor, np.ndarray)


def _xyzw(quat: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` in the order of stripe_newton."""
    return torch.cat((quat[..., 1:], quat[..., :1]), dim=-1)


def _wxyz(quat: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` in the order of Isaac Lab, as an ordinary tensor that TorchScript knows."""
    return torch.cat((quat[..., 3:], quat[..., :3]), dim=-1)


# ---- numbers ---------------------------------------------------------------------------------------------------------


def wrap_to_pi(angles: torch.Tensor) -> torch.Tensor:
    """Wrap angles [rad] to [-pi, pi]; odd multiples of pi keep their sign."""
    wrapped = native.wrap_to_pi(angles)
    return torch.where((wrapped >= math.pi) & (angles < 0.0), -wrapped, wrapped)


# ---- rotations -------------------------------------------------------------------------------------------------------


def convert_quat(quat: Array, to: str = "xyzw") -> Array:
    """Quaternions ``(..., 4)`` from the other order to ``to``, ``"xyzw"`` or ``"wxyz"``; tensors or arrays.

    Raises:
        ValueError: if the shape or the order is not one of these.
    """
    if quat.shape[-1] != 4:
        raise ValueError(f"convert_quat: expected quaternions (..., 4), got {tuple(quat.shape)}")
    if to not in ("xyzw", "wxyz"):
        raise ValueError(f"convert_quat: the order {to!r} is neither 'xyzw' nor 'wxyz'")
    shift = -1 if to == "xyzw" else 1
    return quat.roll(shift, dims=-1) if isinstance(quat, torch.Tensor) else np.roll(quat, shift, axis=-1)


def quat_unique(q: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` with ``w >= 0``."""
    return _wxyz(native.quat_unique(_xyzw(q)))


def quat_conjugate(q: torch.Tensor) -> torch.Tensor:
    """Conjugates ``(..., 4)``."""
    return _wxyz(native.quat_conjugate(_xyzw(q)))


def quat_inv(q: torch.Tensor, eps: float = 1e-9) -> torch.Tensor:
    """Inverses ``(..., 4)`` of quaternions of any length."""
    return _wxyz(native.quat_inv(_xyzw(q), eps))


def quat_mul(q1: torch.Tensor, q2: torch.Tensor) -> torch.Tensor:
    """Products ``(..., 4)``: the rotation ``q2`` followed by ``q1``."""
    return _wxyz(native.quat_mul(_xyzw(q1), _xyzw(q2)))


def quat_apply(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Vectors ``(..., 3)`` rotated by quaternions ``(..., 4)``; one vector by one quaternion has the vector's shape."""
    return _shaped_as(vec, native.quat_apply(_xyzw(quat), vec))


def quat_apply_inverse(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Vectors ``(..., 3)`` rotated by the inverse of quaternions ``(..., 4)``."""
    return _shaped_as(vec, native.quat_apply_inverse(_xyzw(quat), vec))


def quat_apply_yaw(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Vectors ``(..., 3)`` rotated by the yaw of quaternions ``(..., 4)``."""
    return _shaped_as(vec, native.quat_apply_yaw(_xyzw(quat), vec))


def _shaped_as(vec: torch.Tensor, rotated: torch.Tensor) -> torch.Tensor:
    """Rotated vectors in the shape of the vectors, as Isaac Lab has them, where they are as many."""
    return rotated.view(vec.shape) if rotated.numel() == vec.numel() else rotated


def quat_rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """:func:`quat_apply` by its old name."""
    logger.warning("quat_rotate is deprecated: use quat_apply")
    return quat_apply(q, v)


def quat_rotate_inverse(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """:func:`quat_apply_inverse` by its old name."""
    logger.warning("quat_rotate_inverse is deprecated: use quat_apply_inverse")
    return quat_apply_inverse(q, v)


def yaw_quat(quat: torch.Tensor) -> torch.Tensor:
    """Yaw of rotations, as quaternions ``(..., 4)``."""
    return _wxyz(native.yaw_quat(_xyzw(quat)))


def quat_box_minus(q1: torch.Tensor, q2: torch.Tensor) -> torch.Tensor:
    """Rotation vectors ``(..., 3)`` [rad] from ``q2`` to ``q1``."""
    return native.quat_box_minus(_xyzw(q1), _xyzw(q2))


def quat_box_plus(q: torch.Tensor, delta: torch.Tensor, eps: float = 1.0e-6) -> torch.Tensor:
    """Quaternions ``(..., 4)`` turned by rotation vectors ``(..., 3)`` [rad]."""
    return _wxyz(native.quat_box_plus(_xyzw(q), delta, eps))


def quat_error_magnitude(q1: torch.Tensor, q2: torch.Tensor) -> torch.Tensor:
    """Angles ``(...)`` [rad] between rotations."""
    return native.quat_error_magnitude(_xyzw(q1), _xyzw(q2))


def quat_slerp(q1: torch.Tensor, q2: torch.Tensor, tau: float) -> torch.Tensor:
    """Rotations between ``q1`` (``tau`` 0) and ``q2`` (``tau`` 1), neither of which is changed."""
    if tau == 1.0:
        return q2  # with the sign that it has, as in Isaac Lab
    return _wxyz(native.quat_slerp(_xyzw(q1), _xyzw(q2), tau))


def quat_from_angle_axis(angle: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` of angles ``(...)`` [rad] about axes ``(..., 3)``."""
    return _wxyz(native.quat_from_angle_axis(angle, axis))


def axis_angle_from_quat(quat: torch.Tensor, eps: float = 1.0e-6) -> torch.Tensor:
    """Rotation vectors ``(..., 3)`` [rad]."""
    return native.axis_angle_from_quat(_xyzw(quat), eps)


def quat_from_euler_xyz(roll: torch.Tensor, pitch: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` of roll, pitch and yaw ``(...)`` [rad]."""
    return _wxyz(native.quat_from_euler_xyz(roll, pitch, yaw))


def euler_xyz_from_quat(
    quat: torch.Tensor, wrap_to_2pi: bool = False
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Roll, pitch and yaw ``(...)`` [rad]."""
    return native.euler_xyz_from_quat(_xyzw(quat), wrap_to_2pi)


def matrix_from_quat(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices ``(..., 3, 3)``."""
    return native.matrix_from_quat(_xyzw(quaternions))


def quat_from_matrix(matrix: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` of rotation matrices, with the sign that makes the largest component positive."""
    quat = _wxyz(native.quat_from_matrix(matrix))
    m00, m11, m22 = matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 2, 2]
    squares = torch.stack((m00 + m11 + m22, m00 - m11 - m22, m11 - m00 - m22, m22 - m00 - m11), dim=-1)
    largest = torch.gather(quat, -1, squares.argmax(dim=-1, keepdim=True))
    return torch.where(largest < 0.0, -quat, quat)


def default_orientation(num: int, device: str) -> torch.Tensor:
    """Identity quaternions ``(num, 4)``."""
    return _wxyz(native.default_orientation(num, device))


def random_yaw_orientation(num: int, device: str) -> torch.Tensor:
    """Quaternions ``(num, 4)`` about the vertical, by angles uniform in [0, 2 pi)."""
    yaw = 2.0 * math.pi * torch.rand(num, device=device)
    zero = torch.zeros_like(yaw)
    return quat_from_euler_xyz(zero, zero, yaw)


def convert_camera_frame_orientation_convention(
    orientation: torch.Tensor, origin: str = "opengl", target: str = "ros"
) -> torch.Tensor:
    """Orientations ``(..., 4)`` of cameras in another convention; signs as of :func:`quat_from_matrix`."""
    if origin == target:
        return orientation.clone()
    turned = native.convert_camera_frame_orientation_convention(_xyzw(orientation), origin, target)
    return quat_from_matrix(native.matrix_from_quat(turned))


# ---- poses -----------------------------------------------------------------------------------------------------------


def is_identity_pose(pos: torch.Tensor, rot: torch.Tensor) -> bool:
    """Whether all positions ``(N, 3)`` are close to zero and all quaternions ``(N, 4)`` to the identity."""
    identity = torch.zeros_like(rot)
    identity[..., 0] = 1.0
    return torch.allclose(pos, torch.zeros_like(pos)) and torch.allclose(rot, identity)


def combine_frame_transforms(
    t01: torch.Tensor, q01: torch.Tensor, t12: torch.Tensor | None = None, q12: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Pose of frame 2 in frame 0, from those of 1 in 0 and of 2 in 1."""
    pos, quat = native.combine_frame_transforms(t01, _xyzw(q01), t12, None if q12 is None else _xyzw(q12))
    return pos, _wxyz(quat)


def subtract_frame_transforms(
    t01: torch.Tensor, q01: torch.Tensor, t02: torch.Tensor | None = None, q02: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Pose of frame 2 in frame 1, from those of 1 and 2 in frame 0."""
    pos, quat = native.subtract_frame_transforms(t01, _xyzw(q01), t02, None if q02 is None else _xyzw(q02))
    return pos, _wxyz(quat)


def compute_pose_error(
    t01: torch.Tensor, q01: torch.Tensor, t02: torch.Tensor, q02: torch.Tensor, rot_error_type: str = "axis_angle"
) -> tuple[torch.Tensor, torch.Tensor]:
    """Position error and rotation error (``"axis_angle"`` or ``"quat"``) from pose 1 to pose 2."""
    pos, error = native.compute_pose_error(t01, _xyzw(q01), t02, _xyzw(q02), rot_error_type)
    return pos, _wxyz(error) if rot_error_type == "quat" else error


def apply_delta_pose(
    source_pos: torch.Tensor, source_rot: torch.Tensor, delta_pose: torch.Tensor, eps: float = 1.0e-6
) -> tuple[torch.Tensor, torch.Tensor]:
    """Poses displaced by ``(..., 6)``: a displacement [m] and a rotation vector [rad]."""
    pos, quat = native.apply_delta_pose(source_pos, _xyzw(source_rot), delta_pose, eps)
    return pos, _wxyz(quat)


def rigid_body_twist_transform(
    v0: torch.Tensor, w0: torch.Tensor, t01: torch.Tensor, q01: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Linear and angular velocity of a rigid body at frame 1 and in it, from those at frame 0."""
    return native.rigid_body_twist_transform(v0, w0, t01, _xyzw(q01))


def transform_points(
    points: torch.Tensor, pos: torch.Tensor | None = None, quat: torch.Tensor | None = None
) -> torch.Tensor:
    """Points ``(P, 3)`` or ``(N, P, 3)`` moved by a pose ``(3,)`` or ``(N, 3)``, ``(4,)`` or ``(N, 4)``."""
    return native.transform_points(points, pos, None if quat is None else _xyzw(quat))


def project_points(points: torch.Tensor, intrinsics: torch.Tensor) -> torch.Tensor:
    """Pixels and depths ``(u, v, depth)`` of points.

    The shape is Isaac Lab's: ``(1, P, 3)`` for points ``(P, 3)``, ``(P, 3)`` for ``(1, P, 3)``, else ``(N, P, 3)``.
    """
    seen = native.project_points(points, intrinsics)
    if points.dim() == 2:
        return seen if seen.dim() == 3 else seen.unsqueeze(0)
    return seen.squeeze(0)
