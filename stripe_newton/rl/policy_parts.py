# SPDX-License-Identifier: Apache-2.0
"""The parts of an environment that a policy depends on, as plain values: joints, actions, observations, commands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
import warp as wp

from stripe_newton.configclass import is_config
from stripe_newton.fusion import SceneEntityCfg, names_of
from stripe_newton.matching import match_names

__all__ = ["action_terms", "articulations", "commands", "observation_groups", "plain", "sensors", "settings"]

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
"""From here on a limit stands for none."""


def plain(value: Any) -> Any:
    """A value as JSON has it: tensors and arrays as lists, functions by name, what is not finite as None."""
    if isinstance(value, wp.array):
        value = value.numpy()
    if isinstance(value, torch.Tensor):
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        return [plain(v) for v in value] if value.ndim else plain(value[()])
    if isinstance(value, (bool, str)) or value is None:
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(str(value)) if math.isfinite(value) else None  # the shortest number that is this one
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if is_config(value):
        return settings(value)
    if isinstance(value, (list, tuple, set, frozenset, slice, range)):
        return [plain(v) for v in value] if not isinstance(value, slice) else str(value)
    return _name(value)


def settings(cfg: Any, *without: str) -> dict[str, Any]:
    """The fields of a config that are set, as plain values, and the name of its class as ``type``."""
    fields = {name: getattr(cfg, name) for name in cfg.__dataclass_fields__ if name not in without and name[0] != "_"}
    kept = {k: v for k, v in fields.items() if v is not None and not (isinstance(v, (dict, tuple, list)) and not v)}
    return {"type": type(cfg).__name__} | {k: plain(v) for k, v in kept.items()}


def articulations(env: Any) -> dict[str, Any]:
    """Joints of each articulation of the scene, in their order, with poses, gains and limits (SI units).

    Of what events randomise, the values that the model was built with; of what else differs between environments, the
    median. ``varies`` names both.
    """
    found = getattr(getattr(env, "scene", None), "articulations", {})
    return {name: _articulation(env, asset) for name, asset in found.items()}


def _articulation(env: Any, asset: Any) -> dict[str, Any]:
    data, layout, controller = asset.data, asset.layout, env.scene.controller
    template, dofs = env.sim.template, slice(layout.dofs.start, layout.dofs.stop)
    values: dict[str, Any] = {}
    varies = []
    for name, (attribute, field) in _FIELDS.items():
        now = getattr(data, attribute)
        tracked = field in controller.randomized
        values[name] = controller.field(field)[1][0, dofs] if tracked else now.median(dim=0).values
        if not torch.equal(now, values[name].expand_as(now)):
            varies.append(name)
    for name in ("effort_limit", "velocity_limit"):
        values[name] = [v if v < _NO_LIMIT else None for v in values[name].cpu().numpy()]
    limits = data.joint_pos_limits.median(dim=0).values.cpu().numpy()
    positions, root = data.default_joint_pos, data.default_root_state[0]
    same = torch.equal(positions, positions[:1].expand_as(positions))
    if not same:
        varies.append("default_joint_pos")
    return {
        "joint_names": list(asset.joint_names),
        "default_joint_pos": positions[0] if same else [template.joint_q[i] for i in layout.coords],
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


def _actuator(cfg: Any, asset: Any) -> dict[str, Any]:
    names = match_names(cfg.joint_names_expr, asset.joint_names, what="joint")[1]
    return {"joint_names": names} | settings(cfg, "joint_names_expr")


def action_terms(env: Any, assets: dict[str, Any]) -> list[dict[str, Any]] | None:
    """The action terms in order: joints, and what their numbers are scaled, shifted and clipped by.

    None for an environment without an action manager.
    """
    manager = getattr(env, "action_manager", None)
    if manager is None:
        return None
    terms = []
    for name in manager.active_terms:
        layout = manager.get_term(name)
        cfg, arrays = layout.cfg, manager.context.arrays
        asset = assets.get(cfg.asset_name, {})
        values: dict[str, Any] = {}
        for key, value in layout.values.items():
            shared = arrays.get(f"actions.{name}.{key}")
            value = shared.numpy() if shared is not None else value
            if isinstance(value, (bool, int, float, str, tuple, list, np.ndarray)):
                values[key] = value
        for kind in ("JointPosition", "JointVelocity"):
            if getattr(cfg, "kind", "") == kind and values.get("use_default_offset"):
                default = asset["default_joint_" + ("pos" if kind == "JointPosition" else "vel")]
                values["offset"] = [default[i] for i in layout.joint_ids]
        if not hasattr(cfg, "alpha"):
            values.pop("alpha", None)
        if "clip" in values and np.isinf(values["clip"]).all():
            values["clip"] = None
        terms.append(
            {
                "name": name,
                "type": type(cfg).__name__.removesuffix("Cfg"),
                "asset": cfg.asset_name,
                "first": layout.first,
                "size": layout.size,
                "joint_names": [asset["joint_names"][i] for i in layout.joint_ids] if asset else [],
                **values,
                "delay_steps": [cfg.delay_min_lag, cfg.delay_max_lag],
                "noise": _noise(cfg.noise),
                "process": _name(layout.functions["process"]),
                "apply": _name(layout.functions["apply"]),
                **_further(cfg),
            }
        )
    return terms


def _further(cfg: Any) -> dict[str, Any]:
    """What a term says beside its scale and its offset, such as the body it moves."""
    names = ("body_name", "body_offset", "controller", "x_joint_name", "y_joint_name", "yaw_joint_name", "params")
    return {name: value for name in names if (value := getattr(cfg, name, None))}


def observation_groups(env: Any, shapes: Mapping[str, tuple[int, ...]]) -> list[dict[str, Any]]:
    """The groups that the policy reads, in its order, each with its terms in order; None where there are no terms.

    A number of a term passes modifiers, noise, clip, scale, delay and history, in this order.

    Args:
        env: the environment, unwrapped.
        shapes: shape of each group for one environment.
    """
    manager = getattr(env, "observation_manager", None)
    return [
        {"name": name, "shape": shape, **({"terms": None} if manager is None else _group(env, manager, name))}
        for name, shape in shapes.items()
    ]


def _group(env: Any, manager: Any, group: str) -> dict[str, Any]:
    cfg = _get(manager.cfg, group)
    terms: list[dict[str, Any]] = []
    first = 0
    for name, shape in zip(manager.active_terms[group], manager.group_obs_term_dim[group], strict=True):
        term = _get(cfg, name)
        history = term.history_length if cfg.history_length is None else cfg.history_length
        width = math.prod(shape)
        terms.append(
            {
                "name": name,
                "function": _name(term.func),
                "params": {k: _entity(env, v) for k, v in term.params.items()},
                "first": first,
                "size": width // max(1, history),
                "scale": term.scale,
                "clip": term.clip,
                "history_length": history,
                "history_order": "oldest first" if history else None,
                "modifiers": list(term.modifiers),
                "noise": _noise(term.noise if cfg.enable_corruption else None),
                "delay_steps": [term.delay_min_lag, term.delay_max_lag],
            }
        )
        first += width
    return {"terms": terms, "normalization": _normalization(manager, group, cfg)}


def _noise(cfg: Any) -> Any:
    return cfg if cfg is None else settings(cfg, "func", "class_type")


def _normalization(manager: Any, group: str, cfg: Any) -> dict[str, Any] | None:
    """What the environment, not the network, normalises a group by."""
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


def _entity(env: Any, value: Any) -> Any:
    """A parameter of a term; of an asset's joints and bodies the names that were chosen."""
    if not isinstance(value, SceneEntityCfg):
        return value
    chosen: dict[str, Any] = {"name": value.name}
    for kind in ("joint", "body"):
        names = names_of(env.scene[value.name], kind) if value.chooses(kind) else None
        if names is not None:
            chosen[f"{kind}_names"] = [names[i] for i in value.indices(kind, names)]
    return chosen


def sensors(env: Any, groups: list[dict[str, Any]]) -> dict[str, Any]:
    """Settings of the sensors that terms of these groups read, by name."""
    there = getattr(getattr(env, "scene", None), "sensors", {})
    params = [value for group in groups for term in group["terms"] or () for value in term["params"].values()]
    named = [value["name"] for value in params if isinstance(value, dict) and "name" in value]
    return {name: settings(there[name].cfg) for name in dict.fromkeys(named) if name in there}


def commands(env: Any) -> dict[str, Any]:
    """Settings of the command terms: what the policy was asked to do in training."""
    cfg = getattr(env.cfg, "commands", None)
    names = getattr(getattr(env, "command_manager", None), "active_terms", [])
    return {name: settings(_get(cfg, name), "metrics", "debug_vis", "resample", "update", "size") for name in names}


def _get(cfg: Any, name: str) -> Any:
    return cfg[name] if isinstance(cfg, Mapping) else getattr(cfg, name)


def _name(function: Any) -> str | None:
    """``module:name`` of a function, Warp's or Python's."""
    if function is None:
        return None
    own = getattr(function, "func", function)
    name = getattr(own, "__qualname__", type(own).__qualname__)
    return f"{getattr(own, '__module__', type(own).__module__)}:{name}"
