# SPDX-License-Identifier: Apache-2.0
"""Tasks and scenes by name: registration, tasks with gymnasium, light enough to run at import."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn, TypeAlias

import gymnasium

from stripe_newton.configclass import resolve_name

if TYPE_CHECKING:
    # What a task names is imported when it is made, not when it is registered: that would load torch and Warp.
    from stripe_newton.envs import RLEnv, RLEnvCfg
    from stripe_newton.specifications.scene_spec import SceneSpec

__all__ = ["register_scene", "register_task", "scene_class", "scene_names", "vector_env_creator"]

EntryPoint: TypeAlias = "str | Callable[..., object]"
"""A class or function, or its name as ``"module:name"``."""

_SCENES: dict[str, str | type[SceneSpec]] = {}


class _EnvCreator:
    """The vector entry point of a task: makes its environment, from the registered config or from one that is given."""

    def __init__(self, env: str | Callable[..., RLEnv], env_cfg: str | Callable[[], RLEnvCfg]):
        self.env, self.env_cfg = env, env_cfg

    def __call__(
        self,
        cfg: RLEnvCfg | None = None,
        render_mode: str | None = None,
        num_envs: int | None = None,
        env_cfg_entry_point: EntryPoint | None = None,
        rsl_rl_cfg_entry_point: EntryPoint | None = None,
        **kwargs: object,
    ) -> RLEnv:
        # Configs for other learners are in the kwargs of tasks that were registered for Isaac Lab.
        kwargs = {name: value for name, value in kwargs.items() if not name.endswith("_entry_point")}
        make_env = resolve_name(self.env) if isinstance(self.env, str) else self.env
        make_cfg = resolve_name(self.env_cfg) if isinstance(self.env_cfg, str) else self.env_cfg
        chosen = make_cfg() if cfg is None else cfg
        # make_vec passes num_envs=1 where its caller named no number; that must not override a config that is given.
        if num_envs is not None and not (cfg is not None and num_envs == 1):
            chosen = chosen.copy()
            chosen.scene.num_envs = num_envs
        return make_env(cfg=chosen, render_mode=render_mode, **kwargs)


class _NoSingleEnv:
    """The entry point of a task for ``gymnasium.make``, which makes no vectors of environments."""

    def __init__(self, task_id: str):
        self.task_id = task_id

    def __call__(self, **kwargs: object) -> NoReturn:
        raise gymnasium.error.Error(
            f"'{self.task_id}' is always a vector of environments, which gymnasium.make does not make; call "
            f"gymnasium.make_vec('{self.task_id}', num_envs=1), or with more"
        )


def register_task(
    task_id: str,
    *,
    env: str | Callable[..., RLEnv],
    env_cfg: str | Callable[[], RLEnvCfg],
    rsl_rl_cfg: EntryPoint | None = None,
    description: str = "",
    policy: str | None = None,
) -> None:
    """Register a task, so that ``gymnasium.make_vec(task_id)`` and the command line find it.

    Args:
        task_id: Such as ``"My-Task-v0"``.
        env: ``"module:Class"`` of the environment, which takes ``(cfg, render_mode)``, or the class.
        env_cfg: ``"module:Class"`` of its config, or a function that returns one.
        rsl_rl_cfg: ``"module:Class"`` of the config that rsl_rl trains it with, or a function that returns one.
        description: What ``stripe-newton list`` says of it; by default the first sentence about its config.
        policy: ``"package:path"`` of a trained policy that the package contains, such as
            ``"my_tasks:policies/walk.onnx"``; ``stripe-newton demo`` shows it.

    ``gymnasium.make_vec(task_id, num_envs=64)`` or ``make_vec(task_id, cfg=cfg)`` makes it; with a config, the
    config's number of environments holds unless ``num_envs`` is given too.

    Example:
        >>> register_task("Doc-Reach-v0", env="my_tasks.reach:ReachEnv", env_cfg="my_tasks.reach:ReachEnvCfg")
        >>> gymnasium.spec("Doc-Reach-v0").id
        'Doc-Reach-v0'
    """
    kwargs: dict[str, EntryPoint] = {"env_cfg_entry_point": env_cfg}
    if rsl_rl_cfg is not None:
        kwargs["rsl_rl_cfg_entry_point"] = rsl_rl_cfg
    if description:
        kwargs["description_entry_point"] = description
    if policy is not None:
        kwargs["policy_entry_point"] = policy
    creator = _EnvCreator(env, env_cfg)
    gymnasium.register(id=task_id, entry_point=_NoSingleEnv(task_id), vector_entry_point=creator, kwargs=kwargs)


def vector_env_creator(env: str | Callable[..., RLEnv], env_cfg: str | Callable[[], RLEnvCfg]) -> Callable[..., RLEnv]:
    """The vector entry point of a task, for specs of gymnasium that were not made by :func:`register_task`.

    Args:
        env: ``"module:Class"`` of the environment, or the class.
        env_cfg: ``"module:Class"`` of its config, or a function that returns one.
    """
    return _EnvCreator(env, env_cfg)


def register_scene(name: str, spec: str | type[SceneSpec]) -> None:
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


def scene_class(name: str) -> type[SceneSpec]:
    """The ``SceneSpec`` class of a registered scene, imported now.

    Raises:
        KeyError: if there is none of that name.
    """
    spec = _SCENES[name]
    return resolve_name(spec) if isinstance(spec, str) else spec
