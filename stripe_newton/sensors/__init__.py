# SPDX-License-Identifier: Apache-2.0
"""Sensors: what the robots of a scene measure."""

from .camera import Camera
from .camera_cfg import CameraCfg, PinholeCameraCfg, TiledCameraCfg
from .camera_data import CameraData
from .contact_sensor import ContactSensor
from .contact_sensor_cfg import ContactSensorCfg
from .frame_transformer import FrameTransformer
from .frame_transformer_cfg import FrameCfg, FrameTransformerCfg
from .imu import Imu
from .imu_cfg import ImuCfg
from .patterns import BpearlPatternCfg, GridPatternCfg, LidarPatternCfg, PatternBaseCfg, PinholeCameraPatternCfg
from .prims import OffsetCfg
from .ray_caster import RayCaster, RayCasterData
from .ray_caster_cfg import RayCasterCfg
from .sensor_base import SensorBase, SensorBaseCfg

__all__ = [
    "BpearlPatternCfg",
    "Camera",
    "CameraCfg",
    "CameraData",
    "ContactSensor",
    "ContactSensorCfg",
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
    "TiledCameraCfg",
]
