# SPDX-License-Identifier: Apache-2.0
"""What an action term takes, moves and calls, as its config says."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from stripe_kernels.mdp import ACTIONS, DIFFERENTIAL_IK_METHODS
from stripe_newton.matching import match_names, match_values

from .actions_cfg import (
    ActionTermCfg,
    DifferentialInverseKinematicsActionCfg,
    JointActionCfg,
    NonHolonomicActionCfg,
)
from .context import ManagerContext
from .kinematic_chain import kinematic_chain
from .manager_base import is_warp_term
from .term_params import unknown_params

__all__ = ["ActionLayout", "lay_out"]


@dataclass
class ActionLayout:
    """An action term whose config was found good."""

    cfg: ActionTermCfg
    first: int
    """Where its numbers begin among the actions."""
    size: int
    """Numbers of the policy."""
    width: int
    """Numbers of the commands."""
    joint_ids: list[int]
    functions: dict[str, Any]
    """``process``, ``apply`` and ``reset``; the last may be None."""
    values: dict[str, Any]
    """Arguments of the functions that fields of the config give."""
    per_substep: bool

    def meets(self, other: ActionLayout) -> bool:
        """Whether both move the same joint."""
        return self.cfg.asset_name == other.cfg.asset_name and not set(self.joint_ids).isdisjoint(other.joint_ids)

    @property
    def is_elementwise(self) -> bool:
        """Whether each command follows from the action of the same index, before the physics alone."""
        known = ACTIONS.get(getattr(self.cfg, "kind", ""))
        if known is None or (self.functions["process"], self.functions["apply"]) != (known.process, known.apply):
            return False
        prepared = self.cfg.noise is not None or self.cfg.delay_max_lag > 0
        return not (prepared or self.per_substep or "open_command" in self.values)


def lay_out(context: ManagerContext, path: str, cfg: ActionTermCfg, first: int) -> ActionLayout | None:
    """The layout of a term, or None after problems were added to ``context.problems``."""
    before = len(context.problems)
    layout = _Reading(context, path, cfg).layout(first)
    return layout if len(context.problems) == before else None


class _Reading:
    def __init__(self, context: ManagerContext, path: str, cfg: Any):
        self.context, self.path, self.cfg = context, path, cfg

    def problem(self, field: str, text: object) -> None:
        self.context.problems.append(f"{self.path}.{field}: {text}")

    def layout(self, first: int) -> ActionLayout | None:
        cfg = self.cfg
        try:
            data = self.context.entity(cfg.asset_name).data
        except KeyError as error:
            self.problem("asset_name", error.args[0])
            return None
        names, before = getattr(data, "joint_names", []), len(self.context.problems)
        if isinstance(cfg, NonHolonomicActionCfg):
            fields = ("x_joint_name", "y_joint_name", "yaw_joint_name")
            ids = [i for field in fields for i in self.indices(field, names, "joint", one=True)]
            self.indices("body_name", data.body_names, "body", one=True)
            named = ids[::2]  # a number for the speed and one for the turn
        else:
            named = ids = self.indices("joint_names", names, "joint")
        size = cfg.action_size if cfg.action_size is not None else len(ids)
        width = cfg.processed_size if cfg.processed_size is not None else len(ids)
        for field in ("action_size", "processed_size"):
            if getattr(cfg, field) is not None and getattr(cfg, field) < 1:
                self.problem(field, f"is {getattr(cfg, field)}, must be 1 or more")
        functions = dict(self.functions())
        values: dict[str, Any] = {}
        if isinstance(cfg, JointActionCfg) and len(self.context.problems) == before:
            values = dict(self.values([names[i] for i in named]))
        if isinstance(cfg, DifferentialInverseKinematicsActionCfg):
            size, width = cfg.controller.action_dim, 7  # the desired pose
            values = dict(self.inverse_kinematics(ids))
        if functions["process"] and functions["apply"]:
            self.context.problems += unknown_params(self.path, functions.values(), cfg.params)
        return ActionLayout(cfg, first, size, width, ids, functions, values, cfg.per_substep)

    def indices(self, field: str, names: list[str], what: str, one: bool = False) -> list[int]:
        expressions, asset = getattr(self.cfg, field), self.cfg.asset_name
        try:
            ids = match_names(expressions, names, not one and self.cfg.preserve_order, f"{what} of '{asset}'")[0]
        except ValueError as error:
            self.problem(field, error)
            return []
        if one and len(ids) != 1:
            found = ", ".join(names[i] for i in ids)
            self.problem(field, f"'{expressions}' matches more than one {what} of '{asset}', name one of: {found}")
        return ids

    def functions(self) -> Iterator[tuple[str, Any]]:
        """The config's functions, or those that come with the package for its kind."""
        if isinstance(self.cfg, DifferentialInverseKinematicsActionCfg):
            known = {"apply": DIFFERENTIAL_IK_METHODS.get(self.cfg.controller.ik_method)}
        else:
            term = ACTIONS.get(getattr(self.cfg, "kind", ""))
            known = term._asdict() if term is not None else {}
        for what in ("process", "apply", "reset"):
            function = getattr(self.cfg, what) or known.get(what)
            if not is_warp_term(function) and (what != "reset" or function is not None):
                self.problem(what, f"is {function!r}, must be a Warp function (@wp.func)")
                function = None
            yield what, function

    def values(self, names: list[str]) -> Iterator[tuple[str, Any]]:
        """Arguments of the functions by name, with one number for each of ``names``."""
        cfg = self.cfg
        for field in ("use_default_offset", "rescale_to_limits"):
            if hasattr(cfg, field):
                yield field, getattr(cfg, field)
        for field, default in (("scale", 1.0), ("offset", 0.0), ("alpha", 1.0)):
            value = getattr(cfg, field, default)
            if field == "offset" and getattr(cfg, "use_zero_offset", False):
                value = 0.0
            if isinstance(value, (tuple, list)):
                if len(value) != len(names):
                    self.problem(field, f"has {len(value)} numbers, must have {len(names)}: {', '.join(names)}")
                yield field, list(value)
            else:
                found = self.matched(field, value, names)
                yield field, [found.get(i, default) for i in range(len(names))]
        clip = [(-math.inf, math.inf)] * len(names)
        lower = self.matched("clip", {k: v[0] for k, v in (cfg.clip or {}).items()}, names)
        upper = match_values({k: v[1] for k, v in cfg.clip.items()}, names) if lower else {}
        yield "clip", [(lower.get(i, low), upper.get(i, high)) for i, (low, high) in enumerate(clip)]
        for which in ("open", "close"):
            field = f"{which}_command_expr"
            if hasattr(cfg, field):
                found = self.matched(field, getattr(cfg, field), names)
                missing = [n for i, n in enumerate(names) if i not in found]
                if found and missing:
                    self.problem(field, f"has no value for {', '.join(missing)}")
                yield f"{which}_command", [found.get(i, 0.0) for i in range(len(names))]

    def inverse_kinematics(self, ids: list[int]) -> Iterator[tuple[str, Any]]:
        """Arguments of the functions that move a body."""
        cfg, entity = self.cfg, self.context.entity(self.cfg.asset_name)
        controller, offset = cfg.controller, cfg.body_offset or cfg.OffsetCfg()
        body = self.indices("body_name", entity.data.body_names, "body", one=True)
        if ids and len(body) == 1:
            try:
                yield "chain", kinematic_chain(self.context.scene.sim, entity.layout, ids, body[0])
            except ValueError as error:
                self.problem("joint_names", error)
        scale = cfg.scale if isinstance(cfg.scale, (tuple, list)) else [cfg.scale] * controller.action_dim
        yield from {"scale": list(scale), "body_offset_pos": offset.pos, "body_offset_rot": offset.rot}.items()
        yield from {
            "has_rotation": controller.command_type == "pose",
            "is_relative": controller.use_relative_mode,
        }.items()
        yield from controller.numbers.items()

    def matched(self, field: str, value: Any, names: list[str]) -> dict[int, float]:
        try:
            return match_values(value, names, what="joint")
        except ValueError as error:
            self.problem(field, error)
            return {}
