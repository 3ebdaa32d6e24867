# SPDX-License-Identifier: Apache-2.0
"""Specifications: descriptions of scenes and trainings in plain Python, from which any number of scenes is generated.

Generating needs no simulator. A scene is a USD stage; see :class:`SceneSpec`.
"""

from .asset_instance import AssetInstance
from .asset_mesh import AssetMesh, Collider, DynamicMesh, MeshPart, instancable
from .asset_spec import AssetSpec, IdenticalAssetSpec
from .collider_fitting import fit_collider
from .mesh_files import UniversalMesh, USDMesh
from .places import Places
from .primitive_meshes import BoxMesh, CapsuleMesh, ConeMesh, CylinderMesh, DebugMesh, PrimitiveMesh, SphereMesh
from .scene_cfg_factory import SceneCfgFactory, SceneStageCfg
from .scene_spec import Scene, SceneSpec
from .terrain_instance import TerrainInstance
from .tile_grid_spec import TileGridSpec
from .training_spec import TaskEnvCfg, TrainingSpec

__all__ = [
    "AssetInstance",
    "AssetMesh",
    "AssetSpec",
    "BoxMesh",
    "CapsuleMesh",
    "Collider",
    "ConeMesh",
    "CylinderMesh",
    "DebugMesh",
    "DynamicMesh",
    "IdenticalAssetSpec",
    "MeshPart",
    "Places",
    "PrimitiveMesh",
    "Scene",
    "SceneCfgFactory",
    "SceneSpec",
    "SceneStageCfg",
    "SphereMesh",
    "TaskEnvCfg",
    "TerrainInstance",
    "TileGridSpec",
    "TrainingSpec",
    "USDMesh",
    "UniversalMesh",
    "fit_collider",
    "instancable",
]
