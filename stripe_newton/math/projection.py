# SPDX-License-Identifier: Apache-2.0
"""Projection: points and depth images of pinhole cameras, and the axes of cameras.

Pixels count from the centre of the upper left one, ``u`` to the right and ``v`` down.
"""

from __future__ import annotations

import torch

from .rotations import normalize, quat_conjugate, quat_mul

__all__ = [
    "convert_camera_frame_orientation_convention",
    "create_rotation_matrix_from_view",
    "orthogonalize_perspective_depth",
    "project_points",
    "unproject_depth",
]


def orthogonalize_perspective_depth(depth: torch.Tensor, intrinsics: torch.Tensor) -> torch.Tensor:
    """Depth from the image plane, of depth from the optical centre [m]: ``z = d / sqrt(1 + x^2 + y^2)``.

    Args:
        depth: Images ``(H, W)``, ``(H, W, 1)``, ``(N, H, W)`` or ``(N, H, W, 1)``; an image of width 1 needs the
            fourth form.
        intrinsics: Camera matrices ``(3, 3)`` or ``(N, 3, 3)`` [pixels].

    Returns:
        Images of the same shape.

    Raises:
        ValueError: if a shape is none of these.
    """
    images = _images(depth)
    matrices = _matrices(intrinsics)
    u = torch.arange(images.shape[2], dtype=depth.dtype, device=depth.device).reshape(1, 1, -1)
    v = torch.arange(images.shape[1], dtype=depth.dtype, device=depth.device).reshape(1, -1, 1)
    x = (u - matrices[:, 0, 2].reshape(-1, 1, 1)) / matrices[:, 0, 0].reshape(-1, 1, 1)
    y = (v - matrices[:, 1, 2].reshape(-1, 1, 1)) / matrices[:, 1, 1].reshape(-1, 1, 1)
    return (images / torch.sqrt(1.0 + x.square() + y.square())).reshape(depth.shape)


def unproject_depth(depth: torch.Tensor, intrinsics: torch.Tensor, is_ortho: bool = True) -> torch.Tensor:
    """Points that a depth image shows, in the camera's frame (x right, y down, z forward) [m].

    Args:
        depth: Images as in :func:`orthogonalize_perspective_depth` [m].
        intrinsics: Camera matrices ``(3, 3)`` or ``(N, 3, 3)`` [pixels].
        is_ortho: Whether depth is measured from the image plane, not from the optical centre.

    Returns:
        Points ``(P, 3)``, or ``(N, P, 3)`` for batches of images: column by column of the image.

    Raises:
        ValueError: if a shape is none of these.
    """
    if not is_ortho:
        depth = orthogonalize_perspective_depth(depth, intrinsics)
    is_batched = depth.dim() == 4 or (depth.dim() == 3 and depth.shape[-1] != 1)
    images = _images(depth)
    u = torch.arange(images.shape[2], dtype=depth.dtype, device=depth.device)
    v = torch.arange(images.shape[1], dtype=depth.dtype, device=depth.device)
    grid_u, grid_v = torch.meshgrid(u, v, indexing="ij")
    pixels = torch.stack((grid_u.reshape(-1), grid_v.reshape(-1), torch.ones_like(grid_u).reshape(-1)))
    rays = (torch.inverse(_matrices(intrinsics)) @ pixels).transpose(1, 2)
    points = rays / rays[..., 2:] * images.transpose(1, 2).reshape(images.shape[0], -1, 1)
    if not is_batched and points.shape[0] == 1:
        return points.squeeze(0)
    return points


def project_points(points: torch.Tensor, intrinsics: torch.Tensor) -> torch.Tensor:
    """Pixels at which a camera sees points: ``(u, v)`` [pixels] and their depth [m].

    Args:
        points: Points in the camera's frame (x right, y down, z forward), ``(P, 3)`` or ``(N, P, 3)`` [m].
        intrinsics: Camera matrices ``(3, 3)`` or ``(N, 3, 3)`` [pixels].

    Returns:
        ``(u, v, depth)`` of the shape of the points; ``(N, P, 3)`` for ``(P, 3)`` points and N matrices.

    Raises:
        ValueError: if a shape is none of these.

    Example:
        >>> intrinsics = torch.tensor([[100.0, 0.0, 32.0], [0.0, 100.0, 24.0], [0.0, 0.0, 1.0]])
        >>> project_points(torch.tensor([[0.0, 0.0, 2.0], [0.5, -0.2, 2.0]]), intrinsics)
        tensor([[32., 24.,  2.],
                [57., 14.,  2.]])
    """
    if points.dim() not in (2, 3):
        raise ValueError(f"project_points: expected points (P, 3) or (N, P, 3), got {list(points.shape)}")
    batch = points if points.dim() == 3 else points.unsqueeze(0)
    seen = batch @ _matrices(intrinsics).transpose(1, 2)
    depth = batch[..., 2:].expand(seen[..., 2:].shape)
    out = torch.cat((seen[..., :2] / seen[..., 2:], depth), dim=-1)
    if points.dim() == 2 and out.shape[0] == 1:
        return out.squeeze(0)
    return out


def create_rotation_matrix_from_view(
    eyes: torch.Tensor, targets: torch.Tensor, up_axis: str = "Z", device: str | torch.device = "cpu"
) -> torch.Tensor:
    """Orientation of cameras that look at targets, as rotation matrices ``(N, 3, 3)`` from camera to world.

    The camera's frame is OpenGL's: x right, y up, looking along -z.

    Args:
        eyes: Positions of the cameras in the world, ``(N, 3)`` [m].
        targets: Positions looked at, ``(N, 3)`` [m].
        up_axis: Axis of the world that points up in the images, ``"Y"`` or ``"Z"``. A camera that looks along it has
            no way up: its matrix is not a rotation, as in Isaac Lab.
        device: Device of the arguments.

    Raises:
        ValueError: if ``up_axis`` is neither.
    """
    if up_axis not in ("Y", "Z"):
        raise ValueError(f"create_rotation_matrix_from_view: up_axis {up_axis!r} is neither 'Y' nor 'Z'")
    up = torch.zeros((eyes.shape[0], 3), device=device)
    up[:, "XYZ".index(up_axis)] = 1.0
    z = -normalize(targets - eyes, 1e-5)
    x = normalize(torch.linalg.cross(up, z), 1e-5)
    y = normalize(torch.linalg.cross(z, x), 1e-5)
    lost = torch.isclose(x, torch.zeros_like(x), atol=5e-3).all(dim=1, keepdim=True)
    x = torch.where(lost, normalize(torch.linalg.cross(y, z), 1e-5), x)
    return torch.stack((x, y, z), dim=-1)


def convert_camera_frame_orientation_convention(
    orientation: torch.Tensor, origin: str = "opengl", target: str = "ros"
) -> torch.Tensor:
    """Orientations ``(..., 4)`` of cameras in another convention of the camera's axes.

    ``"opengl"`` (also USD): x right, y up, looking along -z. ``"ros"``: x right, y down, looking along z. ``"world"``:
    looking along x, y left, z up.

    Raises:
        ValueError: if a convention is none of these.
    """
    for name in (origin, target):
        if name not in _CAMERA_AXES:
            raise ValueError(f"camera convention {name!r} is none of {', '.join(_CAMERA_AXES)}")
    if origin == target:
        return orientation.clone()
    turns = [
        torch.tensor(_CAMERA_AXES[name], dtype=orientation.dtype, device=orientation.device)
        for name in (origin, target)
    ]
    turn = quat_mul(quat_conjugate(turns[0]), turns[1])
    return quat_mul(orientation, turn.expand(orientation.shape))


_CAMERA_AXES = {"opengl": (0.0, 0.0, 0.0, 1.0), "ros": (1.0, 0.0, 0.0, 0.0), "world": (-0.5, 0.5, 0.5, 0.5)}
"""Orientation of each convention's axes in those of OpenGL."""


def _images(depth: torch.Tensor) -> torch.Tensor:
    """Images as ``(N, H, W)``."""
    if depth.dim() not in (2, 3, 4) or (depth.dim() == 4 and depth.shape[-1] != 1):
        raise ValueError(f"expected depth (H, W), (H, W, 1), (N, H, W) or (N, H, W, 1), got {list(depth.shape)}")
    if depth.dim() > 2 and depth.shape[-1] == 1:
        depth = depth.squeeze(-1)
    return depth if depth.dim() == 3 else depth.unsqueeze(0)


def _matrices(intrinsics: torch.Tensor) -> torch.Tensor:
    """Camera matrices as ``(N, 3, 3)``."""
    if intrinsics.dim() not in (2, 3):
        raise ValueError(f"expected camera matrices (3, 3) or (N, 3, 3), got {list(intrinsics.shape)}")
    return intrinsics if intrinsics.dim() == 3 else intrinsics.unsqueeze(0)
