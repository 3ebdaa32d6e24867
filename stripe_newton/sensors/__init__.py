# SPDX-License-Identifier: Apache-2.0
"""Sensors: contacts, inertial measurements, frames, rays and cameras."""

from .camera import Camera, CameraCfg, PinholeCameraCfg, TiledCamera, TiledCameraCfg
from .camera_data import CameraData
from .contact_sensor import ContactSensor, ContactSensorCfg
from .depth_noise import DepthNoiseCfg
from .frame_transformer import FrameCfg, FrameTransformer, FrameTransformerCfg
from .imu import Imu, ImuCfg
from .patterns import BpearlPatternCfg, GridPatternCfg, LidarPatternCfg, PatternBaseCfg, PinholeCameraPatternCfg
from .prim_paths import OffsetCfg
from .ray_caster import RayCaster, RayCasterCfg, RayCasterData
from .sensor_base import SensorBase, SensorBaseCfg, SensorCfg

__all__ = [
    "BpearlPatternCfg",
    "Camera",
    "CameraCfg",
    "CameraData",
    "ContactSensor",
    "ContactSensorCfg",
    "DepthNoiseCfg",
    "FrameCfg",
    "FrameTransformer",
    "FrameTransformerCfg",
    "GridPatternCfg",
    "Imu",
    "ImuCfg",
    "LidarPatternCfg",
    "OffsetCfg",
    "PatternBaseCfg",
    "PinholeCameraCfg",
    "PinholeCameraPatternCfg",
    "RayCaster",
    "RayCasterCfg",
    "RayCasterData",
    "SensorBase",
    "SensorBaseCfg",
    "SensorCfg",
    "TiledCamera",
    "TiledCameraCfg",
]
