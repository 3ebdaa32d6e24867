# SPDX-License-Identifier: Apache-2.0
"""Training environments for robots on the Newton physics engine.

Importing this package loads nothing heavy: no torch, no Warp, no GPU. Take what you need from its subpackages:

* ``stripe_newton.configclass``: ``@configclass`` and the checks of configs
* ``stripe_newton.sim``, ``.scene``, ``.assets``, ``.actuators``: from a USD stage to a running simulation
* ``stripe_newton.envs``: environments in the direct workflow
* ``stripe_newton.rl``, ``.viewers``, ``.cli``: training, pictures, command line
* ``stripe_newton.math``, ``.noise``: functions that tasks use
"""

from importlib.metadata import PackageNotFoundError, version

from .moved_modules import forward_modules

__all__ = ["__version__"]

try:
    __version__ = version("stripe-newton")
except PackageNotFoundError:  # run from a source tree that is not installed
    __version__ = "0+source"

# Old module paths, by the release that moved them. What moved in 0.2 goes with 0.3; CHANGELOG lists each.
forward_modules(
    {
        "stripe_newton.actuators.drives": "stripe_newton.actuators.drive_table",
        "stripe_newton.actuators.explicit_cfg": "stripe_newton.actuators.explicit_actuators",
        "stripe_newton.actuators.network_cfg": "stripe_newton.actuators.network_actuators",
        "stripe_newton.actuators.networks": "stripe_newton.actuators.network_files",
        "stripe_newton.assets.binding": "stripe_newton.assets.layout",
        "stripe_newton.assets.library": "stripe_newton.assets.robot_library",
        "stripe_newton.assets.structs": "stripe_newton.assets.root_data",
        "stripe_newton.scene.contents": "stripe_newton.scene.scene_contents",
        "stripe_newton.scene.grid": "stripe_newton.scene.spiral_grid",
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
    }
)
