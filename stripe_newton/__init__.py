# SPDX-License-Identifier: Apache-2.0
"""Training environments for robots on the Newton physics engine.

Importing this package loads nothing heavy: no torch, no Warp, no GPU. Take what you need from its subpackages:

* ``stripe_newton.configclass``: ``@configclass`` and the checks of configs
* ``stripe_newton.sim``, ``.scene``, ``.assets``, ``.actuators``: from a USD stage to a running simulation
* ``stripe_newton.envs``: environments in the direct workflow
* ``stripe_newton.rl``, ``.viewers``, ``.cli``: training, pictures, command line
* ``stripe_newton.controllers``: inverse kinematics and operational space control
* ``stripe_newton.math``, ``.noise``: functions that tasks use
"""

from .moved_modules import forward_modules

__all__ = ["__version__"]

__version__: str
"""Version of the installed package, ``"0+source"`` if it runs from a source tree."""


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version  # here, as it takes longer than all else that is here

    try:
        found = version("stripe-newton")
    except PackageNotFoundError:
        found = "0+source"
    globals()[name] = found
    return found


# Old module paths. What moved in 0.2 goes with 0.3; the CHANGELOG lists each.
forward_modules(
    {
        "stripe_newton.actuators.drives": "stripe_newton.actuators.drive_table",
        "stripe_newton.actuators.explicit_cfg": "stripe_newton.actuators.explicit_actuators",
        "stripe_newton.actuators.network_cfg": "stripe_newton.actuators.network_actuators",
        "stripe_newton.actuators.networks": "stripe_newton.actuators.network_files",
        "stripe_newton.assets.binding": "stripe_newton.assets.layout",
        "stripe_newton.assets.library": "stripe_newton.assets.robot_library",
        "stripe_newton.assets.structs": "stripe_newton.assets.root_data",
        "stripe_newton.cli.errors": "stripe_newton.cli.user_error",
        "stripe_newton.cli.fields": "stripe_newton.cli.field_options",
        "stripe_newton.cli.ranks": "stripe_newton.cli.train_ranks",
        "stripe_newton.cli.resume": "stripe_newton.cli.train_resume",
        "stripe_newton.cli.sweep": "stripe_newton.cli.train_sweep",
        "stripe_newton.envs.direct_marl_env_cfg": "stripe_newton.envs.direct_marl_env",
        "stripe_newton.envs.direct_rl_env_cfg": "stripe_newton.envs.direct_rl_env",
        "stripe_newton.envs.outputs": "stripe_newton.envs.output_block",
        "stripe_newton.fusion.entity": "stripe_newton.fusion.scene_entity",
        "stripe_newton.fusion.items": "stripe_newton.fusion.stage",
        "stripe_newton.fusion.kernels": "stripe_newton.fusion.fused_kernel",
        "stripe_newton.fusion.log": "stripe_newton.fusion.episode_log",
        "stripe_newton.fusion.single": "stripe_newton.fusion.single_thread",
        "stripe_newton.managers.object_cfg": "stripe_newton.managers.object_pool",
        "stripe_newton.managers.observation_cfg": "stripe_newton.managers",
        "stripe_newton.managers.recorder_cfg": "stripe_newton.managers",
        "stripe_newton.rl.checkpoint": "stripe_newton.rl.runs.checkpoint",
        "stripe_newton.rl.compare": "stripe_newton.rl.experiments.run_groups",
        "stripe_newton.rl.compare_plot": "stripe_newton.rl.experiments.curve_charts",
        "stripe_newton.rl.compare_report": "stripe_newton.rl.experiments.comparison_report",
        "stripe_newton.rl.compare_runs": "stripe_newton.rl.experiments.loaded_runs",
        "stripe_newton.rl.config": "stripe_newton.rl.configs",
        "stripe_newton.rl.config_distillation": "stripe_newton.rl.configs",
        "stripe_newton.rl.export_check": "stripe_newton.rl.export.policy_check",
        "stripe_newton.rl.graph_loop": "stripe_newton.rl.graphs.loop",
        "stripe_newton.rl.graph_ppo": "stripe_newton.rl.graphs.ppo",
        "stripe_newton.rl.graph_program": "stripe_newton.rl.graphs.program",
        "stripe_newton.rl.graph_rollout": "stripe_newton.rl.graphs.rollout",
        "stripe_newton.rl.interrupt": "stripe_newton.rl.runs.interrupt",
        "stripe_newton.rl.launcher": "stripe_newton.rl.distributed.launcher",
        "stripe_newton.rl.logger": "stripe_newton.rl.runs.run_logger",
        "stripe_newton.rl.metrics": "stripe_newton.rl.runs.metrics_csv",
        "stripe_newton.rl.onnx_policy": "stripe_newton.rl.export.onnx_policy",
        "stripe_newton.rl.plot": "stripe_newton.rl.runs.learning_curve",
        "stripe_newton.rl.policy_metadata": "stripe_newton.rl.export.policy_metadata",
        "stripe_newton.rl.policy_parts": "stripe_newton.rl.export.env_description",
        "stripe_newton.rl.record": "stripe_newton.rl.runs.video",
        "stripe_newton.rl.run_folder": "stripe_newton.rl.runs.run_folder",
        "stripe_newton.rl.sb3": "stripe_newton.rl.wrappers.sb3",
        "stripe_newton.rl.skrl": "stripe_newton.rl.wrappers.skrl",
        "stripe_newton.rl.sweep": "stripe_newton.rl.experiments.sweep",
        "stripe_newton.rl.sweep_cfg": "stripe_newton.rl.experiments.sweep_cfg",
        "stripe_newton.rl.sweep_folder": "stripe_newton.rl.experiments.sweep_folder",
        "stripe_newton.rl.sweep_process": "stripe_newton.rl.experiments.sweep_process",
        "stripe_newton.rl.sweep_report": "stripe_newton.rl.experiments.sweep_report",
        "stripe_newton.rl.tables": "stripe_newton.rl.experiments.text_tables",
        "stripe_newton.rl.training_state": "stripe_newton.rl.runs.training_state",
        "stripe_newton.rl.vec_env": "stripe_newton.rl.wrappers.rsl_rl",
        "stripe_newton.scene.contents": "stripe_newton.scene.scene_contents",
        "stripe_newton.scene.grid": "stripe_newton.terrains.spiral_grid",
        "stripe_newton.scene.interactive_scene_cfg": "stripe_newton.scene.scene_contents",
        "stripe_newton.scene.obstacles_cfg": "stripe_newton.scene.obstacles",
        "stripe_newton.scene.regenerate": "stripe_newton.scene.regenerator",
        "stripe_newton.sensors.camera_cfg": "stripe_newton.sensors.camera",
        "stripe_newton.sensors.contact_sensor_cfg": "stripe_newton.sensors.contact_sensor",
        "stripe_newton.sensors.frame_transformer_cfg": "stripe_newton.sensors.frame_transformer",
        "stripe_newton.sensors.imu_cfg": "stripe_newton.sensors.imu",
        "stripe_newton.sensors.outputs": "stripe_newton.sensors.sensor_outputs",
        "stripe_newton.sensors.picture_chain": "stripe_newton.sensors.image_corruption",
        "stripe_newton.sensors.prims": "stripe_newton.sensors.prim_paths",
        "stripe_newton.sensors.ray_caster_cfg": "stripe_newton.sensors.ray_caster",
        "stripe_newton.sensors.ray_caster_mount": "stripe_newton.sensors.sensor_mount",
        "stripe_newton.sim.flags": "stripe_newton.sim.host_flags",
        "stripe_newton.sim.mass_tree": "stripe_newton.sim.mass_constants",
        "stripe_newton.sim.simulation_cfg": "stripe_newton.sim.simulation",
        "stripe_newton.sim.stage": "stripe_newton.sim.scene_context",
        "stripe_newton.spec": "stripe_newton.specifications",
        "stripe_newton.spec.asset": "stripe_newton.specifications.asset_spec",
        "stripe_newton.spec.author": "stripe_newton.specifications.authoring",
        "stripe_newton.spec.factory": "stripe_newton.specifications.scene_cfg_factory",
        "stripe_newton.spec.fitting": "stripe_newton.specifications.collider_fitting",
        "stripe_newton.spec.maps": "stripe_newton.specifications.scene_maps",
        "stripe_newton.spec.mesh": "stripe_newton.specifications.asset_mesh",
        "stripe_newton.spec.pictures": "stripe_newton.specifications.scene_pictures",
        "stripe_newton.spec.primitives": "stripe_newton.specifications.primitive_meshes",
        "stripe_newton.spec.scene": "stripe_newton.specifications.scene_spec",
        "stripe_newton.spec.terrain": "stripe_newton.specifications.terrain_instance",
        "stripe_newton.spec.tiles": "stripe_newton.specifications.tile_grid_spec",
        "stripe_newton.spec.training": "stripe_newton.specifications.training_spec",
        "stripe_newton.terrains.blocks": "stripe_newton.terrains.mesh_terrains",
        "stripe_newton.terrains.blocks_cfg": "stripe_newton.terrains.mesh_terrains",
        "stripe_newton.terrains.exchange": "stripe_newton.terrains.ground_usd",
        "stripe_newton.terrains.files": "stripe_newton.terrains.ground_files",
        "stripe_newton.terrains.height_fields": "stripe_newton.terrains.hf_terrains",
        "stripe_newton.terrains.height_fields_cfg": "stripe_newton.terrains.hf_terrains",
        "stripe_newton.terrains.origins": "stripe_newton.terrains.env_origins",
        "stripe_newton.terrains.patches": "stripe_newton.terrains.flat_patches",
        "stripe_newton.terrains.rough": "stripe_newton.terrains.rough_terrains",
        "stripe_newton.terrains.shapes": "stripe_newton.terrains.tile_geometry",
        "stripe_newton.terrains.sub_terrain_cfg": "stripe_newton.terrains.sub_terrain",
        "stripe_newton.terrains.terrain_generator_cfg": "stripe_newton.terrains.terrain_generator",
        "stripe_newton.terrains.terrain_importer_cfg": "stripe_newton.terrains.terrain_importer",
        "stripe_newton.usd.lights": "stripe_newton.usd.stage_lights",
        "stripe_newton.usd.report": "stripe_newton.usd.stage_report",
        "stripe_newton.usd.report_build": "stripe_newton.usd.report_rows",
        "stripe_newton.usd.stage": "stripe_newton.usd.stage_access",
        "stripe_newton.usd.trial": "stripe_newton.usd.stage_trial",
        "stripe_newton.viewers.camera": "stripe_newton.viewers.camera_framing",
        "stripe_newton.viewers.live_viewer": "stripe_newton.viewers.live.live_viewer",
        "stripe_newton.viewers.renderer": "stripe_newton.viewers.scene_renderer",
    }
)
