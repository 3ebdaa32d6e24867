# SPDX-License-Identifier: Apache-2.0
"""Camera data: images and poses as tensors, and the conventions of camera frames."""

from __future__ import annotations

import torch

from .sensor_data import SensorData

__all__ = ["FROM_WORLD", "CameraData"]

FROM_WORLD = {"world": (0.0, 0.0, 0.0, 1.0), "opengl": (0.5, -0.5, -0.5, 0.5), "ros": (0.5, -0.5, 0.5, -0.5)}
"""Rotations from the frame with x forward and z up to each convention's, xyzw."""


class CameraData(SensorData):
    """Images and pose of a camera: torch views of the memory that is rendered into.

    Attributes:
        pos_w: Position [m], shape ``(num_envs, 3)``.
        quat_w_world: Orientation, quaternion (x, y, z, w), of a frame with x forward and z up, ``(num_envs, 4)``.
        mount: Pose in the frame of the body or the environment, x forward and z up, (x, y, z, qx, qy, qz, qw) [m],
            shape ``(num_envs, 7)``; ``default_mount`` is the config's.
        intrinsic_matrices: ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` [px], shape ``(num_envs, 3, 3)``.
        image_shape: ``(height, width)``.
        output: By data type, shape ``(num_envs, height, width, channels)``: ``rgb`` and ``rgba`` uint8; ``depth`` or
            ``distance_to_image_plane`` and ``distance_to_camera`` [m]; ``normals`` in the world; segmentations int32.
        info: By data type; for a segmentation ``{"idToLabels": {number: name}}``.
    """

    pos_w: torch.Tensor
    quat_w_world: torch.Tensor
    mount: torch.Tensor
    default_mount: torch.Tensor
    intrinsic_matrices: torch.Tensor
    image_shape: tuple[int, int]
    output: dict[str, torch.Tensor]
    info: dict[str, dict[str, dict[int, str]]]

    @property
    def quat_w_ros(self) -> torch.Tensor:
        """Orientation of the frame that looks along z with y down, ``(num_envs, 4)``; a copy."""
        return self._turned("ros")

    @property
    def quat_w_opengl(self) -> torch.Tensor:
        """Orientation of the frame that looks along -z with y up, ``(num_envs, 4)``; a copy."""
        return self._turned("opengl")

    def _turned(self, convention: str) -> torch.Tensor:
        from scipy.spatial.transform import Rotation  # here, as it takes long to import

        turned = Rotation.from_quat(self.quat_w_world.double().cpu().numpy()) * Rotation.from_quat(
            FROM_WORLD[convention]
        )
        return torch.as_tensor(turned.as_quat(), dtype=torch.float32).to(self.quat_w_world.device)
