# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's simulation, spawners and markers."""

from .entries import Table, dialect, inert, refused, same

PRIMS = """create_prim define_prim delete_prim find_first_matching_prim find_matching_prim_paths find_matching_prims
    get_all_matching_child_prims get_current_stage get_first_matching_child_prim get_prim_at_path is_prim_path_valid
    set_prim_visibility"""

_MARKERS = """BLUE_ARROW_X_MARKER_CFG CONTACT_SENSOR_MARKER_CFG CUBOID_MARKER_CFG DEFORMABLE_TARGET_MARKER_CFG
    FRAME_MARKER_CFG GREEN_ARROW_X_MARKER_CFG POSITION_GOAL_MARKER_CFG RAY_CASTER_MARKER_CFG RED_ARROW_X_MARKER_CFG
    SPHERE_MARKER_CFG VisualizationMarkers VisualizationMarkersCfg"""

NAMES: dict[str, Table] = {
    "isaaclab.markers": dialect("markers", _MARKERS),
    "isaaclab.sim": same(
        "stripe_newton.sim",
        """PreviewSurfaceCfg ArticulationRootPropertiesCfg CollisionPropertiesCfg JointDrivePropertiesCfg
        MassPropertiesCfg RigidBodyPropertiesCfg""",
    )
    | dialect("simulation_cfg", "GlassMdlCfg MdlFileCfg PhysxCfg RenderCfg RigidBodyMaterialCfg SimulationCfg")
    | inert("tendons are those of the file", "FixedTendonPropertiesCfg SpatialTendonPropertiesCfg")
    | dialect("simulation_context", "SimulationContext build_simulation_context")
    | dialect("prims", PRIMS)
    | dialect("sensors", "PinholeCameraCfg")
    | dialect("file_spawners", "MjcfFileCfg UrdfConverterCfg UrdfFileCfg")
    | refused("cameras have no distortion; use PinholeCameraCfg", "FisheyeCameraCfg")
    | refused("files are imported as they are", "MjcfConverter MjcfConverterCfg UrdfConverter")
    | dialect(
        "spawners",
        """UsdFileCfg GroundPlaneCfg spawn_from_mjcf spawn_from_urdf spawn_from_usd spawn_ground_plane spawn_light
        CapsuleCfg ConeCfg CuboidCfg CylinderCfg SphereCfg MeshCapsuleCfg MeshConeCfg MeshCuboidCfg MeshCylinderCfg
        MeshSphereCfg CylinderLightCfg DiskLightCfg DistantLightCfg DomeLightCfg LightCfg SphereLightCfg SpawnerCfg
        RigidObjectSpawnerCfg MultiAssetSpawnerCfg MultiUsdFileCfg spawn_multi_asset spawn_multi_usd_file""",
    ),
    "isaaclab.scene": dialect("scene", "InteractiveScene InteractiveSceneCfg"),
}

ALIASES: dict[str, str] = {}
