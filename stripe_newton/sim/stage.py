# SPDX-License-Identifier: Apache-2.0
"""The scene under construction, and the spelling of prim paths.

Calls such as ``spawn_ground_plane("/World/ground", cfg)`` name no stage: they author the scene whose
``_setup_scene`` (or constructor) runs, found through a context variable, so that several scenes may
live in one process.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pxr import Usd

__all__ = ["ENV_0", "authored_path", "current_scene", "current_stage", "is_env_path", "scene_context"]

ENV_0 = "/World/envs/env_0"
"""Prim of the template environment; all others are copies of it."""

_ENV_PATTERN = re.compile(r"^(\{ENV_REGEX_NS\}|/World/envs/env_(\.\*|\*|\[0-9\]\+|\\d\+|0))(?=/|$)")
_scene: ContextVar[Any] = ContextVar("stripe_newton_scene", default=None)


@contextmanager
def scene_context(scene: Any) -> Iterator[None]:
    """Make ``scene`` the one that spawners and asset constructors add to."""
    token = _scene.set(scene)
    try:
        yield
    finally:
        _scene.reset(token)


def current_scene() -> Any:
    """The scene under construction.

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
        ValueError: if it is not an absolute path, or has a pattern elsewhere than in the environment's name.
    """
    path = _ENV_PATTERN.sub(ENV_0, prim_path)
    if not re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", path):
        raise ValueError(
            f"prim path '{prim_path}': must be absolute, of names joined by '/', with a pattern only as "
            "'/World/envs/env_.*' or '{ENV_REGEX_NS}'"
        )
    return path


def is_env_path(prim_path: str) -> bool:
    """Whether an authored path lies in the template environment, and so in every environment."""
    return prim_path == ENV_0 or prim_path.startswith(ENV_0 + "/")
