# SPDX-License-Identifier: Apache-2.0
"""Assets: articulations, rigid objects and static assets of a scene."""

from .articulation import Articulation, ArticulationCfg
from .articulation_data import ArticulationData
from .asset_base import AssetBase, AssetBaseCfg, BoundAsset
from .dynamics import ArticulationDynamics
from .fixed_tendons import FixedTendons
from .layout import Layout, articulation_layouts
from .rigid_object import RigidObject, RigidObjectCfg
from .rigid_object_collection import (
    RigidObjectCollection,
    RigidObjectCollectionCfg,
    RigidObjectCollectionData,
)
from .robot_library import ROBOT_SOURCES, ROBOTS, RobotNotFoundError, file_spawner, find_robot, robot_cfg
from .root_data import RootData
from .terrain_base import TerrainBase, TerrainBaseCfg

__all__ = [
    "ROBOTS",
    "ROBOT_SOURCES",
    "Articulation",
    "ArticulationCfg",
    "ArticulationData",
    "ArticulationDynamics",
    "AssetBase",
    "AssetBaseCfg",
    "BoundAsset",
    "FixedTendons",
    "Layout",
    "RigidObject",
    "RigidObjectCfg",
    "RigidObjectCollection",
    "RigidObjectCollectionCfg",
    "RigidObjectCollectionData",
    "RobotNotFoundError",
    "RootData",
    "TerrainBase",
    "TerrainBaseCfg",
    "articulation_layouts",
    "file_spawner",
    "find_robot",
    "robot_cfg",
]
