# SPDX-License-Identifier: Apache-2.0
"""Tasks and scenes by name: registration, tasks with gymnasium, light enough to run at import."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium

from stripe_newton.configclass import resolve_name

__all__ = ["register_scene", "register_task", "scene_class", "scene_names"]

_SCENES: dict[str, str | type] = {}


class _Creator:
    """Makes the environment of a task; what gymnasium calls as its vector entry point."""

    def __init__(self, env: str | Callable[..., Any], env_cfg: str | Callable[[], Any]):
        self.env, self.env_cfg = env, env_cfg

    def __call__(
        self,
        cfg: Any = None,
        render_mode: str | None = None,
        num_envs: int | None = None,
        env_cfg_entry_point: Any = None,
        rsl_rl_cfg_entry_point: Any = None,
        **kwargs: Any,
    ) -> Any:
        given = cfg is not None
        cfg = cfg if given else _named(self.env_cfg)()
        if num_envs is not None and not (given and num_envs == 1):  # make_vec passes 1 when it was told nothing
            cfg = cfg.copy()
            cfg.scene.num_envs = num_envs
        return _named(self.env)(cfg=cfg, render_mode=render_mode, **kwargs)


def _named(thing: str | Callable[..., Any]) -> Any:
    return resolve_name(thing) if isinstance(thing, str) else thing


def register_task(
    task_id: str,
    *,
    env: str | Callable[..., Any],
    env_cfg: str | Callable[[], Any],
    rsl_rl_cfg: str | Callable[[], Any] | None = None,
) -> None:
    """Register a task, so that ``gymnasium.make_vec(task_id)`` and the command line find it.

    Args:
        task_id: Such as ``"My-Task-v0"``.
        env: ``"module:Class"`` of the environment, which takes ``(cfg, render_mode)``, or the class.
        env_cfg: ``"module:Class"`` of its config, or what makes one.
        rsl_rl_cfg: ``"module:Class"`` of the config that rsl_rl trains it with, or what makes one.

    ``gymnasium.make_vec(task_id, num_envs=64)`` or ``make_vec(task_id, cfg=cfg)`` makes it; with a config, the
    config's number of environments holds unless ``num_envs`` is given too.
    """
    kwargs: dict[str, Any] = {"env_cfg_entry_point": env_cfg}
    if rsl_rl_cfg is not None:
        kwargs["rsl_rl_cfg_entry_point"] = rsl_rl_cfg
    gymnasium.register(id=task_id, vector_entry_point=_Creator(env, env_cfg), kwargs=kwargs)


def register_scene(name: str, spec: str | type) -> None:
    """Register a scene, so that ``stripe-newton scene`` finds it.

    Args:
        name: Such as ``"forest"``.
        spec: ``"module:Class"`` of its ``SceneSpec``, which is imported when the scene is asked for, or the class.

    Raises:
        ValueError: if another scene has that name.
    """
    if _SCENES.setdefault(name, spec) != spec:
        raise ValueError(f"scene '{name}': is registered already, as {_SCENES[name]}; give the other another name")


def scene_names() -> list[str]:
    """Names of all registered scenes, sorted."""
    return sorted(_SCENES)


def scene_class(name: str) -> Any:
    """The ``SceneSpec`` class of a registered scene, imported now.

    Raises:
        KeyError: if there is none of that name.
    """
    return _named(_SCENES[name])
