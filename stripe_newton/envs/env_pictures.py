# SPDX-License-Identifier: Apache-2.0
"""Environment pictures: the renderer of an environment's ``render()``, with layers of its sensors and commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stripe_newton.viewers import SceneRenderer

    from .built_scene import BuiltScene

__all__ = ["EnvPictures"]


class EnvPictures:
    """Renderer and layers of an environment.

    Attributes:
        renderer: The renderer.
    """

    renderer: SceneRenderer

    def __init__(self, env: BuiltScene):
        """Make the renderer with the settings of ``env.cfg.viewer``; most environments are never drawn."""
        from stripe_newton.viewers import SceneRenderer  # here, as it takes a while
        from stripe_newton.viewers.picture_layers import PictureLayers

        self.renderer = SceneRenderer(env.sim, env.cfg.viewer)
        env_ids, chosen = self.renderer.env_ids, env.cfg.viewer.env_index
        self._layers = PictureLayers(env, env_ids, chosen if chosen in env_ids else 0)

    def render(self) -> np.ndarray:
        """A picture of the present state, uint8, shape ``(height, width, 3)``."""
        with self._layers.shown():
            return self.renderer.render()

    def close(self) -> None:
        """Release the renderer."""
        self.renderer.close()
