# SPDX-License-Identifier: Apache-2.0
"""Random samples of numbers, points, orientations and poses.

Conventions are those of :mod:`stripe_newton.math`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from .pose_matrices import make_pose
from .rotations import Bound, matrix_from_quat, normalize, quat_from_euler_xyz

__all__ = [
    "default_orientation",
    "generate_random_rotation",
    "generate_random_transformation_matrix",
    "generate_random_translation",
    "random_orientation",
    "random_yaw_orientation",
    "sample_cylinder",
    "sample_gaussian",
    "sample_log_uniform",
    "sample_triangle",
    "sample_uniform",
]


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


def sample_triangle(
    lower: Bound,
    upper: Bound,
    size: int | Sequence[int],
    device: str | torch.device,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Samples between ``lower`` and ``upper``, of shape ``size``, densest at the two bounds and zero half-way.

    The density grows linearly with the distance from the middle. This is Isaac Lab's ``sample_triangle``.
    """
    uniform = 2.0 * _rand(size, device, generator) - 1.0
    root = torch.sign(uniform) * uniform.abs().sqrt()
    return (upper - lower) * (0.5 * (root + 1.0)) + lower


def sample_cylinder(
    radius: float,
    h_range: tuple[float, float],
    size: int | Sequence[int],
    device: str | torch.device,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Points ``(*size, 3)`` [m], uniform on the side of an upright cylinder about the origin.

    Args:
        radius: Radius of the cylinder [m].
        h_range: Lowest and highest z [m].
        size: Leading dimensions of the result.
        device: Device of the result.
        generator: Source of random numbers; None means torch's own.
    """
    angle = (2.0 * _rand(size, device, generator) - 1.0) * math.pi
    height = torch.empty_like(angle).uniform_(h_range[0], h_range[1], generator=generator)
    return torch.stack((radius * torch.cos(angle), radius * torch.sin(angle), height), dim=-1)


def default_orientation(num: int, device: str | torch.device) -> torch.Tensor:
    """Identity quaternions ``(num, 4)``."""
    return torch.tensor([0.0, 0.0, 0.0, 1.0], device=device).repeat(num, 1)


def generate_random_rotation(rot_boundary: float = 2.0 * math.pi) -> torch.Tensor:
    """One rotation matrix ``(3, 3)``: turns about x, then y, then z by angles uniform in [0, ``rot_boundary``) [rad].

    It is not uniform over all rotations; :func:`random_orientation` is.
    """
    roll, pitch, yaw = (torch.rand(3) * rot_boundary).unbind()
    return matrix_from_quat(quat_from_euler_xyz(roll, pitch, yaw))


def generate_random_translation(pos_boundary: float = 1.0) -> torch.Tensor:
    """One translation ``(3,)`` [m], each component uniform in [-``pos_boundary``, ``pos_boundary``)."""
    return torch.rand(3) * 2.0 * pos_boundary - pos_boundary


def generate_random_transformation_matrix(
    pos_boundary: float = 1.0, rot_boundary: float = 2.0 * math.pi
) -> torch.Tensor:
    """One pose matrix ``(4, 4)`` of :func:`generate_random_rotation` and :func:`generate_random_translation`."""
    rotation = generate_random_rotation(rot_boundary)
    return make_pose(generate_random_translation(pos_boundary), rotation)


def _shape(size: int | Sequence[int]) -> tuple[int, ...]:
    return (size,) if isinstance(size, int) else tuple(size)


def _rand(size: int | Sequence[int], device: str | torch.device, generator: torch.Generator | None) -> torch.Tensor:
    return torch.rand(_shape(size), device=device, generator=generator)
