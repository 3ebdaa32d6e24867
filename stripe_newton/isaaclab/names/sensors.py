# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's sensors."""

from .entries import Table, same

NAMES: dict[str, Table] = {
    "isaaclab.sensors": same(
        "stripe_newton.sensors",
        """Camera CameraCfg TiledCamera=Camera TiledCameraCfg ContactSensor ContactSensorCfg FrameTransformer
        FrameTransformerCfg Imu ImuCfg OffsetCfg RayCaster RayCasterCfg RayCasterData SensorBase SensorBaseCfg""",
    ),
    "isaaclab.sensors.patterns": same(
        "stripe_newton.sensors",
        "BpearlPatternCfg GridPatternCfg LidarPatternCfg PatternBaseCfg PinholeCameraPatternCfg",
    ),
}

ALIASES: dict[str, str] = {}
