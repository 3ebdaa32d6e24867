# SPDX-License-Identifier: Apache-2.0
"""Pictures, videos and a live view of a running simulation, without a display.

:class:`ViewerCfg` imports nothing heavy; what draws is imported when it is first named.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .viewer_cfg import ViewerCfg

if TYPE_CHECKING:
    from .live_viewer import LiveViewer
    from .scene_renderer import SceneRenderer
    from .video import VideoWriter, save_image

__all__ = ["LiveViewer", "SceneRenderer", "VideoWriter", "ViewerCfg", "save_image"]

_HOME = {"LiveViewer": "live_viewer", "SceneRenderer": "scene_renderer", "VideoWriter": "video", "save_image": "video"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
