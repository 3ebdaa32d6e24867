# SPDX-License-Identifier: Apache-2.0
"""Module paths of Isaac Lab 2.3.2 that the dialect answers for. A submodule offers the names of its package."""

SUBMODULES: dict[str, str] = {
    "isaaclab": "",
    "isaaclab.actuators": """
        actuator_base actuator_base_cfg actuator_cfg actuator_net actuator_net_cfg actuator_pd actuator_pd_cfg
    """,
    "isaaclab.app": "app_launcher",
    "isaaclab.assets": """
        articulation articulation.articulation articulation.articulation_cfg articulation.articulation_data
        asset_base asset_base_cfg deformable_object deformable_object.deformable_object
        deformable_object.deformable_object_cfg deformable_object.deformable_object_data rigid_object
        rigid_object.rigid_object rigid_object.rigid_object_cfg rigid_object.rigid_object_data
        rigid_object_collection rigid_object_collection.rigid_object_collection
        rigid_object_collection.rigid_object_collection_cfg rigid_object_collection.rigid_object_collection_data
        surface_gripper surface_gripper.surface_gripper surface_gripper.surface_gripper_cfg utils
    """,
    "isaaclab.controllers": """
        config config.rmp_flow differential_ik differential_ik_cfg joint_impedance operational_space
        operational_space_cfg pink_ik pink_ik.local_frame_task pink_ik.null_space_posture_task pink_ik.pink_ik
        pink_ik.pink_ik_cfg pink_ik.pink_kinematics_configuration rmp_flow utils
    """,
    "isaaclab.devices": """
        device_base gamepad gamepad.se2_gamepad gamepad.se3_gamepad haply haply.se3_haply keyboard
        keyboard.se2_keyboard keyboard.se3_keyboard openxr openxr.common openxr.manus_vive openxr.manus_vive_utils
        openxr.openxr_device openxr.retargeters openxr.retargeters.humanoid.fourier.gr1_t2_dex_retargeting_utils
        openxr.retargeters.humanoid.fourier.gr1t2_retargeter
        openxr.retargeters.humanoid.unitree.g1_lower_body_standing
        openxr.retargeters.humanoid.unitree.g1_motion_controller_locomotion
        openxr.retargeters.humanoid.unitree.inspire.g1_dex_retargeting_utils
        openxr.retargeters.humanoid.unitree.inspire.g1_upper_body_retargeter
        openxr.retargeters.humanoid.unitree.trihand.g1_dex_retargeting_utils
        openxr.retargeters.humanoid.unitree.trihand.g1_upper_body_motion_ctrl_gripper
        openxr.retargeters.humanoid.unitree.trihand.g1_upper_body_motion_ctrl_retargeter
        openxr.retargeters.humanoid.unitree.trihand.g1_upper_body_retargeter openxr.retargeters.manipulator
        openxr.retargeters.manipulator.gripper_retargeter openxr.retargeters.manipulator.se3_abs_retargeter
        openxr.retargeters.manipulator.se3_rel_retargeter openxr.xr_anchor_utils openxr.xr_cfg retargeter_base
        spacemouse spacemouse.se2_spacemouse spacemouse.se3_spacemouse spacemouse.utils teleop_device_factory
    """,
    "isaaclab.envs": """
        common direct_marl_env direct_marl_env_cfg direct_rl_env direct_rl_env_cfg manager_based_env
        manager_based_env_cfg manager_based_rl_env manager_based_rl_env_cfg manager_based_rl_mimic_env mdp
        mdp.actions mdp.actions.actions_cfg mdp.actions.binary_joint_actions mdp.actions.joint_actions
        mdp.actions.joint_actions_to_limits mdp.actions.non_holonomic_actions mdp.actions.pink_actions_cfg
        mdp.actions.pink_task_space_actions mdp.actions.rmpflow_actions_cfg mdp.actions.rmpflow_task_space_actions
        mdp.actions.surface_gripper_actions mdp.actions.task_space_actions mdp.commands mdp.commands.commands_cfg
        mdp.commands.null_command mdp.commands.pose_2d_command mdp.commands.pose_command
        mdp.commands.velocity_command mdp.curriculums mdp.events mdp.observations mdp.recorders
        mdp.recorders.recorders mdp.recorders.recorders_cfg mdp.rewards mdp.terminations mimic_env_cfg ui
        ui.base_env_window ui.empty_window ui.manager_based_rl_env_window ui.viewport_camera_controller utils
        utils.io_descriptors utils.marl utils.spaces
    """,
    "isaaclab.managers": """
        action_manager command_manager curriculum_manager event_manager manager_base manager_term_cfg
        observation_manager recorder_manager reward_manager scene_entity_cfg termination_manager
    """,
    "isaaclab.markers": "config visualization_markers",
    "isaaclab.scene": "interactive_scene interactive_scene_cfg",
    "isaaclab.sensors": """
        camera camera.camera camera.camera_cfg camera.camera_data camera.tiled_camera camera.tiled_camera_cfg
        camera.utils contact_sensor contact_sensor.contact_sensor contact_sensor.contact_sensor_cfg
        contact_sensor.contact_sensor_data frame_transformer frame_transformer.frame_transformer
        frame_transformer.frame_transformer_cfg frame_transformer.frame_transformer_data imu imu.imu imu.imu_cfg
        imu.imu_data ray_caster ray_caster.multi_mesh_ray_caster ray_caster.multi_mesh_ray_caster_camera
        ray_caster.multi_mesh_ray_caster_camera_cfg ray_caster.multi_mesh_ray_caster_camera_data
        ray_caster.multi_mesh_ray_caster_cfg ray_caster.multi_mesh_ray_caster_data ray_caster.patterns
        ray_caster.patterns.patterns ray_caster.patterns.patterns_cfg ray_caster.ray_cast_utils
        ray_caster.ray_caster ray_caster.ray_caster_camera ray_caster.ray_caster_camera_cfg
        ray_caster.ray_caster_cfg ray_caster.ray_caster_data sensor_base sensor_base_cfg
    """,
    "isaaclab.sim": """
        converters converters.asset_converter_base converters.asset_converter_base_cfg converters.mesh_converter
        converters.mesh_converter_cfg converters.mjcf_converter converters.mjcf_converter_cfg
        converters.urdf_converter converters.urdf_converter_cfg schemas schemas.schemas schemas.schemas_cfg
        simulation_cfg simulation_context spawners spawners.from_files spawners.from_files.from_files
        spawners.from_files.from_files_cfg spawners.lights spawners.lights.lights spawners.lights.lights_cfg
        spawners.materials spawners.materials.physics_materials spawners.materials.physics_materials_cfg
        spawners.materials.visual_materials spawners.materials.visual_materials_cfg spawners.meshes
        spawners.meshes.meshes spawners.meshes.meshes_cfg spawners.sensors spawners.sensors.sensors
        spawners.sensors.sensors_cfg spawners.shapes spawners.shapes.shapes spawners.shapes.shapes_cfg
        spawners.spawner_cfg spawners.wrappers spawners.wrappers.wrappers spawners.wrappers.wrappers_cfg utils
        utils.legacy utils.prims utils.queries utils.semantics utils.stage utils.transforms views
        views.xform_prim_view
    """,
    "isaaclab.terrains": """
        config config.rough height_field height_field.hf_terrains height_field.hf_terrains_cfg height_field.utils
        sub_terrain_cfg terrain_generator terrain_generator_cfg terrain_importer terrain_importer_cfg trimesh
        trimesh.mesh_terrains trimesh.mesh_terrains_cfg trimesh.utils utils
    """,
    "isaaclab.ui": """
        widgets widgets.image_plot widgets.line_plot widgets.manager_live_visualizer widgets.ui_visualizer_base
        widgets.ui_widget_wrapper xr_widgets xr_widgets.instruction_widget xr_widgets.scene_visualization
        xr_widgets.teleop_visualization_manager
    """,
    "isaaclab.utils": """
        array assets buffers buffers.circular_buffer buffers.delay_buffer buffers.timestamped_buffer configclass
        datasets datasets.dataset_file_handler_base datasets.episode_data datasets.hdf5_dataset_file_handler dict
        interpolation interpolation.linear_interpolation io io.torchscript io.yaml logger math mesh modifiers
        modifiers.modifier modifiers.modifier_base modifiers.modifier_cfg noise noise.noise_cfg noise.noise_model
        seed sensors string timer types version warp warp.fabric warp.kernels warp.ops wrench_composer
    """,
    "isaaclab_contrib": "",
    "isaaclab_rl": "",
    "isaaclab_rl.rl_games": "pbt pbt.mutation pbt.pbt pbt.pbt_cfg pbt.pbt_utils rl_games",
    "isaaclab_rl.rsl_rl": "distillation_cfg exporter rl_cfg rnd_cfg symmetry_cfg vecenv_wrapper",
    "isaaclab_rl.sb3": "",
    "isaaclab_rl.skrl": "",
    "isaaclab_rl.utils": "pretrained_checkpoint",
}
"""Submodules by package, each relative to it."""
