# SPDX-License-Identifier: Apache-2.0
"""Math: functions on batches of vectors, quaternions and poses, and random samples of them.

Quaternions are ``(x, y, z, w)`` and of unit length unless a function says otherwise; angles are radians. Shapes are
written ``(..., n)``: leading dimensions are arbitrary and broadcast. Results have the type and device of the arguments.
Functions of tensors alone can be called from ``@torch.jit.script`` functions.

Source of formulas, where no other is named: J. Diebel, "Representing Attitude: Euler Angles, Unit Quaternions, and
Rotation Vectors", Stanford University, 2006.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

__all__ = [
    "axis_angle_from_quat",
    "combine_frame_transforms",
    "compute_heading_and_up",
    "compute_rot",
    "euler_xyz_from_quat",
    "matrix_from_quat",
    "normalize",
    "quat_apply",
    "quat_apply_inverse",
    "quat_apply_yaw",
    "quat_conjugate",
    "quat_error_magnitude",
    "quat_from_angle_axis",
    "quat_from_euler_xyz",
    "quat_from_matrix",
    "quat_inv",
    "quat_mul",
    "quat_unique",
    "random_orientation",
    "random_yaw_orientation",
    "sample_gaussian",
    "sample_log_uniform",
    "sample_uniform",
    "saturate",
    "scale_transform",
    "subtract_frame_transforms",
    "unscale_transform",
    "wrap_to_pi",
    "yaw_quat",
]

Bound = torch.Tensor | float


# ---- vectors and numbers ---------------------------------------------------------------------------------------------


def normalize(x: torch.Tensor, eps: float = 1e-9) -> torch.Tensor:
    """Normalise vectors ``(..., n)`` to unit length; vectors shorter than ``eps`` are divided by ``eps``."""
    return x / torch.linalg.vector_norm(x, dim=-1, keepdim=True).clamp(min=eps)


def wrap_to_pi(angles: torch.Tensor) -> torch.Tensor:
    """Wrap angles [rad], of any shape, to (-pi, pi]."""
    # Angles in that range are returned as they are: the remainder would change their last digits.
    wrapped = math.pi - torch.remainder(math.pi - angles, 2.0 * math.pi)
    return torch.where((angles > -math.pi) & (angles <= math.pi), angles, wrapped)


def saturate(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Clamp ``x`` to [``lower``, ``upper``], elementwise; the bounds broadcast, e.g. ``(n,)`` against ``(N, n)``."""
    return torch.maximum(torch.minimum(x, upper), lower)


def scale_transform(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Map [``lower``, ``upper``] linearly to [-1, 1], elementwise; values outside the bounds are not clamped."""
    return 2.0 * (x - 0.5 * (lower + upper)) / (upper - lower)


def unscale_transform(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Map [-1, 1] linearly to [``lower``, ``upper``], elementwise: the inverse of :func:`scale_transform`."""
    return 0.5 * (x * (upper - lower) + upper + lower)


# ---- quaternions -----------------------------------------------------------------------------------------------------


def quat_conjugate(q: torch.Tensor) -> torch.Tensor:
    """Conjugate of quaternions ``(..., 4)``: the inverse rotation if they have unit length."""
    return torch.cat((-q[..., :3], q[..., 3:]), dim=-1)


def quat_inv(q: torch.Tensor, eps: float = 1e-9) -> torch.Tensor:
    """Inverse of quaternions ``(..., 4)`` of any length; a squared length below ``eps`` counts as ``eps``."""
    return quat_conjugate(q) / q.square().sum(dim=-1, keepdim=True).clamp(min=eps)


def quat_mul(q1: torch.Tensor, q2: torch.Tensor) -> torch.Tensor:
    """Hamilton product of ``(..., 4)`` with ``(..., 4)``: the rotation ``q2`` followed by ``q1``."""
    q1, q2 = torch.broadcast_tensors(q1, q2)
    v1, w1 = q1[..., :3], q1[..., 3:]
    v2, w2 = q2[..., :3], q2[..., 3:]
    vector = w1 * v2 + w2 * v1 + torch.linalg.cross(v1, v2)
    return torch.cat((vector, w1 * w2 - (v1 * v2).sum(dim=-1, keepdim=True)), dim=-1)


def quat_apply(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Rotate vectors ``(..., 3)`` by quaternions ``(..., 4)``: from the rotated frame to the frame it is given in."""
    # q v q* with the products of zeros left out: two cross products, no rotation matrix.
    quat, vec = _broadcast_leading(quat, vec)
    xyz = quat[..., :3]
    t = 2.0 * torch.linalg.cross(xyz, vec)
    return vec + quat[..., 3:] * t + torch.linalg.cross(xyz, t)


def quat_apply_inverse(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Rotate vectors ``(..., 3)`` by the inverse of quaternions ``(..., 4)``, e.g. from the world to the body frame."""
    return quat_apply(quat_conjugate(quat), vec)


def quat_unique(q: torch.Tensor) -> torch.Tensor:
    """Unique quaternions ``(..., 4)`` of rotations: the ones of ``q`` and ``-q`` with ``w >= 0``."""
    return torch.where(q[..., 3:] < 0.0, -q, q)


def quat_from_angle_axis(angle: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` of rotations by ``angle`` ``(...)`` [rad] about ``axis`` ``(..., 3)`` of any length."""
    half = 0.5 * angle.unsqueeze(-1)
    vector = normalize(axis) * torch.sin(half)
    w = torch.cos(half).expand(vector.shape[:-1] + (1,))
    return normalize(torch.cat((vector, w), dim=-1))


def axis_angle_from_quat(quat: torch.Tensor, eps: float = 1e-6) -> torch.Tensor:
    """Rotation vectors ``(..., 3)`` [rad], axis times angle in [0, pi], of quaternions ``(..., 4)``.

    Where the sine of half the angle is below ``eps`` the quotient is replaced by the first term of its series, so that
    small rotations keep their value and derivative.
    """
    quat = quat_unique(quat)  # the shorter of the two ways around
    sine = torch.linalg.vector_norm(quat[..., :3], dim=-1, keepdim=True)
    half = torch.atan2(sine, quat[..., 3:])  # acos(w) would lose half of the digits near w = 1
    factor = torch.where(sine < eps, 2.0 * torch.ones_like(sine), 2.0 * half / sine.clamp(min=eps))
    return quat[..., :3] * factor


def quat_error_magnitude(q1: torch.Tensor, q2: torch.Tensor) -> torch.Tensor:
    """Angle ``(...)`` [rad], in [0, pi], of the rotation between quaternions ``(..., 4)`` and ``(..., 4)``."""
    return torch.linalg.vector_norm(axis_angle_from_quat(quat_mul(q1, quat_conjugate(q2))), dim=-1)


def quat_from_euler_xyz(roll: torch.Tensor, pitch: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` of angles ``(...)`` [rad]: roll about x, then pitch about y, then yaw about z.

    The axes are fixed in the parent frame (``Rz(yaw) Ry(pitch) Rx(roll)``).
    """
    cr, sr = torch.cos(0.5 * roll), torch.sin(0.5 * roll)
    cp, sp = torch.cos(0.5 * pitch), torch.sin(0.5 * pitch)
    cy, sy = torch.cos(0.5 * yaw), torch.sin(0.5 * yaw)
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    w = cr * cp * cy + sr * sp * sy
    return torch.stack((x, y, z, w), dim=-1)


def euler_xyz_from_quat(
    quat: torch.Tensor, wrap_to_2pi: bool = False
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Roll, pitch and yaw, each ``(...)`` [rad], of quaternions ``(..., 4)``: see :func:`quat_from_euler_xyz`.

    Roll and yaw are in [-pi, pi] and pitch in [-pi/2, pi/2]; with ``wrap_to_2pi`` all three are in [0, 2 pi). At a
    pitch of pi/2 only yaw - roll is defined, at -pi/2 only yaw + roll; the three angles returned then still give the
    same rotation.
    """
    x, y, z, w = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    # Sum and difference of roll and yaw are each given by two components: no division, and no loss of digits near the
    # singularity.
    total = torch.atan2(x + z, w - y)  # (yaw + roll) / 2
    difference = torch.atan2(z - x, w + y)  # (yaw - roll) / 2
    up = torch.sqrt((x + z).square() + (w - y).square())
    down = torch.sqrt((z - x).square() + (w + y).square())
    pitch = 2.0 * torch.atan2(down, up) - 0.5 * math.pi
    roll = wrap_to_pi(total - difference)
    yaw = wrap_to_pi(total + difference)
    if wrap_to_2pi:
        turn = 2.0 * math.pi
        return torch.remainder(roll, turn), torch.remainder(pitch, turn), torch.remainder(yaw, turn)
    return roll, pitch, yaw


def matrix_from_quat(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices ``(..., 3, 3)`` of quaternions ``(..., 4)`` of any length but zero."""
    x, y, z, w = torch.unbind(quaternions, dim=-1)
    s = 2.0 / quaternions.square().sum(dim=-1)
    rows = (
        1.0 - s * (y * y + z * z),
        s * (x * y - z * w),
        s * (x * z + y * w),
        s * (x * y + z * w),
        1.0 - s * (x * x + z * z),
        s * (y * z - x * w),
        s * (x * z - y * w),
        s * (y * z + x * w),
        1.0 - s * (x * x + y * y),
    )
    return torch.stack(rows, dim=-1).reshape(quaternions.shape[:-1] + (3, 3))


def quat_from_matrix(matrix: torch.Tensor) -> torch.Tensor:
    """Quaternions ``(..., 4)`` with ``w >= 0`` of rotation matrices ``(..., 3, 3)``.

    Source: S. W. Shepperd, "Quaternion from Rotation Matrix", J. Guidance and Control 1(3), 1978: of the four ways to
    write the quaternion, the one that divides by its largest component.
    """
    m00, m11, m22 = matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 2, 2]
    # Four times the squares of the components, then four times their products.
    xx, yy, zz = 1.0 + m00 - m11 - m22, 1.0 - m00 + m11 - m22, 1.0 - m00 - m11 + m22
    ww = 1.0 + m00 + m11 + m22
    xy, xz, yz = (
        matrix[..., 1, 0] + matrix[..., 0, 1],
        matrix[..., 0, 2] + matrix[..., 2, 0],
        matrix[..., 2, 1] + matrix[..., 1, 2],
    )
    xw, yw, zw = (
        matrix[..., 2, 1] - matrix[..., 1, 2],
        matrix[..., 0, 2] - matrix[..., 2, 0],
        matrix[..., 1, 0] - matrix[..., 0, 1],
    )
    candidates = torch.stack(  # row i is 4 q_i (x, y, z, w)
        (
            torch.stack((xx, xy, xz, xw), dim=-1),
            torch.stack((xy, yy, yz, yw), dim=-1),
            torch.stack((xz, yz, zz, zw), dim=-1),
            torch.stack((xw, yw, zw, ww), dim=-1),
        ),
        dim=-2,
    )
    largest = torch.stack((xx, yy, zz, ww), dim=-1).argmax(dim=-1)
    index = largest.unsqueeze(-1).unsqueeze(-1).expand(largest.shape + (1, 4))
    return quat_unique(normalize(torch.gather(candidates, -2, index).squeeze(-2)))


def yaw_quat(quat: torch.Tensor) -> torch.Tensor:
    """Yaw of rotations ``(..., 4)`` as quaternions ``(..., 4)``: the part about the vertical, with x and y zero."""
    x, y, z, w = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    # Half the angle of the rotated x axis, seen from above.
    half = 0.5 * torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    zero = torch.zeros_like(half)
    return torch.stack((zero, zero, torch.sin(half), torch.cos(half)), dim=-1)


def quat_apply_yaw(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Rotate vectors ``(..., 3)`` by the yaw of quaternions ``(..., 4)`` alone."""
    return quat_apply(yaw_quat(quat), vec)


# ---- poses -----------------------------------------------------------------------------------------------------------


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


# ---- locomotion ------------------------------------------------------------------------------------------------------


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


# ---- random samples --------------------------------------------------------------------------------------------------


def sample_uniform(
    lower: Bound,
    upper: Bound,
    size: int | Sequence[int],
    device: str | torch.device,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Uniform samples in [``lower``, ``upper``), of shape ``size``; bounds that are tensors broadcast against it."""
    return _rand(size, device, generator) * (upper - lower) + lower


def sample_log_uniform(
    lower: Bound,
    upper: Bound,
    size: int | Sequence[int],
    device: str | torch.device,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Log-uniform samples between ``lower`` and ``upper``, both positive, of shape ``size``."""
    low = torch.log(torch.as_tensor(lower, dtype=torch.float32, device=device))
    high = torch.log(torch.as_tensor(upper, dtype=torch.float32, device=device))
    return torch.exp(sample_uniform(low, high, size, device, generator))


def sample_gaussian(
    mean: Bound,
    std: Bound,
    size: int | Sequence[int],
    device: str | torch.device,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Normal samples of shape ``size``; a mean and a standard deviation that are tensors broadcast against it."""
    return torch.randn(_shape(size), device=device, generator=generator) * std + mean


def random_orientation(num: int, device: str | torch.device, generator: torch.Generator | None = None) -> torch.Tensor:
    """Random orientations: quaternions ``(num, 4)``, uniform over all rotations."""
    # Normal samples have no preferred direction, so that their normalised vectors are uniform on the sphere.
    return normalize(torch.randn((num, 4), device=device, generator=generator))


def random_yaw_orientation(
    num: int, device: str | torch.device, generator: torch.Generator | None = None
) -> torch.Tensor:
    """Random yaw orientations: quaternions ``(num, 4)`` of rotations about the vertical, uniform in [-pi, pi)."""
    half = sample_uniform(-0.5 * math.pi, 0.5 * math.pi, num, device, generator)
    zero = torch.zeros_like(half)
    return torch.stack((zero, zero, torch.sin(half), torch.cos(half)), dim=-1)


def _broadcast_leading(quat: torch.Tensor, vec: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    # torch.linalg.cross broadcasts only tensors of equal rank.
    if quat.shape[:-1] == vec.shape[:-1]:
        return quat, vec
    shape = torch.broadcast_tensors(quat[..., 0], vec[..., 0])[0].shape
    return quat.expand(shape + (4,)), vec.expand(shape + (3,))


def _shape(size: int | Sequence[int]) -> tuple[int, ...]:
    return (size,) if isinstance(size, int) else tuple(size)


def _rand(size: int | Sequence[int], device: str | torch.device, generator: torch.Generator | None) -> torch.Tensor:
    return torch.rand(_shape(size), device=device, generator=generator)
