# SPDX-License-Identifier: Apache-2.0
"""Assets: what stands in a scene and has state."""

from .articulation import Articulation, ArticulationCfg
from .articulation_data import ArticulationData
from .asset_base import AssetBase, AssetBaseCfg
from .layout import Layout, articulation_layouts
from .library import ROBOT_SOURCES, file_spawner, find_robot
from .rigid_object import RigidObject, RigidObjectCfg
from .root_data import RootData

__all__ = [
    "ROBOT_SOURCES",
    "Articulation",
    "ArticulationCfg",
    "ArticulationData",
    "AssetBase",
    "AssetBaseCfg",
    "Layout",
    "RigidObject",
    "RigidObjectCfg",
    "RootData",
    "articulation_layouts",
    "file_spawner",
    "find_robot",
]
