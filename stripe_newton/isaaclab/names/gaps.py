# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab that its own files use and that the dialect does not translate.

They load, so that the other classes of a file can be used; a config that uses one is refused by name, a function that
is called raises. An entry for the same name in another table overrides the entry here.
"""

from .entries import Table, inert, refused

_CONTROLLER = "the controller is not translated by the dialect"
_MATH = "the dialect does not translate this function to (w, x, y, z)"
_SENSOR = "the dialect does not translate this part of the sensors"
_TELEOPERATION = "there is no teleoperation"

NAMES: dict[str, Table] = {
    "isaaclab_contrib.actuators": refused("thrusters are not simulated", "Thruster ThrusterCfg"),
    "isaaclab_contrib.assets": refused("thrusters are not simulated", "Multirotor MultirotorCfg MultirotorData"),
    "isaaclab_contrib.mdp": refused("thrusters are not simulated", "ThrustAction ThrustActionCfg"),
    "isaaclab_contrib.sensors.tacsl_sensor": refused(
        "tactile sensors are not simulated", "GelSightRenderCfg VisuoTactileSensor VisuoTactileSensorCfg"
    ),
    "isaaclab_contrib.sensors.tacsl_sensor.visuotactile_sensor_cfg": refused(
        "tactile sensors are not simulated", "GelSightRenderCfg VisuoTactileSensorCfg"
    ),
    "isaaclab.assets": refused(
        "the dialect does not translate this asset",
        """ArticulationData DeformableObject DeformableObjectCfg DeformableObjectData RigidObjectData SurfaceGripper
        SurfaceGripperCfg""",
    ),
    "isaaclab.controllers": refused(
        _CONTROLLER,
        """DifferentialIKController DifferentialIKControllerCfg OperationalSpaceController
        OperationalSpaceControllerCfg""",
    )
    | refused("RMPFlow is part of Isaac Sim", "RmpFlowController RmpFlowControllerCfg"),
    "isaaclab.controllers.config.rmp_flow": refused(
        "RMPFlow is part of Isaac Sim",
        """AGIBOT_LEFT_ARM_RMPFLOW_CFG AGIBOT_RIGHT_ARM_RMPFLOW_CFG GALBOT_LEFT_ARM_RMPFLOW_CFG
        GALBOT_RIGHT_ARM_RMPFLOW_CFG FRANKA_RMPFLOW_CFG UR10_RMPFLOW_CFG""",
    ),
    "isaaclab.controllers.pink_ik": refused(
        "Pink's controller is not available here",
        "LocalFrameTask NullSpacePostureTask PinkIKController PinkIKControllerCfg",
    ),
    "isaaclab.controllers.utils": refused("the converter is part of Isaac Sim", "convert_usd_to_urdf"),
    "isaaclab.devices.openxr": inert(
        _TELEOPERATION,
        """ManusVive ManusViveCfg OpenXRDevice OpenXRDeviceCfg XrAnchorRotationMode XrCfg
        remove_camera_configs""",
    ),
    "isaaclab.devices.openxr.retargeters": inert(
        _TELEOPERATION,
        """G1LowerBodyStandingMotionControllerRetargeterCfg G1LowerBodyStandingRetargeterCfg
        G1TriHandUpperBodyMotionControllerRetargeterCfg G1TriHandUpperBodyMotionControllerGripperRetargeterCfg
        G1TriHandUpperBodyRetargeterCfg GR1T2RetargeterCfg GripperRetargeterCfg Se3AbsRetargeterCfg
        Se3RelRetargeterCfg UnitreeG1RetargeterCfg""",
    ),
    "isaaclab.envs.utils.spaces": refused(
        "Hydra's form of spaces is not supported; use the options of the command line",
        "replace_env_cfg_spaces_with_strings replace_strings_with_env_cfg_spaces sample_space",
    ),
    "isaaclab.sensors": refused(_SENSOR, "CameraData ContactSensorData FrameTransformerData ImuData"),
    "isaaclab.sim": inert(
        "these options are of PhysX and have no effect", "PhysxCfg RenderCfg FixedTendonPropertiesCfg"
    )
    | refused(
        "deformable bodies are not simulated",
        "DeformableBodyMaterialCfg DeformableBodyPropertiesCfg DeformableObjectSpawnerCfg",
    ),
    "isaaclab.utils.io": refused("the dialect does not translate this function", "load_torchscript_model"),
    "isaaclab.utils.math": refused(
        _MATH,
        """axis_angle_from_quat combine_frame_transforms compute_pose_error euler_xyz_from_quat matrix_from_quat
        normalize orthogonalize_perspective_depth quat_apply quat_apply_inverse quat_apply_yaw quat_conjugate
        quat_error_magnitude quat_from_angle_axis quat_from_euler_xyz quat_from_matrix quat_inv quat_mul
        quat_rotate quat_rotate_inverse quat_unique random_orientation sample_gaussian sample_log_uniform
        sample_uniform saturate scale_transform subtract_frame_transforms unscale_transform wrap_to_pi yaw_quat""",
    ),
}
