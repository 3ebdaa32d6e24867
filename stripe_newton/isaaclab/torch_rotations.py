# SPDX-License-Identifier: Apache-2.0
"""Functions of ``isaacsim.core.utils.torch``: rotations and poses on batches, with quaternions (w, x, y, z).

They can be called from ``@torch.jit.script`` functions, as tasks of Isaac Lab do. Quaternions have shape ``(..., 4)``,
vectors ``(..., 3)``, angles are radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from stripe_newton.math import compute_heading_and_up as _compute_heading_and_up
from stripe_newton.math import euler_xyz_from_quat as _euler_xyz_from_quat
from stripe_newton.math import normalize as _normalize
from stripe_newton.math import quat_apply as _quat_apply
from stripe_newton.math import quat_apply_inverse as _quat_apply_inverse
from stripe_newton.math import quat_from_angle_axis as _quat_from_angle_axis
from stripe_newton.math import quat_from_euler_xyz as _quat_from_euler_xyz
from stripe_newton.math import quat_mul as _quat_mul
from stripe_newton.math import scale_transform as _scale_transform
from stripe_newton.math import unscale_transform as _unscale_transform

__all__ = [
    "compute_heading_and_up",
    "compute_rot",
    "get_euler_xyz",
    "normalize",
    "quat_apply",
    "quat_conjugate",
    "quat_from_angle_axis",
    "quat_from_euler_xyz",
    "quat_mul",
    "quat_rotate",
    "quat_rotate_inverse",
    "scale",
    "tf_apply",
    "tf_combine",
    "tf_inverse",
    "tf_vector",
    "torch_rand_float",
    "unscale",
]

# Plain tensors rather than those of `quaternions`: TorchScript has no tensor subclasses.


def _xyzw(q: torch.Tensor) -> torch.Tensor:
    return torch.cat((q[..., 1:], q[..., :1]), dim=-1)


def _wxyz(q: torch.Tensor) -> torch.Tensor:
    return torch.cat((q[..., 3:], q[..., :3]), dim=-1)


def normalize(x: torch.Tensor, eps: float = 1e-9) -> torch.Tensor:
    """Vectors ``(..., n)`` at unit length."""
    return _normalize(x, eps)


def scale(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Numbers of [-1, 1] mapped to [lower, upper]."""
    return _unscale_transform(x, lower, upper)


def unscale(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Numbers of [lower, upper] mapped to [-1, 1]."""
    return _scale_transform(x, lower, upper)


def quat_conjugate(a: torch.Tensor) -> torch.Tensor:
    """Conjugates, the inverse rotations."""
    return torch.cat((a[..., :1], -a[..., 1:]), dim=-1)


def quat_mul(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Products ``a b``: first rotation ``b``, then ``a``."""
    return _wxyz(_quat_mul(_xyzw(a), _xyzw(b)))


def quat_apply(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Vectors ``b`` rotated by ``a``."""
    return _quat_apply(_xyzw(a), b)


def quat_rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Vectors ``v`` rotated by ``q``."""
    return _quat_apply(_xyzw(q), v)


def quat_rotate_inverse(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Vectors ``v`` rotated by the inverse of ``q``."""
    return _quat_apply_inverse(_xyzw(q), v)


def quat_from_angle_axis(angle: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Rotations by ``angle``, shape ``(...)``, about ``axis``."""
    return _wxyz(_quat_from_angle_axis(angle, axis))


def quat_from_euler_xyz(roll: torch.Tensor, pitch: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
    """Rotations by roll about x, then pitch about y, then yaw about z, all of the fixed frame."""
    return _wxyz(_quat_from_euler_xyz(roll, pitch, yaw))


def get_euler_xyz(q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Roll, pitch and yaw about the axes of the fixed frame, each in [0, 2 pi)."""
    roll, pitch, yaw = _euler_xyz_from_quat(_xyzw(q))
    turn = 2.0 * math.pi
    return torch.remainder(roll, turn), torch.remainder(pitch, turn), torch.remainder(yaw, turn)


def tf_inverse(q: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotation and translation of the inverse transform."""
    inverse = quat_conjugate(q)
    return inverse, -quat_apply(inverse, t)


def tf_apply(q: torch.Tensor, t: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Points ``v`` under the transform."""
    return quat_apply(q, v) + t


def tf_vector(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Directions ``v`` under a transform of rotation ``q``."""
    return quat_apply(q, v)


def tf_combine(
    q1: torch.Tensor, t1: torch.Tensor, q2: torch.Tensor, t2: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotation and translation of the second transform followed by the first."""
    return quat_mul(q1, q2), quat_apply(q1, t2) + t1


def compute_heading_and_up(
    torso_rotation: torch.Tensor,
    inv_start_rot: torch.Tensor,
    to_target: torch.Tensor,
    vec0: torch.Tensor,
    vec1: torch.Tensor,
    up_idx: int,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Heading and up direction of torsos, as :func:`stripe_newton.math.compute_heading_and_up` has them.

    Returns:
        Torso's rotation since the start, up component ``(n,)``, component of the heading towards the target ``(n,)``,
        up vector and heading vector.
    """
    quat, up_proj, heading_proj, up, heading = _compute_heading_and_up(
        _xyzw(torso_rotation), _xyzw(inv_start_rot), to_target, vec0, vec1, up_idx
    )
    return _wxyz(quat), up_proj, heading_proj, up, heading


def compute_rot(
    torso_quat: torch.Tensor,
    velocity: torch.Tensor,
    ang_velocity: torch.Tensor,
    targets: torch.Tensor,
    torso_positions: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Velocities in the torso's frame, its Euler angles, and the angle to a target about z.

    Returns:
        Linear and angular velocity in the torso's frame; roll, pitch and yaw in [0, 2 pi); direction to the target
        less yaw, each ``(n,)``.
    """
    roll, pitch, yaw = get_euler_xyz(torso_quat)
    offset = targets - torso_positions
    angle_to_target = torch.atan2(offset[..., 1], offset[..., 0]) - yaw
    lin_vel, ang_vel = quat_rotate_inverse(torso_quat, velocity), quat_rotate_inverse(torso_quat, ang_velocity)
    return lin_vel, ang_vel, roll, pitch, yaw, angle_to_target


def torch_rand_float(lower: float, upper: float, shape: Sequence[int], device: str) -> torch.Tensor:
    """Uniform random numbers of [lower, upper)."""
    return (upper - lower) * torch.rand(tuple(shape), device=device) + lower
