# SPDX-License-Identifier: Apache-2.0
"""Viewers: pictures, videos and a live view of a running simulation, without a display.

:class:`ViewerCfg` imports nothing heavy. The classes that draw are imported when they are first accessed.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from .viewer_cfg import ViewerCfg

if TYPE_CHECKING:
    from .live import LiveViewer
    from .markers import VisualizationMarkers, VisualizationMarkersCfg
    from .scene_renderer import SceneRenderer
    from .video import VideoWriter, save_image, save_images

__all__ = [
    "LiveViewer",
    "SceneRenderer",
    "VideoWriter",
    "ViewerCfg",
    "VisualizationMarkers",
    "VisualizationMarkersCfg",
    "save_image",
    "save_images",
]

_MODULES = {
    "LiveViewer": "live",
    "SceneRenderer": "scene_renderer",
    "VideoWriter": "video",
    "VisualizationMarkers": "markers",
    "VisualizationMarkersCfg": "markers",
    "save_image": "video",
    "save_images": "video",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)
