# SPDX-License-Identifier: Apache-2.0
"""Direct environments of the Isaac Lab dialect: on the dialect's scene."""

from __future__ import annotations

from typing import ClassVar

from stripe_newton import envs as native
from stripe_newton import scene as native_scene

from .scene import InteractiveScene

__all__ = ["DirectMARLEnv", "DirectRLEnv"]


class DirectRLEnv(native.DirectRLEnv):
    """:class:`stripe_newton.envs.DirectRLEnv` with quaternions (w, x, y, z) in its scene."""

    scene_class: ClassVar[type[native_scene.InteractiveScene]] = InteractiveScene


class DirectMARLEnv(native.DirectMARLEnv):
    """:class:`stripe_newton.envs.DirectMARLEnv` with quaternions (w, x, y, z) in its scene."""

    scene_class: ClassVar[type[native_scene.InteractiveScene]] = InteractiveScene
