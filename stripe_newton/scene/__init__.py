# SPDX-License-Identifier: Apache-2.0
"""Scenes: assets on a stage, the model they become, and how it is read and changed."""

from .builder import SceneBuilder
from .capsules import Capsules
from .controller import SceneController
from .interactive_scene import InteractiveScene
from .obstacles import Obstacles, ObstaclesCfg
from .querier import SceneQuerier
from .scene_contents import InteractiveSceneCfg
from .scenery_options import SceneryOptionsCfg

__all__ = [
    "Capsules",
    "InteractiveScene",
    "InteractiveSceneCfg",
    "Obstacles",
    "ObstaclesCfg",
    "SceneBuilder",
    "SceneController",
    "SceneQuerier",
    "SceneryOptionsCfg",
]
