# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's terrains."""

from .entries import Table, dialect, refused, same

NAMES: dict[str, Table] = {
    "isaaclab.terrains": same(
        "stripe_newton.terrains",
        "FlatPatchSamplingCfg TerrainGenerator TerrainImporter TerrainImporterCfg",
    )
    | dialect("user_terrains", "SubTerrainBaseCfg")
    | dialect(
        "terrains",
        """HfDiscreteObstaclesTerrainCfg HfInvertedPyramidSlopedTerrainCfg HfInvertedPyramidStairsTerrainCfg
        HfPyramidSlopedTerrainCfg HfPyramidStairsTerrainCfg HfRandomUniformTerrainCfg HfSteppingStonesTerrainCfg
        HfTerrainBaseCfg HfWaveTerrainCfg MeshBoxTerrainCfg MeshGapTerrainCfg MeshInvertedPyramidStairsTerrainCfg
        MeshPitTerrainCfg MeshPlaneTerrainCfg MeshPyramidStairsTerrainCfg MeshRailsTerrainCfg MeshRandomGridTerrainCfg
        MeshRepeatedBoxesTerrainCfg MeshRepeatedCylindersTerrainCfg MeshRepeatedPyramidsTerrainCfg MeshStarTerrainCfg
        TerrainGeneratorCfg""",
    )
    | same("stripe_newton.terrains", "MeshRepeatedObjectsTerrainCfg")
    | refused("the ground is a height field, which has no overhangs", "MeshFloatingRingTerrainCfg"),
    "isaaclab.terrains.height_field.utils": dialect("user_terrains", "height_field_to_mesh"),
    "isaaclab.terrains.trimesh.utils": dialect("user_terrains", "make_border make_plane"),
    "isaaclab.terrains.config": {},
    "isaaclab.terrains.config.rough": dialect("terrains", "ROUGH_TERRAINS_CFG"),
}

ALIASES: dict[str, str] = {}
