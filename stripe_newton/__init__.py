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
        "stripe_newton.usd.extras": "stripe_newton.usd",  # its names are the package's
        "stripe_newton.usd.lights": "stripe_newton.usd.stage_lights",
        "stripe_newton.usd.report": "stripe_newton.usd.stage_report",
        "stripe_newton.usd.report_build": "stripe_newton.usd.report_rows",
        "stripe_newton.usd.stage": "stripe_newton.usd.stage_access",
        "stripe_newton.usd.trial": "stripe_newton.usd.stage_trial",
        "stripe_newton.viewers.camera": "stripe_newton.viewers.camera_framing",
        "stripe_newton.viewers.live": "stripe_newton.viewers.live_viewer",
        "stripe_newton.viewers.renderer": "stripe_newton.viewers.scene_renderer",
    }
)
