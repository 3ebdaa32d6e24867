# SPDX-License-Identifier: Apache-2.0
"""Camera pictures: what the cameras of the chosen environment see, on the page and as frustums in the scene."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from stripe_newton.viewers.poses import compose, wxyz

from .inbox import Inbox
from .view_frame import WORLD
from .viewed_env import ViewedEnv

if TYPE_CHECKING:
    import viser

__all__ = ["CameraPictures", "as_picture"]

_EVERY = 0.1
"""Time between two pictures on the page [s]."""
_LEAST_WIDTH = 160
"""Width to which smaller pictures are enlarged by whole factors [px]."""
_TO_ROS = np.array([[0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5]])
"""Pose of viser's frame of a camera, z forward and y down, in that with x forward and z up."""


class CameraPictures:
    """A picture for each output of each camera.

    Args:
        server: The web server.
        gui: Where they go.
        inbox: Carries changes to the simulation's thread.
        env: The environment.
    """

    def __init__(self, server: viser.ViserServer, gui: viser.GuiApi, inbox: Inbox, env: ViewedEnv):
        self._server = server
        sensors = getattr(getattr(env, "scene", None), "sensors", {})
        self._cameras: dict[str, Any] = {
            name: sensor.data
            for name, sensor in sensors.items()
            if isinstance(getattr(sensor.data, "output", None), dict)
        }
        self.images: dict[tuple[str, str], viser.GuiImageHandle] = {}
        """Pictures by camera and output."""
        self._frustums: dict[str, viser.CameraFrustumHandle] = {}
        self._next = 0.0
        with gui.add_folder("Cameras", visible=bool(self._cameras)):
            self.is_on = gui.add_checkbox("Pictures", initial_value=True)
            for name, data in self._cameras.items():
                for kind, values in data.output.items():
                    label = f"{name}: {kind}"
                    self.images[name, kind] = gui.add_image(as_picture(kind, values[0]), label=label)
        inbox.on_change(self.is_on, self._show)

    @property
    def is_empty(self) -> bool:
        """Whether there are no cameras."""
        return not self._cameras

    def update(self, env_id: int) -> None:
        """Show the pictures of an environment."""
        now = time.monotonic()
        if not self._cameras or not self.is_on.value or now < self._next:
            return
        self._next = now + _EVERY
        for (name, kind), handle in self.images.items():
            handle.image = as_picture(kind, self._cameras[name].output[kind][env_id])
        for name, data in self._cameras.items():
            self._place(name, data, env_id)

    def _place(self, name: str, data: Any, env_id: int) -> None:
        """Move the frustum of a camera."""
        position = data.pos_w[env_id].cpu().numpy().astype(float)
        turn = data.quat_w_world[env_id : env_id + 1].cpu().numpy().astype(float)
        if not (np.isfinite(position).all() and np.isfinite(turn).all()):
            return
        quaternion = wxyz(compose(np.concatenate([np.zeros((1, 3)), turn], axis=1), _TO_ROS)[:, 3:])[0]
        if name not in self._frustums:
            height, width = data.image_shape
            focal = float(data.intrinsic_matrices[env_id, 1, 1])
            self._frustums[name] = self._server.scene.add_camera_frustum(
                f"{WORLD}/camera_{name}", 2.0 * math.atan(0.5 * height / focal), width / height, scale=0.12,
                color=(245, 165, 35), cast_shadow=False,
            )  # fmt: skip
        handle = self._frustums[name]
        handle.position, handle.wxyz, handle.visible = position, quaternion, True

    def _show(self, is_on: bool) -> None:
        for image in self.images.values():
            image.visible = is_on
        for frustum in self._frustums.values():
            frustum.visible = is_on


def as_picture(kind: str, values: torch.Tensor) -> np.ndarray:
    """An output of a camera as a picture, uint8 ``(height, width, 3)``.

    Args:
        kind: Its data type: colours, distances from near (light) to far (dark), normals, or labels.
        values: One environment's, shape ``(height, width, channels)``.
    """
    array = values.detach().cpu().numpy()
    if kind.startswith(("depth", "distance")):
        distance = array[..., 0].astype(float)
        near = np.where(np.isfinite(distance), distance, np.nan)
        least, most = (np.nanmin(near), np.nanmax(near)) if np.isfinite(near).any() else (0.0, 1.0)
        share = (most - near) / max(most - least, 1e-6)
        picture = np.repeat(np.nan_to_num(0.1 + 0.9 * share)[..., None], 3, axis=2)
    elif kind.startswith("normals"):
        picture = 0.5 + 0.5 * np.nan_to_num(array[..., :3].astype(float))
    elif "segmentation" in kind and array.shape[-1] == 1:
        label = array[..., 0].astype(np.int64)
        picture = np.stack([(label * k % 251 + 4) / 255.0 for k in (97, 57, 173)], axis=-1) * (label > 0)[..., None]
    elif array.dtype == np.uint8:
        picture = array[..., :3] / 255.0
    else:
        picture = array[..., :3].astype(float)
    if picture.shape[-1] != 3:
        picture = np.repeat(picture[..., :1], 3, axis=2)
    factor = max(1, math.ceil(_LEAST_WIDTH / picture.shape[1]))
    enlarged = picture.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.round(255.0 * np.clip(enlarged, 0.0, 1.0)).astype(np.uint8)
