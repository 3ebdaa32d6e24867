# SPDX-License-Identifier: Apache-2.0
"""Scene context: the scene under construction, and how its prim paths are written.

Calls such as ``spawn_ground_plane("/World/ground", cfg)`` name no stage. They author the scene whose ``_setup_scene``
(or constructor) runs, found through a context variable, so that several scenes may live in one process.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from pxr import Usd

from stripe_newton.config_base import ConfigError

__all__ = ["ENV_0", "authored_path", "current_scene", "current_stage", "is_env_path", "scene_context"]

ENV_0 = "/World/envs/env_0"
"""Prim of the template environment; all others are copies of it."""

# The spellings of "in every environment" that Isaac Lab's configs have, and the template environment itself.
_ENV_PATTERN = re.compile(r"^(\{ENV_REGEX_NS\}|/World/envs/env_(\.\*|\*|\[0-9\]\+|\\d\+|0))(?=/|$)")
# It holds a SceneContents. ``sim`` lies below ``scene`` and cannot name that class, not even for type checkers.
_scene: ContextVar[Any] = ContextVar("stripe_newton_scene", default=None)


@contextmanager
def scene_context(scene: object) -> Iterator[None]:
    """Inside this context spawners and the constructors of assets, sensors and terrains add to ``scene``."""
    token = _scene.set(scene)
    try:
        yield
    finally:
        _scene.reset(token)


def current_scene() -> Any:
    """The scene under construction, a :class:`stripe_newton.scene.InteractiveScene`.

    Raises:
        RuntimeError: outside the construction of a scene.
    """
    scene = _scene.get()
    if scene is None:
        raise RuntimeError(
            "no scene is under construction: create assets and spawn prims in '_setup_scene' or inside "
            "'with scene.construction():'"
        )
    return scene


def current_stage() -> Usd.Stage:
    """The USD stage of the scene under construction."""
    return current_scene().stage


def authored_path(prim_path: str) -> str:
    """The path a prim is authored at: ``/World/envs/env_.*/Robot`` becomes ``/World/envs/env_0/Robot``.

    Raises:
        ConfigError: if it is not an absolute path, or has a pattern elsewhere than in the environment's name.
    """
    scene = _scene.get()
    path = _ENV_PATTERN.sub(ENV_0, prim_path if scene is None else scene.alias(prim_path))
    if not re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", path):
        right = "of names joined by '/', with a pattern only as '/World/envs/env_.*' or '{ENV_REGEX_NS}'"
        raise ConfigError([f"prim_path: is '{prim_path}', must be absolute, {right}"])
    return path


def is_env_path(prim_path: str) -> bool:
    """Whether an authored path lies in the template environment, and so in every environment."""
    return prim_path == ENV_0 or prim_path.startswith(ENV_0 + "/")
