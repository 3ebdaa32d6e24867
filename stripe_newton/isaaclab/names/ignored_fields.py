# SPDX-License-Identifier: Apache-2.0
"""Fields of Isaac Lab's config classes that load and have no effect: reason and names, by class.

A field that the class which a name stands for has of its own is left alone.
"""

__all__ = ["IGNORED_FIELDS"]

_PHYSX = "it is an option of PhysX"
_MARKER = "markers are not drawn"

_TENDONS = {"fixed_tendons_props": _PHYSX, "spatial_tendons_props": _PHYSX}
_VISUALIZER = {"visualizer_cfg": _MARKER}

IGNORED_FIELDS: dict[str, dict[str, str]] = {
    "AssetBaseCfg": {"semantic_tags": "tags are those of the spawner"},
    "FrameTransformerCfg": _VISUALIZER,
    "RayCasterCfg": _VISUALIZER,
    "ContactSensorCfg": _VISUALIZER,
    "ImuCfg": _VISUALIZER,
    "SimulationCfg": {
        "physx": _PHYSX,
        "render": "it is an option of Omniverse's renderer",
        "physics_prim_path": "there is one simulation for an environment",
        "enable_scene_query_support": _PHYSX,
        "use_fabric": "Fabric is part of Omniverse",
        "create_stage_in_memory": "stages are always in memory",
    },
    "UsdFileCfg": _TENDONS,
}
