# SPDX-License-Identifier: Apache-2.0
"""Description of the parts of an environment that a policy depends on: joints, actions, observations, commands.

All values are plain. An environment of another package has no parts that this package knows, so its descriptions are
empty or None.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch

from stripe_newton.fusion import SceneEntityCfg
from stripe_newton.managers.actions_cfg import JointActionCfg
from stripe_newton.matching import match_names
from stripe_newton.rl.torch_vector_env import TorchVectorEnv, rl_env_of

from .metadata_format import ActionTermInfo, ArticulationInfo, ObservationGroupInfo, Plain
from .plain_values import plain, qualified_name, settings

if TYPE_CHECKING:
    from stripe_newton.actuators import ActuatorCfg
    from stripe_newton.assets import Articulation
    from stripe_newton.envs import ManagerBasedRLEnv, RLEnv
    from stripe_newton.managers import ActionManager, ObservationGroupCfg, ObservationManager
    from stripe_newton.managers.action_layout import ActionLayout
    from stripe_newton.sensors import SensorBase

__all__ = ["action_terms", "articulations", "commands", "observation_groups", "sensors", "sensors_of"]

_FIELDS = {
    "stiffness": ("joint_stiffness", "joint_target_ke"),
    "damping": ("joint_damping", "joint_target_kd"),
    "effort_limit": ("joint_effort_limits", "joint_effort_limit"),
    "velocity_limit": ("joint_vel_limits", "joint_velocity_limit"),
    "armature": ("joint_armature", "joint_armature"),
    "friction": ("joint_friction_coeff", "joint_friction"),
}
"""Fields of ``ArticulationData`` and of the model behind them."""
_NO_LIMIT = 1e9
"""Limits from here on stand for no limit."""


def _managed(env: TorchVectorEnv) -> ManagerBasedRLEnv | None:
    """The manager-based environment, or None for one without managers."""
    from stripe_newton.envs import ManagerBasedRLEnv  # here, since metadata are also read where there is no environment

    inner = rl_env_of(env)
    return inner if isinstance(inner, ManagerBasedRLEnv) else None


# -- joints


def articulations(env: TorchVectorEnv) -> dict[str, ArticulationInfo]:
    """Joints of each articulation of the scene, in their order, with poses, gains and limits (SI units).

    Values that events randomise are those that the model was built with. Other values that differ between environments
    are medians. ``varies`` names both.
    """
    inner = rl_env_of(env)
    if inner is None:
        return {}
    return {name: _articulation(inner, asset) for name, asset in inner.scene.articulations.items()}


def _articulation(env: RLEnv, asset: Articulation) -> ArticulationInfo:
    data, template = asset.native_data, env.sim.template
    values, varies = _gains_and_limits(env, asset)
    limits = _lower_median(data.joint_pos_limits).cpu().numpy()
    positions, root = data.default_joint_pos, data.default_root_state[0]
    same = torch.equal(positions, positions[:1].expand_as(positions))
    if not same:
        varies.append("default_joint_pos")
    found = {
        "joint_names": list(asset.joint_names),
        # Where events have moved the default pose: that of the template, which they started from.
        "default_joint_pos": positions[0] if same else [template.joint_q[i] for i in asset.layout.coords],
        "default_joint_vel": data.default_joint_vel[0],
        "joint_pos_limits": [pair if np.abs(pair).max() < _NO_LIMIT else None for pair in limits],
        "soft_joint_pos_limit_factor": asset.cfg.soft_joint_pos_limit_factor,
        **values,
        "varies": varies,
        "fixed_base": asset.is_fixed_base,
        "default_root_pos": root[:3],
        "default_root_quat_xyzw": root[3:7],
        "actuators": {group: _actuator(cfg, asset) for group, cfg in asset.cfg.actuators.items()},
    }
    return cast(ArticulationInfo, plain(found))


def _gains_and_limits(env: RLEnv, asset: Articulation) -> tuple[dict[str, object], list[str]]:
    """Values of the joints by name, and the names of those that differ between environments."""
    data, layout, controller = asset.native_data, asset.layout, env.scene.controller
    dofs = slice(layout.dofs.start, layout.dofs.stop)
    values: dict[str, torch.Tensor] = {}
    varies = []
    for name, (attribute, field) in _FIELDS.items():
        now = getattr(data, attribute)
        # The controller keeps the values of the start of fields that events change. They are the nominal robot, which
        # no single randomised environment is.
        tracked = field in controller.randomized
        values[name] = controller.field(field)[1][0, dofs] if tracked else _lower_median(now)
        if not torch.equal(now, values[name].expand_as(now)):
            varies.append(name)
    limits = {
        name: [v if v < _NO_LIMIT else None for v in values[name].cpu().numpy()]
        for name in ("effort_limit", "velocity_limit")
    }
    return {**values, **limits}, varies


def _lower_median(x: torch.Tensor) -> torch.Tensor:
    """Median over environments, which are the first axis, as ``torch.median`` has it.

    That has no deterministic form on a GPU, and so cannot be used in a training with ``--deterministic``.
    """
    return x.sort(dim=0).values[(len(x) - 1) // 2]


def _actuator(cfg: ActuatorCfg, asset: Articulation) -> dict[str, Plain]:
    names = match_names(cfg.joint_names_expr, asset.joint_names, what="joint")[1]
    return {"joint_names": names} | settings(cfg, "joint_names_expr")


# -- actions


def action_terms(env: TorchVectorEnv, assets: Mapping[str, ArticulationInfo]) -> list[ActionTermInfo] | None:
    """The action terms in order: their joints, and scale, offset and clip of their numbers.

    Args:
        env: The environment.
        assets: Its articulations, from :func:`articulations`.

    Returns:
        None for an environment without an action manager.
    """
    managed = _managed(env)
    if managed is None:
        return None
    manager = managed.action_manager
    return [_action_term(manager, manager.layout(name), name, assets) for name in manager.active_terms]


def _action_term(
    manager: ActionManager, layout: ActionLayout, name: str, assets: Mapping[str, ArticulationInfo]
) -> ActionTermInfo:
    cfg = layout.cfg
    joint_names = assets[cfg.asset_name]["joint_names"] if cfg.asset_name in assets else []
    found = {
        "name": name,
        "type": type(cfg).__name__.removesuffix("Cfg"),
        "asset": cfg.asset_name,
        "first": layout.first,
        "size": layout.size,
        "joint_names": [joint_names[i] for i in layout.joint_ids] if joint_names else [],
        **_action_values(manager, layout, name, assets),
        "delay_steps": [cfg.delay_min_lag, cfg.delay_max_lag],
        "noise": _noise(cfg.noise),
        "process": qualified_name(layout.functions.get("process") or cfg.class_type),
        "apply": qualified_name(layout.functions.get("apply") or cfg.class_type),
        **_further(cfg),
    }
    return cast(ActionTermInfo, plain(found))


def _action_values(
    manager: ActionManager, layout: ActionLayout, name: str, assets: Mapping[str, ArticulationInfo]
) -> dict[str, object]:
    """Scale, offset, clip and what else the functions of a term take, with the values that hold now."""
    cfg, values = layout.cfg, dict[str, object]()
    for key, value in layout.values.items():
        # Values that may change while the environment runs are in an array; the config has those of the start.
        shared = manager.context.arrays.get(f"actions.{name}.{key}")
        value = shared.numpy() if shared is not None else value
        if isinstance(value, (bool, int, float, str, tuple, list, np.ndarray)):
            values[key] = value
    kind = cfg.kind if isinstance(cfg, JointActionCfg) else ""
    if values.get("use_default_offset") and kind in ("JointPosition", "JointVelocity"):
        asset = assets[cfg.asset_name]
        default = asset["default_joint_pos"] if kind == "JointPosition" else asset["default_joint_vel"]
        values["offset"] = [default[i] for i in layout.joint_ids]
    if not hasattr(cfg, "alpha"):  # all joint terms take it, but only averaging ones have it in their config
        values.pop("alpha", None)
    clip = values.get("clip")
    if clip is not None and np.isinf(np.asarray(clip, dtype=float)).all():
        values["clip"] = None
    return values


def _further(cfg: object) -> dict[str, object]:
    """Fields of a term beside scale and offset, such as the body that it moves."""
    names = ("body_name", "body_offset", "controller", "x_joint_name", "y_joint_name", "yaw_joint_name", "params")
    return {name: value for name in names if (value := getattr(cfg, name, None))}


# -- observations


def observation_groups(env: TorchVectorEnv, shapes: Mapping[str, tuple[int, ...]]) -> list[ObservationGroupInfo]:
    """The groups that the policy reads, in its order, each with its terms in order.

    A number of a term passes modifiers, noise, clip, scale, delay and history, in this order.

    Args:
        env: The environment.
        shapes: Shape of each group for one environment.
    """
    managed = _managed(env)
    return [
        cast(
            ObservationGroupInfo,
            plain({"name": name, "shape": shape} | ({"terms": None} if managed is None else _group(managed, name))),
        )
        for name, shape in shapes.items()
    ]


def _group(env: ManagerBasedRLEnv, group: str) -> dict[str, object]:
    manager = env.observation_manager
    cfg: ObservationGroupCfg = _field(manager.cfg, group)
    terms: list[dict[str, object]] = []
    first = 0
    for name, shape in zip(manager.active_terms[group], manager.group_obs_term_dim[group], strict=True):
        term = _field(cfg, name)
        history = term.history_length if cfg.history_length is None else cfg.history_length
        width = math.prod(shape)  # with the history, since groups hand it out flat
        terms.append(
            {
                "name": name,
                "function": qualified_name(term.func),
                "params": {k: _entity(env, v) for k, v in term.params.items()},
                "first": first,
                "size": width // max(1, history),
                "scale": term.scale,
                "clip": term.clip,
                "history_length": history,
                "history_order": "oldest first" if history else None,
                "modifiers": list(term.modifiers or ()),
                "noise": _noise(term.noise if cfg.enable_corruption else None),
                "delay_steps": [term.delay_min_lag, term.delay_max_lag],
            }
        )
        first += width
    return {"terms": terms, "normalization": _normalization(manager, group, cfg)}


def _noise(cfg: object) -> dict[str, Plain] | None:
    return None if cfg is None else settings(cfg, "func", "class_type")


def _normalization(manager: ObservationManager, group: str, cfg: ObservationGroupCfg) -> dict[str, object] | None:
    """The statistics by which the environment, rather than the network, normalises a group."""
    if cfg.normalization is None:
        return None
    mean, var = (manager.context.arrays[f"observations.{group}.normalization.{n}"].numpy() for n in ("mean", "var"))
    return {
        "formula": "clamp((obs - mean) / (std + eps), -clip, clip)",
        "inside": False,
        "mean": mean,
        "std": np.sqrt(var),
        "eps": cfg.normalization.eps,
        "clip": cfg.normalization.clip,
    }


def _entity(env: RLEnv, value: object) -> object:
    """A parameter of a term; joints and bodies of an asset by their names."""
    if not isinstance(value, SceneEntityCfg):
        return value
    chosen: dict[str, object] = {"name": value.name}
    for kind in ("joint", "body"):
        names = env.scene[value.name].names_of(kind) if value.chooses(kind) else None
        if names is not None:
            chosen[f"{kind}_names"] = [names[i] for i in value.indices(kind, names)]
    return chosen


# -- sensors and commands


def sensors_of(env: TorchVectorEnv) -> Mapping[str, SensorBase]:
    """Sensors of the scene by name."""
    inner = rl_env_of(env)
    return {} if inner is None else inner.scene.sensors


def sensors(there: Mapping[str, SensorBase], groups: Sequence[ObservationGroupInfo]) -> dict[str, dict[str, Plain]]:
    """Settings of the sensors that terms of observation groups read, by name.

    Args:
        there: Sensors of the scene by name.
        groups: The groups, from :func:`observation_groups`.
    """
    # A term names its sensor in a parameter, as it names an asset; what is no sensor of the scene is left out.
    params = [value for group in groups for term in group["terms"] or () for value in term["params"].values()]
    named = [str(value["name"]) for value in params if isinstance(value, dict) and "name" in value]
    return {name: settings(there[name].cfg) for name in dict.fromkeys(named) if name in there}


def commands(env: TorchVectorEnv) -> dict[str, dict[str, Plain]]:
    """Settings of the command terms: what the policy was asked to do in training."""
    managed = _managed(env)
    if managed is None:
        return {}
    without = ("metrics", "debug_vis", "resample", "update", "size")
    names = managed.command_manager.active_terms
    return {name: settings(_field(managed.cfg.commands, name), *without) for name in names}


def _field(cfg: object, name: str) -> Any:
    """A field of a config of any class, or an item of a dict of configs."""
    return cfg[name] if isinstance(cfg, Mapping) else getattr(cfg, name)
