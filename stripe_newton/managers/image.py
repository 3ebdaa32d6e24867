# SPDX-License-Identifier: Apache-2.0
"""Image term: the picture of a camera as an observation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
import warp as wp

from stripe_kernels.sensors import image as kernels
from stripe_newton.fusion import SceneEntityCfg
from stripe_newton.scene import InteractiveScene
from stripe_newton.sensors import Camera

from .context import ManagerContext

__all__ = ["Picture", "find_picture", "image", "image_writer"]

_DEPTHS = ("depth", "distance_to_image_plane", "distance_to_camera")
"""Data types that are depths."""
_THREADS = 256
"""Threads that normalise a picture on a GPU."""


class HasScene(Protocol):
    """An environment with a scene."""

    scene: InteractiveScene


def image(
    env: HasScene,
    sensor_cfg: SceneEntityCfg | str,
    data_type: str = "rgb",
    normalize: bool = True,
    channels_first: bool = False,
    max_depth: float | None = None,
) -> torch.Tensor:
    """The picture of a camera, float32, shape ``(num_envs, height, width, channels)``.

    An observation manager recognises this term and writes the same numbers by kernels that are part of the step's
    graph. The term must be the only one of its group, unless the terms of the group are not concatenated.

    Formula: ``rgb``: ``c / 255`` less its mean over the picture; depths: 0 instead of infinity [m]; ``normals``:
    ``(n + 1) / 2``; segmentations: their numbers. Without ``normalize`` all are unchanged. With ``max_depth``
    depths are at most that, missing ones too, and with ``normalize`` they are divided by it.

    Source: Isaac Lab, ``mdp.image``.

    Args:
        env: The environment.
        sensor_cfg: The camera, by a :class:`SceneEntityCfg` or by name.
        data_type: One of the camera's ``data_types``, except ``rgba``.
        normalize: Apply the formula above.
        channels_first: Shape ``(num_envs, channels, height, width)``, as convolutional networks of rsl_rl take them.
        max_depth: Largest depth [m], for depths alone.
    """
    name = sensor_cfg.name if isinstance(sensor_cfg, SceneEntityCfg) else sensor_cfg
    camera = env.scene.sensors[name]
    if not isinstance(camera, Camera):
        raise TypeError(f"sensor_cfg names '{name}', a {type(camera).__name__}, must name a camera")
    camera.image(data_type)
    values: torch.Tensor = camera.data.output[data_type].float()
    if normalize and data_type == "rgb":
        values = (values - values.mean(dim=(1, 2), keepdim=True)) / 255.0
    elif max_depth is not None:
        farthest = _checked_max_depth(max_depth, data_type)
        values = values.clamp(max=farthest) / (farthest if normalize else 1.0)
    elif normalize and data_type in _DEPTHS:
        values = values.masked_fill(torch.isinf(values), 0.0)
    elif normalize and data_type == "normals":
        values = 0.5 * (values + 1.0)
    return values.permute(0, 3, 1, 2).contiguous() if channels_first else values


def _checked_max_depth(max_depth: object, data_type: str) -> float:
    """The largest depth [m]. Raises ValueError unless it is positive, and ``data_type`` a depth."""
    if data_type not in _DEPTHS:
        raise ValueError(f"is {max_depth!r}, but '{data_type}' is no depth; leave it out")
    if not isinstance(max_depth, (int, float)) or not 0.0 < max_depth < math.inf:
        raise ValueError(f"is {max_depth!r}, must be a finite depth above 0 [m]")
    return float(max_depth)


@dataclass(frozen=True)
class Picture:
    """Picture of a camera that an image term observes.

    Attributes:
        array: The camera's array.
        normalize: Normalise its numbers, see :func:`image`.
        channels_first: Whether channels come before rows and columns.
        max_depth: Largest depth [m]; 0 for none.
    """

    array: wp.array
    normalize: bool
    channels_first: bool = False
    max_depth: float = 0.0

    @property
    def channels(self) -> int:
        """Numbers of a pixel."""
        array = self.array
        return array.shape[3] if array.ndim == 4 else 3 if array.dtype is wp.vec3 else 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Height, width and channels, or channels, height and width."""
        height, width = self.array.shape[1:3]
        return (self.channels, height, width) if self.channels_first else (height, width, self.channels)

    def layout(self, first: int) -> kernels.ImageLayout:
        """Order of its numbers, the first of which is in column ``first``."""
        layout, pixels = kernels.ImageLayout(), self.array.shape[1] * self.array.shape[2]
        layout.first = first
        layout.pixel, layout.channel = (1, pixels) if self.channels_first else (self.channels, 1)
        return layout


def find_picture(context: ManagerContext, params: Mapping[str, object], where: str) -> Picture | None:
    """The picture that the parameters of an image term name; None if problems have been added to ``context``."""
    given = dict(params)
    cfg, data_type = given.pop("sensor_cfg", None), str(given.pop("data_type", "rgb"))
    normalize, channels_first = bool(given.pop("normalize", True)), bool(given.pop("channels_first", False))
    max_depth = given.pop("max_depth", None)
    arguments = "sensor_cfg, data_type, normalize, channels_first, max_depth"
    context.problems += [
        f"{where}.params.{extra}: 'image' has no such argument; it takes {arguments}" for extra in given
    ]
    cameras = {name: s for name, s in context.scene.sensors.items() if isinstance(s, Camera)}
    name = cfg.name if isinstance(cfg, SceneEntityCfg) else cfg
    if name is None and len(cameras) == 1:
        name = next(iter(cameras))
    if name not in cameras:
        asked = "is missing" if name is None else f"is '{name}'"
        there = ", ".join(cameras) or "the scene has none"
        context.problems.append(f"{where}.params.sensor_cfg: {asked}, must name a camera: {there}")
        return None
    try:
        array = cameras[str(name)].image(data_type)
    except KeyError as error:
        context.problems.append(f"{where}.params.data_type: {error.args[0]}")
        return None
    if max_depth is None:
        return Picture(array, normalize, channels_first)
    try:
        farthest = _checked_max_depth(max_depth, data_type)
    except ValueError as error:
        context.problems.append(f"{where}.params.max_depth: {error}")
        return None
    return Picture(array, normalize, channels_first, farthest)


def image_writer(picture: Picture, target: wp.array, first: int) -> Callable[[], None]:
    """Function that launches the kernels which write a picture into ``target``, beginning at column ``first``."""
    source, normalize, layout = picture.array, picture.normalize, picture.layout(first)
    dim, device = source.shape[:3], source.device
    if source.ndim == 4 and normalize:

        def write_centred() -> None:
            inputs, outputs = [source, layout], [target]
            wp.launch_tiled(
                kernels.write_centred_colors, dim=[dim[0]], inputs=inputs, outputs=outputs, block_dim=_THREADS,
                device=device,
            )  # fmt: skip

        return write_centred
    if source.ndim == 4:
        inputs = [source, layout]
        return lambda: wp.launch(kernels.write_colors, dim=dim, inputs=inputs, outputs=[target], device=device)
    if source.dtype is wp.float32:
        inputs = [source, normalize, picture.max_depth, layout]
        return lambda: wp.launch(kernels.write_depth, dim=dim, inputs=inputs, outputs=[target], device=device)
    kernel = {wp.vec3: kernels.write_normals, wp.int32: kernels.write_labels}[source.dtype]
    inputs = [source, normalize, layout]
    return lambda: wp.launch(kernel, dim=dim, inputs=inputs, outputs=[target], device=device)
