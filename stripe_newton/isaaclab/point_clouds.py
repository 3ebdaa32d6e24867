# SPDX-License-Identifier: Apache-2.0
"""Point clouds of depth images, by the functions of ``isaaclab.sensors.camera.utils``; quaternions (w, x, y, z)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import torch
import warp as wp

from . import math as math_utils

__all__ = ["create_pointcloud_from_depth", "create_pointcloud_from_rgbd", "transform_points"]

Array: TypeAlias = np.ndarray | torch.Tensor | wp.array
Vector: TypeAlias = Sequence[float] | np.ndarray | torch.Tensor | None


def _tensor(value: Array | Sequence[float], device: torch.device | str | None) -> torch.Tensor:
    found = wp.to_torch(value) if isinstance(value, wp.array) else torch.as_tensor(value)
    return found.to(device=device, dtype=torch.float32)


def _like(points: torch.Tensor, given: Array) -> np.ndarray | torch.Tensor:
    return points.cpu().numpy() if isinstance(given, np.ndarray) else points


def transform_points(
    points: Array, position: Vector = None, orientation: Vector = None, device: torch.device | str | None = None
) -> np.ndarray | torch.Tensor:
    """Points of a frame in the frame above it.

    Args:
        points: Shape ``(n, 3)`` or ``(batch, n, 3)`` [m].
        position: Position of the frame [m].
        orientation: Its quaternion (w, x, y, z).
        device: Torch device; by default that of the points.

    Returns:
        The points, in NumPy where they are given so.
    """
    own = _tensor(points, device)
    pos, quat = (None if v is None else _tensor(v, own.device) for v in (position, orientation))
    return _like(math_utils.transform_points(own, pos, quat), points)


def create_pointcloud_from_depth(
    intrinsic_matrix: Array,
    depth: Array,
    keep_invalid: bool = False,
    position: Vector = None,
    orientation: Vector = None,
    device: torch.device | str | None = None,
) -> np.ndarray | torch.Tensor:
    """Points of a depth image.

    Args:
        intrinsic_matrix: Camera matrix, shape ``(3, 3)``.
        depth: Depths along the optical axis [m], shape ``(height, width)`` or ``(height, width, 1)``.
        keep_invalid: Keep points of pixels whose depth is not finite.
        position: Position of the camera [m].
        orientation: Its quaternion (w, x, y, z), in the convention "ros".
        device: Torch device; by default that of the image.

    Returns:
        Shape ``(n, 3)``, in NumPy where the image is given so.
    """
    image = _tensor(depth, device)
    points = math_utils.unproject_depth(image, _tensor(intrinsic_matrix, image.device))
    pos, quat = (None if v is None else _tensor(v, image.device) for v in (position, orientation))
    points = math_utils.transform_points(points, pos, quat)
    return _like(points if keep_invalid else points[_is_valid(points)], depth)


def create_pointcloud_from_rgbd(
    intrinsic_matrix: Array,
    depth: Array,
    rgb: Array | tuple[float, float, float] | None = None,
    normalize_rgb: bool = False,
    position: Vector = None,
    orientation: Vector = None,
    device: torch.device | str | None = None,
    num_channels: int = 3,
) -> tuple[np.ndarray | torch.Tensor, np.ndarray | torch.Tensor]:
    """Points of a depth image with a colour each; pixels whose depth is not finite are left out.

    Args:
        intrinsic_matrix: Camera matrix, shape ``(3, 3)``.
        depth: Depths along the optical axis [m], shape ``(height, width)`` or ``(height, width, 1)``.
        rgb: Image of shape ``(height, width, 3)``, or one colour; by default white.
        normalize_rgb: Divide colours by 255.
        position: Position of the camera [m].
        orientation: Its quaternion (w, x, y, z), in the convention "ros".
        device: Torch device; by default that of the image.
        num_channels: Channels of the colours; the fourth is opaque.

    Returns:
        Points of shape ``(n, 3)`` and colours of shape ``(n, num_channels)``, in NumPy where the image is given so.

    Raises:
        ValueError: colours have neither 3 nor 4 channels.
    """
    if num_channels not in (3, 4):
        raise ValueError(f"num_channels: is {num_channels}, must be 3 or 4")
    image = _tensor(depth, device)
    height, width = image.shape[:2]
    points = _tensor(create_pointcloud_from_depth(intrinsic_matrix, image, True, position, orientation), image.device)
    colors = _tensor((255.0, 255.0, 255.0) if rgb is None else rgb, image.device)
    colors = colors.expand(height, width, 3)[..., :3]
    # unproject_depth goes through an image column by column.
    colors = colors.transpose(0, 1).reshape(-1, 3)
    if normalize_rgb:
        colors = colors / 255.0
    if num_channels == 4:
        opaque = 1.0 if normalize_rgb else 255.0
        colors = torch.nn.functional.pad(colors, (0, 1), value=opaque)
    valid = _is_valid(points)
    return _like(points[valid], depth), _like(colors[valid], depth)


def _is_valid(points: torch.Tensor) -> torch.Tensor:
    return points.isfinite().all(dim=-1)
