# SPDX-License-Identifier: Apache-2.0
"""Rotations: functions on batches of vectors, quaternions, Euler angles and rotation matrices.

Quaternions are ``(x, y, z, w)`` and of unit length unless a function says otherwise; angles are radians. Shapes are
written ``(..., n)``: leading dimensions are arbitrary and broadcast. Results have the type and device of the arguments.
Functions of tensors alone can be called from ``@torch.jit.script`` functions.

Source of formulas, where no other is named: J. Diebel, "Representing Attitude: Euler Angles, Unit Quaternions, and
Rotation Vectors", Stanford University, 2006.
"""

from __future__ import annotations

import math

import torch

__all__ = [
    "axis_angle_from_quat",
    "convert_quat",
    "copysign",
    "euler_xyz_from_quat",
    "matrix_from_euler",
    "matrix_from_quat",
    "normalize",
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
    "saturate",
    "scale_transform",
    "skew_symmetric_matrix",
    "unscale_transform",
    "wrap_to_pi",
    "yaw_quat",
]

Bound = torch.Tensor | float
"""A number, or a tensor that broadcasts."""


# ---- vectors and numbers ---------------------------------------------------------------------------------------------


def normalize(x: torch.Tensor, eps: float = 1e-9) -> torch.Tensor:
    """Normalise vectors ``(..., n)`` to unit length; vectors shorter than ``eps`` are divided by ``eps``."""
    return x / torch.linalg.vector_norm(x, dim=-1, keepdim=True).clamp(min=eps)


def wrap_to_pi(angles: torch.Tensor) -> torch.Tensor:
    """Wrap angles [rad], of any shape, to (-pi, pi].

    Example:
        >>> wrap_to_pi(torch.tensor([3.0, 4.0])).round(decimals=4)
        tensor([ 3.0000, -2.2832])
    """
    # Angles in that range are returned as they are: the remainder would change their last digits.
    wrapped = math.pi - torch.remainder(math.pi - angles, 2.0 * math.pi)
    return torch.where((angles > -math.pi) & (angles <= math.pi), angles, wrapped)


def saturate(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Clamp ``x`` to [``lower``, ``upper``], elementwise; the bounds broadcast, e.g. ``(n,)`` against ``(N, n)``."""
    return torch.maximum(torch.minimum(x, upper), lower)


def scale_transform(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Map [``lower``, ``upper``] linearly to [-1, 1], elementwise; values outside the bounds are not clamped.

    Example:
        >>> lower, upper = torch.tensor([0.0, -2.0]), torch.tensor([4.0, 2.0])
        >>> scale_transform(torch.tensor([1.0, 2.0]), lower, upper)
        tensor([-0.5000,  1.0000])
    """
    return 2.0 * (x - 0.5 * (lower + upper)) / (upper - lower)


def unscale_transform(x: torch.Tensor, lower: torch.Tensor, upper: torch.Tensor) -> torch.Tensor:
    """Map [-1, 1] linearly to [``lower``, ``upper``], elementwise: the inverse of :func:`scale_transform`.

    Example:
        >>> unscale_transform(torch.tensor([-1.0, 0.5]), torch.tensor(0.0), torch.tensor(4.0))
        tensor([0., 3.])
    """
    return 0.5 * (x * (upper - lower) + upper + lower)


# ---- quaternions -----------------------------------------------------------------------------------------------------


def quat_conjugate(q: torch.Tensor) -> torch.Tensor:
    """Conjugate of quaternions ``(..., 4)``: the inverse rotation if they have unit length."""
    return torch.cat((-q[..., :3], q[..., 3:]), dim=-1)


def quat_inv(q: torch.Tensor, eps: float = 1e-9) -> torch.Tensor:
    """Inverse of quaternions ``(..., 4)`` of any length; a squared length below ``eps`` counts as ``eps``."""
    return quat_conjugate(q) / q.square().sum(dim=-1, keepdim=True).clamp(min=eps)


def quat_mul(q1: torch.Tensor, q2: torch.Tensor) -> torch.Tensor:
    """Hamilton product of ``(..., 4)`` with ``(..., 4)``: the rotation ``q2`` followed by ``q1``.

    Example:
        >>> quarter = quat_from_angle_axis(torch.tensor(torch.pi / 2), torch.tensor([0.0, 0.0, 1.0]))
        >>> quat_mul(quarter, quarter).round(decimals=4)  # half a turn about z
        tensor([0., 0., 1., 0.])
    """
    q1, q2 = torch.broadcast_tensors(q1, q2)
    v1, w1 = q1[..., :3], q1[..., 3:]
    v2, w2 = q2[..., :3], q2[..., 3:]
    vector = w1 * v2 + w2 * v1 + torch.linalg.cross(v1, v2)
    return torch.cat((vector, w1 * w2 - (v1 * v2).sum(dim=-1, keepdim=True)), dim=-1)


def quat_apply(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Rotate vectors ``(..., 3)`` by quaternions ``(..., 4)``: from the rotated frame to the frame it is given in.

    Example:
        >>> quarter = quat_from_angle_axis(torch.tensor(torch.pi / 2), torch.tensor([0.0, 0.0, 1.0]))
        >>> quat_apply(quarter, torch.tensor([1.0, 1.0, 0.0])).round(decimals=4)  # x becomes y
        tensor([-1.,  1.,  0.])
    """
    # q v q* with the products of zeros left out: two cross products, no rotation matrix.
    quat, vec = broadcast_leading(quat, vec)
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
    """Quaternions ``(..., 4)`` of rotations by ``angle`` ``(...)`` [rad] about ``axis`` ``(..., 3)`` of any length.

    Example:
        >>> quat_from_angle_axis(torch.tensor(torch.pi / 2), torch.tensor([5.0, 0.0, 0.0])).round(decimals=4)
        tensor([0.7071, 0.0000, 0.0000, 0.7071])
    """
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

    Example:
        >>> zero = torch.zeros(2)
        >>> quat_from_euler_xyz(zero, zero, torch.tensor([0.0, torch.pi / 2])).round(decimals=4)
        tensor([[0.0000, 0.0000, 0.0000, 1.0000],
                [0.0000, 0.0000, 0.7071, 0.7071]])
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
    """Yaw of rotations ``(..., 4)`` as quaternions ``(..., 4)``: the part about the vertical, with x and y zero.

    Example:
        >>> tilted = quat_from_euler_xyz(torch.tensor(0.3), torch.tensor(0.0), torch.tensor(torch.pi / 2))
        >>> yaw_quat(tilted).round(decimals=4)
        tensor([0.0000, 0.0000, 0.7071, 0.7071])
    """
    x, y, z, w = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    # Half the angle of the rotated x axis, seen from above.
    half = 0.5 * torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    zero = torch.zeros_like(half)
    return torch.stack((zero, zero, torch.sin(half), torch.cos(half)), dim=-1)


def quat_apply_yaw(quat: torch.Tensor, vec: torch.Tensor) -> torch.Tensor:
    """Rotate vectors ``(..., 3)`` by the yaw of quaternions ``(..., 4)`` alone."""
    return quat_apply(yaw_quat(quat), vec)


def quat_box_minus(q1: torch.Tensor, q2: torch.Tensor) -> torch.Tensor:
    """Rotation vectors ``(..., 3)`` [rad] from ``q2`` to ``q1``, both ``(..., 4)``, in the frame they are given in."""
    return axis_angle_from_quat(quat_mul(q1, quat_conjugate(q2)))


def quat_box_plus(q: torch.Tensor, delta: torch.Tensor, eps: float = 1e-6) -> torch.Tensor:
    """Quaternions ``(..., 4)`` with ``w >= 0``: ``q`` turned by rotation vectors ``delta`` ``(..., 3)`` [rad].

    Vectors shorter than ``eps`` count as of that length, with the direction and length ratio that they have.
    """
    angle = torch.linalg.vector_norm(delta, dim=-1).clamp(min=eps)
    turn = quat_from_angle_axis(angle, delta / angle.unsqueeze(-1))
    return quat_unique(quat_mul(turn, q))


def quat_slerp(q1: torch.Tensor, q2: torch.Tensor, tau: Bound) -> torch.Tensor:
    """Interpolate between rotations ``(..., 4)`` at constant angular velocity, the shorter way around.

    Args:
        q1: Rotations at ``tau`` 0.
        q2: Rotations at ``tau`` 1. Where its product with ``q1`` is negative, ``-q2`` is used: the same rotation.
        tau: Fraction of the way, a number or ``(..., 1)``.

    Returns:
        Quaternions ``(..., 4)``; ``q1`` where the two differ by less than the precision of their type.

    Source: K. Shoemake, "Animating Rotation with Quaternion Curves", SIGGRAPH 1985.
    """
    dot = (q1 * q2).sum(dim=-1, keepdim=True)
    q2 = torch.where(dot < 0.0, -q2, q2)
    dot = dot.abs().clamp(max=1.0)
    angle = torch.acos(dot)
    near = 1.0 - dot < 4.0 * torch.finfo(q1.dtype).eps
    sine = torch.where(near, torch.ones_like(angle), torch.sin(angle))
    mixed = (torch.sin((1.0 - tau) * angle) * q1 + torch.sin(tau * angle) * q2) / sine
    return torch.where(near, q1, mixed)


def matrix_from_euler(euler_angles: torch.Tensor, convention: str) -> torch.Tensor:
    """Rotation matrices ``(..., 3, 3)`` of Euler angles ``(..., 3)`` [rad] about axes that turn with the body.

    Args:
        euler_angles: Angles in the order of ``convention``.
        convention: Three letters of X, Y and Z, neighbours different: ``"XYZ"`` is ``Rx(a0) Ry(a1) Rz(a2)``.

    Raises:
        ValueError: if the angles are not ``(..., 3)``, or the convention is not as above.
    """
    if euler_angles.dim() == 0 or euler_angles.shape[-1] != 3:
        raise ValueError(f"matrix_from_euler: expected angles (..., 3), got {tuple(euler_angles.shape)}")
    if len(convention) != 3 or set(convention) - set("XYZ") or convention[1] in (convention[0], convention[2]):
        raise ValueError(
            f"matrix_from_euler: convention {convention!r} is not three letters of X, Y and Z with different neighbours"
        )
    first, second, third = (
        _axis_matrix("XYZ".index(letter), euler_angles[..., i]) for i, letter in enumerate(convention)
    )
    return first @ second @ third


def skew_symmetric_matrix(vec: torch.Tensor) -> torch.Tensor:
    """Matrices ``(N, 3, 3)`` of the cross product with vectors ``(N, 3)`` or ``(3,)``, for which ``N`` is 1.

    Raises:
        ValueError: if the vectors are not ``(3,)`` or ``(N, 3)``.
    """
    if vec.shape[-1] != 3:
        raise ValueError(f"skew_symmetric_matrix: expected vectors (N, 3) or (3,), got {list(vec.shape)}")
    x, y, z = torch.unbind(vec.reshape(-1, 3), dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=-1).reshape(-1, 3, 3)


def _axis_matrix(axis: int, angle: torch.Tensor) -> torch.Tensor:
    """Rotation matrices ``(..., 3, 3)`` about coordinate axis 0, 1 or 2."""
    unit = torch.zeros(angle.shape + (3,), dtype=angle.dtype, device=angle.device)
    unit[..., axis] = 1.0
    return matrix_from_quat(quat_from_angle_axis(angle, unit))


def broadcast_leading(quat: torch.Tensor, vec: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotations and vectors with the same leading dimensions, those they broadcast to."""
    # torch.linalg.cross broadcasts only tensors of equal rank.
    if quat.shape[:-1] == vec.shape[:-1]:
        return quat, vec
    shape = torch.broadcast_tensors(quat[..., 0], vec[..., 0])[0].shape
    return quat.expand(shape + (4,)), vec.expand(shape + (3,))


# ---- names and orders of Isaac Lab -----------------------------------------------------------------------------------

quat_rotate = quat_apply
"""Former name of :func:`quat_apply` in Isaac Lab."""
quat_rotate_inverse = quat_apply_inverse
"""Former name of :func:`quat_apply_inverse` in Isaac Lab."""


def copysign(mag: float, other: torch.Tensor) -> torch.Tensor:
    """Numbers of magnitude ``mag`` with the signs of ``other``."""
    return torch.copysign(torch.full_like(other, abs(mag)), other)


def convert_quat(quat: torch.Tensor, to: str = "xyzw") -> torch.Tensor:
    """Quaternions ``(..., 4)`` from the other order to ``to``, ``"xyzw"`` or ``"wxyz"``.

    Raises:
        ValueError: if the shape or the order is not one of these.
    """
    if quat.shape[-1] != 4:
        raise ValueError(f"convert_quat: expected quaternions (..., 4), got {quat.shape}")
    if to != "xyzw" and to != "wxyz":
        raise ValueError(f"convert_quat: the order '{to}' is neither 'xyzw' nor 'wxyz'")
    return quat.roll(-1 if to == "xyzw" else 1, dims=-1)
