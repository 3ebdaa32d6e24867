# SPDX-License-Identifier: Apache-2.0
"""Scenes: what stands where, how it becomes a model, and how it is read and changed."""

from .builder import SceneBuilder
from .capsules import Capsules
from .controller import SceneController
from .interactive_scene import InteractiveScene
from .interactive_scene_cfg import InteractiveSceneCfg
from .obstacles import Obstacles
from .obstacles_cfg import ObstaclesCfg
from .querier import SceneQuerier

__all__ = [
    "Capsules",
    "InteractiveScene",
    "InteractiveSceneCfg",
    "Obstacles",
    "ObstaclesCfg",
    "SceneBuilder",
    "SceneController",
    "SceneQuerier",
]
