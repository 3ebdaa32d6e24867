# SPDX-License-Identifier: Apache-2.0
"""Specifications: what a scene is made of, in plain Python, from which any number of scenes is generated.

No simulator has to run. A scene is a USD stage; see :class:`SceneSpec`.
"""

from .asset import AssetInstance, AssetSpec, IdenticalAssetSpec
from .factory import SceneCfgFactory, SceneStageCfg
from .fitting import fit_collider
from .mesh import AssetMesh, Collider, DynamicMesh, MeshPart, instancable
from .mesh_files import UniversalMesh, USDMesh
from .places import Places
from .primitives import BoxMesh, CapsuleMesh, ConeMesh, CylinderMesh, DebugMesh, PrimitiveMesh, SphereMesh
from .scene import Scene, SceneSpec
from .terrain import TerrainInstance
from .tiles import TileGridSpec
from .training import TaskEnvCfg, TrainingSpec

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
