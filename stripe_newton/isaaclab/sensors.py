# SPDX-License-Identifier: Apache-2.0
"""Sensors of the Isaac Lab dialect: quaternions (w, x, y, z) in offsets and in data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

import torch

from stripe_newton import sensors as native
from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.viewers import save_images

from .camera_data import ColorizedCameraData
from .wxyz_config import WxyzRot
from .wxyz_data import WxyzData

__all__ = [
    "Camera",
    "CameraCfg",
    "ContactSensor",
    "ContactSensorCfg",
    "FrameTransformer",
    "FrameTransformerCfg",
    "Imu",
    "ImuCfg",
    "OffsetCfg",
    "PinholeCameraCfg",
    "RayCaster",
    "RayCasterCfg",
    "TiledCamera",
    "TiledCameraCfg",
    "save_images_to_file",
]

_NO_MARKERS = {"visualizer_cfg": "sensors draw no markers"}
Quaternion = tuple[float, float, float, float]


class _WxyzSensor(native.SensorBase):
    """The boundary of a sensor: the sensor sets its ``data`` once, and hands out a converted form of it."""

    _wxyz: WxyzData | None = None

    def __init__(self, cfg: native.SensorCfg):
        super().__init__(cfg)
        if (adopt := getattr(self._scene, "adopt_sensor", None)) is not None:
            adopt(self)

    def update(self, dt: float, force_recompute: bool = False) -> None:
        """Measure, after ``dt`` seconds of physics; ``force_recompute`` has no effect, data are always computed."""
        super().update(dt)

    @property
    def data(self) -> Any:  # the type below is of the package: it cannot name what is converted
        """Data of the sensor, quaternions (w, x, y, z)."""
        if self._wxyz is None:
            raise AttributeError(f"{type(self).__name__} has no data before the scene is built")
        return self._wxyz

    @data.setter
    def data(self, value: object) -> None:
        self._wxyz = WxyzData(value)


class Camera(_WxyzSensor, native.Camera):
    """:class:`stripe_newton.sensors.Camera` with quaternions (w, x, y, z); segmentations are colours if asked for."""

    def __init__(self, cfg: CameraCfg):
        super().__init__(cfg)
        if self.cfg.spawn is None:
            self.cfg.spawn = self._lens_there()

    def _lens_there(self) -> native.PinholeCameraCfg:
        """Lens of another camera at the same prim."""
        for other in getattr(self._scene, "sensors", {}).values():
            there = isinstance(other, native.Camera) and other.cfg.prim_path == self.cfg.prim_path
            if there and other.cfg.spawn is not None:  # this camera may be in the scene already
                return other.cfg.spawn
        path = self.cfg.prim_path
        problem = f"is None, but no camera before it is at '{path}', and cameras of files are not read"
        raise ConfigError([f"{type(self).__name__} '{path}'.spawn: {problem}; give a PinholeCameraCfg"])

    @property
    def data(self) -> Any:
        """Data of the camera."""
        return super().data

    @data.setter
    def data(self, value: object) -> None:
        kinds = ("semantic_segmentation", "instance_segmentation", "instance_id_segmentation")
        colorized = {kind: getattr(self.cfg, f"colorize_{kind}", False) for kind in kinds}
        self._wxyz = ColorizedCameraData(value, colorized)


class TiledCamera(Camera):
    """A :class:`Camera` by Isaac Lab's other name."""


class ContactSensor(_WxyzSensor, native.ContactSensor):
    """:class:`stripe_newton.sensors.ContactSensor` with quaternions (w, x, y, z)."""


class FrameTransformer(_WxyzSensor, native.FrameTransformer):
    """:class:`stripe_newton.sensors.FrameTransformer` with quaternions (w, x, y, z)."""


class Imu(_WxyzSensor, native.Imu):
    """:class:`stripe_newton.sensors.Imu` with quaternions (w, x, y, z)."""


class RayCaster(_WxyzSensor, native.RayCaster):
    """:class:`stripe_newton.sensors.RayCaster` with quaternions (w, x, y, z)."""


@configclass
class OffsetCfg(WxyzRot, native.OffsetCfg):
    """A frame in that of a body; ``rot`` is (w, x, y, z)."""

    rot: Quaternion = (1.0, 0.0, 0.0, 0.0)


_Offset = OffsetCfg  # below, OffsetCfg is the attribute of the class


@configclass
class ContactSensorCfg(native.ContactSensorCfg):
    """:class:`stripe_newton.sensors.ContactSensorCfg`; its sensor hands out (w, x, y, z)."""

    class_type: Callable[..., native.SensorBase] | None = ContactSensor
    visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _NO_MARKERS


@configclass
class ImuCfg(native.ImuCfg):
    """:class:`stripe_newton.sensors.ImuCfg` with quaternions (w, x, y, z)."""

    OffsetCfg: ClassVar[type] = _Offset

    class_type: Callable[..., native.SensorBase] | None = Imu
    visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _NO_MARKERS
    offset: _Offset = _Offset()


@configclass
class FrameTransformerCfg(native.FrameTransformerCfg):
    """:class:`stripe_newton.sensors.FrameTransformerCfg` with quaternions (w, x, y, z)."""

    @configclass
    class FrameCfg(native.FrameTransformerCfg.FrameCfg):
        """A target frame."""

        offset: _Offset = _Offset()

    OffsetCfg: ClassVar[type] = _Offset

    class_type: Callable[..., native.SensorBase] | None = FrameTransformer
    visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _NO_MARKERS
    target_frames: Sequence[Any] = MISSING
    source_frame_offset: _Offset = _Offset()


@configclass
class RayCasterCfg(native.RayCasterCfg):
    """:class:`stripe_newton.sensors.RayCasterCfg` with quaternions (w, x, y, z)."""

    @configclass
    class OffsetCfg(WxyzRot, native.RayCasterCfg.OffsetCfg):
        """Pose of the sensor in the frame of its body; ``rot`` is (w, x, y, z)."""

        rot: Quaternion = (1.0, 0.0, 0.0, 0.0)

    class_type: Callable[..., native.SensorBase] | None = RayCaster
    visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _NO_MARKERS
    offset: OffsetCfg = OffsetCfg()


@configclass
class PinholeCameraCfg(native.PinholeCameraCfg):
    """:class:`stripe_newton.sensors.PinholeCameraCfg` with Isaac Lab's other fields."""

    clipping_range: tuple[float, float] = (0.01, 1.0e6)
    projection_type: str = "pinhole"
    lock_camera: bool = True
    visible: bool = True
    semantic_tags: list[tuple[str, str]] | None = None
    copy_from_source: bool = True

    IGNORED: ClassVar[dict[str, str]] = {
        "lock_camera": "there is no window in which it could be moved",
        **dict.fromkeys(("visible", "semantic_tags", "copy_from_source"), "a camera is no prim that is drawn"),
    }

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.projection_type != "pinhole":
            yield "projection_type", f"is {self.projection_type!r}, only 'pinhole' is drawn"


@configclass
class CameraCfg(native.CameraCfg):
    """:class:`stripe_newton.sensors.CameraCfg` with quaternions (w, x, y, z)."""

    @configclass
    class OffsetCfg(WxyzRot, native.CameraCfg.OffsetCfg):
        """Pose of the camera in the frame of its body; ``rot`` is (w, x, y, z)."""

        rot: Quaternion = (1.0, 0.0, 0.0, 0.0)

    class_type: Callable[..., native.SensorBase] | None = Camera
    offset: OffsetCfg = OffsetCfg()
    spawn: native.PinholeCameraCfg | None = PinholeCameraCfg()  # type: ignore[assignment]
    """Lens and film; None for those of another camera at the same prim."""
    update_latest_camera_pose: bool = False
    semantic_filter: str | Sequence[str] = "*:*"
    colorize_semantic_segmentation: bool = True
    colorize_instance_id_segmentation: bool = True
    colorize_instance_segmentation: bool = True
    semantic_segmentation_mapping: dict[str, Any] = {}

    IGNORED: ClassVar[dict[str, str]] = {
        "update_latest_camera_pose": "the pose is always that of the image",
        "semantic_filter": "all labels are drawn",
        "semantic_segmentation_mapping": "colours are by number",
    }


@configclass
class TiledCameraCfg(CameraCfg):
    """A :class:`CameraCfg` by Isaac Lab's other name."""

    class_type: Callable[..., native.SensorBase] | None = TiledCamera


def save_images_to_file(images: torch.Tensor, file_path: str) -> None:
    """Write images of shape ``(n, height, width, channels)``, uint8 or floats from 0 to 1, in a square grid."""
    save_images(file_path, images.detach().cpu().numpy())
