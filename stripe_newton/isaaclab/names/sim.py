# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's simulation, spawners and markers."""

from .entries import Table, dialect, inert, same

NAMES: dict[str, Table] = {
    "isaaclab.sim": same(
        "stripe_newton.sim",
        """PreviewSurfaceCfg ArticulationRootPropertiesCfg CollisionPropertiesCfg JointDrivePropertiesCfg
        MassPropertiesCfg RigidBodyPropertiesCfg""",
    )
    | dialect("simulation_cfg", "MdlFileCfg PhysxCfg RenderCfg RigidBodyMaterialCfg SimulationCfg")
    | inert("tendons are those of the file", "FixedTendonPropertiesCfg SpatialTendonPropertiesCfg")
    | dialect(
        "spawners",
        """UsdFileCfg UrdfFileCfg GroundPlaneCfg spawn_from_urdf spawn_from_usd spawn_ground_plane spawn_light
        CapsuleCfg ConeCfg CuboidCfg CylinderCfg SphereCfg MeshCapsuleCfg MeshConeCfg MeshCuboidCfg MeshCylinderCfg
        MeshSphereCfg CylinderLightCfg DiskLightCfg DistantLightCfg DomeLightCfg LightCfg SphereLightCfg SpawnerCfg
        RigidObjectSpawnerCfg""",
    ),
    "isaaclab.scene": dialect("scene", "InteractiveScene") | same("stripe_newton.scene", "InteractiveSceneCfg"),
}

ALIASES: dict[str, str] = {}
