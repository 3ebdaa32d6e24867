# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's sensors."""

from .entries import Table, dialect, same

_PATTERNS = same(
    "stripe_newton.sensors", "BpearlPatternCfg GridPatternCfg LidarPatternCfg PatternBaseCfg PinholeCameraPatternCfg"
)

NAMES: dict[str, Table] = {
    "isaaclab.sensors": dialect(
        "sensors",
        """Camera CameraCfg TiledCamera TiledCameraCfg ContactSensor ContactSensorCfg FrameTransformer
        FrameTransformerCfg Imu ImuCfg OffsetCfg RayCaster RayCasterCfg save_images_to_file""",
    )
    | dialect(
        "ray_cameras",
        """MultiMeshRayCaster MultiMeshRayCasterCamera MultiMeshRayCasterCameraCfg MultiMeshRayCasterCfg RayCasterCamera
        RayCasterCameraCfg""",
    )
    | dialect(
        "wxyz_data",
        """CameraData=WxyzData ContactSensorData=WxyzData FrameTransformerData=WxyzData ImuData=WxyzData
        RayCasterData=WxyzData MultiMeshRayCasterCameraData=WxyzData MultiMeshRayCasterData=WxyzData""",
    )
    | same("stripe_newton.sensors", "SensorBase SensorBaseCfg"),
    "isaaclab.sensors.camera.utils": dialect(
        "point_clouds", "create_pointcloud_from_depth create_pointcloud_from_rgbd transform_points"
    )
    | dialect("sensors", "save_images_to_file"),
    **dict.fromkeys(("isaaclab.sensors.patterns", "isaaclab.sensors.ray_caster.patterns"), _PATTERNS),
}

ALIASES: dict[str, str] = {}
