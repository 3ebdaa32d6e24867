# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's simulation, spawners, terrains and markers."""

from .entries import Table, same

NAMES: dict[str, Table] = {
    "isaaclab.sim": same(
        "stripe_newton.sim",
        """SimulationCfg UsdFileCfg UrdfFileCfg GroundPlaneCfg spawn_ground_plane spawn_from_usd
        CapsuleCfg ConeCfg CuboidCfg CylinderCfg SphereCfg MeshCapsuleCfg MeshConeCfg MeshCuboidCfg MeshCylinderCfg
        MeshSphereCfg CylinderLightCfg DiskLightCfg DistantLightCfg DomeLightCfg LightCfg SphereLightCfg
        PreviewSurfaceCfg RigidBodyMaterialCfg ArticulationRootPropertiesCfg CollisionPropertiesCfg
        JointDrivePropertiesCfg MassPropertiesCfg RigidBodyPropertiesCfg SpawnerCfg RigidObjectSpawnerCfg""",
    ),
    "isaaclab.scene": same("stripe_newton.scene", "InteractiveScene InteractiveSceneCfg"),
    "isaaclab.terrains": same("stripe_newton.terrains", "TerrainImporterCfg TerrainGeneratorCfg TerrainImporter"),
    "isaaclab.terrains.config": {},
    "isaaclab.terrains.config.rough": same("stripe_newton.terrains", "ROUGH_TERRAINS_CFG"),
}

ALIASES: dict[str, str] = {}
