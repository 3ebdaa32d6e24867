# SPDX-License-Identifier: Apache-2.0
"""Action layout: numbers, joints and functions of an action term, read from its config."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import warp as wp

from stripe_kernels.mdp import ACTIONS
from stripe_newton.assets.asset_base import BoundAsset
from stripe_newton.matching import match_names, match_values

from .actions_cfg import (
    ActionTermCfg,
    DifferentialInverseKinematicsActionCfg,
    JointActionCfg,
    NonHolonomicActionCfg,
    PerJoint,
)
from .context import ManagerContext
from .kinematic_chain import kinematic_chain
from .manager_base import is_warp_term
from .term_params import unknown_params

__all__ = ["ActionLayout", "lay_out"]

_DEFAULTS = {"scale": 1.0, "offset": 0.0, "alpha": 1.0}
"""Values for joints that a config does not name."""


@dataclass
class ActionLayout:
    """An action term whose config has been read without problems."""

    cfg: ActionTermCfg
    """The config."""
    first: int
    """Index of its first number among the actions."""
    size: int
    """Number of actions that it takes."""
    width: int
    """Number of processed actions that it writes."""
    joint_ids: list[int]
    """Joints of the asset that it moves."""
    functions: dict[str, wp.Function | None]
    """``process``, ``apply`` and ``reset``; the last may be None."""
    values: dict[str, object] = field(default_factory=dict)
    """Arguments of the functions, from fields of the config."""
    per_substep: bool = True
    """``apply`` runs before each physics step rather than once."""
    any_joint: bool = False
    """It is a user's class, which may move any joint of its asset."""

    def meets(self, other: ActionLayout) -> bool:
        """Whether both terms may move the same joint."""
        if self.cfg.asset_name != other.cfg.asset_name:
            return False
        return self.any_joint or other.any_joint or not set(self.joint_ids).isdisjoint(other.joint_ids)

    @property
    def is_elementwise(self) -> bool:
        """Whether each processed action depends on the action of the same index alone, and is applied once a step."""
        known = ACTIONS.get(self.cfg.kind) if isinstance(self.cfg, JointActionCfg) else None
        if (
            known is None
            or self.any_joint
            or (self.functions["process"], self.functions["apply"]) != (known.process, known.apply)
        ):
            return False
        prepared = self.cfg.noise is not None or self.cfg.delay_max_lag > 0
        return not (prepared or self.per_substep or "open_command" in self.values)


def lay_out(context: ManagerContext, path: str, cfg: ActionTermCfg, first: int) -> ActionLayout | None:
    """The layout of a term.

    Args:
        context: The context of the managers.
        path: Path of the term's config, such as ``actions.legs``.
        cfg: The config.
        first: Index of its first number among the actions.

    Returns:
        The layout, or None if problems have been added to ``context.problems``.
    """
    before = len(context.problems)
    layout = _ActionReader(context, path, cfg).layout(first)
    return layout if len(context.problems) == before else None


class _ActionReader:
    """Reads the config of one action term and reports its problems."""

    def __init__(self, context: ManagerContext, path: str, cfg: ActionTermCfg):
        self._context, self._path, self._cfg = context, path, cfg

    def _problem(self, name: str, text: object) -> None:
        self._context.problems.append(f"{self._path}.{name}: {text}")

    def layout(self, first: int) -> ActionLayout | None:
        cfg, asset = self._cfg, self._asset()
        if asset is None:
            return None
        before = len(self._context.problems)
        names, ids, named = self._joints(asset)
        layout = ActionLayout(cfg, first, len(ids), len(ids), ids, self._functions(), per_substep=cfg.per_substep)
        self._take_sizes(layout)
        if isinstance(cfg, JointActionCfg) and len(self._context.problems) == before:
            layout.values = self._values(cfg, [names[i] for i in named])
        if isinstance(cfg, DifferentialInverseKinematicsActionCfg):
            layout.size, layout.width = cfg.controller.action_dim, 7  # the desired pose
            layout.values = self._inverse_kinematics(cfg, asset, ids)
        if layout.functions["process"] and layout.functions["apply"]:
            functions, structs = layout.functions.values(), self._context.structs
            self._context.problems += unknown_params(structs, self._path, functions, cfg.params)
        return layout

    def _asset(self) -> BoundAsset | None:
        try:
            asset = self._context.entity(self._cfg.asset_name)
        except KeyError as error:
            self._problem("asset_name", error.args[0])
            return None
        if not isinstance(asset, BoundAsset):
            self._problem("asset_name", f"'{self._cfg.asset_name}' is a sensor, must be an articulation")
            return None
        return asset

    def _joints(self, asset: BoundAsset) -> tuple[list[str], list[int], list[int]]:
        """Names of the joints, indices of the joints that move, and of the joints by whose names values are given."""
        cfg, names = self._cfg, asset.layout.joint_names
        if not isinstance(cfg, NonHolonomicActionCfg):
            ids = self._indices("joint_names", cfg.joint_names, names, "joint", cfg.preserve_order)
            return names, ids, ids
        self._one("body_name", cfg.body_name, asset.layout.body_names, "body")
        joints = {"x_joint_name": cfg.x_joint_name, "y_joint_name": cfg.y_joint_name}
        joints |= {"yaw_joint_name": cfg.yaw_joint_name}
        ids = [i for name, joint in joints.items() for i in self._one(name, joint, names, "joint")]
        return names, ids, ids[::2]  # one value for the speed along x, one for the rate of turn

    def _indices(
        self, name: str, expressions: str | Sequence[str], names: Sequence[str], what: str, preserve_order: bool = False
    ) -> list[int]:
        try:
            return match_names(expressions, names, preserve_order, f"{what} of '{self._cfg.asset_name}'")[0]
        except ValueError as error:
            self._problem(name, error)
            return []

    def _one(self, name: str, expression: str, names: Sequence[str], what: str) -> list[int]:
        """The index of the only name that an expression matches, as a list."""
        ids = self._indices(name, expression, names, what)
        if len(ids) > 1:
            found, asset = ", ".join(names[i] for i in ids), self._cfg.asset_name
            self._problem(name, f"'{expression}' matches more than one {what} of '{asset}', name one of: {found}")
        return ids

    def _functions(self) -> dict[str, wp.Function | None]:
        """The functions of the config, or else those of the package for its kind."""
        known, functions = self._cfg.known_functions, dict[str, wp.Function | None]()
        own = {"process": self._cfg.process, "apply": self._cfg.apply, "reset": self._cfg.reset}
        for what, function in own.items():
            found = function or known.get(what)
            if not is_warp_term(found) and (what != "reset" or found is not None):
                self._problem(what, f"is {found!r}, must be a Warp function (@wp.func)")
                found = None
            functions[what] = found
        return functions

    def _take_sizes(self, layout: ActionLayout) -> None:
        """Take the sizes of the config; by default there is one number for each joint."""
        sizes = {"action_size": self._cfg.action_size, "processed_size": self._cfg.processed_size}
        for name, size in sizes.items():
            if size is not None and size < 1:
                self._problem(name, f"is {size}, must be 1 or more")
        layout.size = layout.size if self._cfg.action_size is None else self._cfg.action_size
        layout.width = layout.width if self._cfg.processed_size is None else self._cfg.processed_size

    def _values(self, cfg: JointActionCfg, names: list[str]) -> dict[str, object]:
        """Arguments of the functions by name, with one value for each of ``names``."""
        values: dict[str, object] = {**cfg.switches}
        for name, given in cfg.numbers.items():
            values[name] = self._per_joint(name, given, names)
        values["clip"] = self._clip(cfg, names)
        for name, positions in cfg.positions.items():
            found = self._matched(f"{name}_expr", positions, names)
            missing = [n for i, n in enumerate(names) if i not in found]
            if found and missing:
                self._problem(f"{name}_expr", f"has no value for {', '.join(missing)}")
            values[name] = [found.get(i, 0.0) for i in range(len(names))]
        return values

    def _per_joint(self, name: str, value: PerJoint, names: list[str]) -> list[float]:
        if isinstance(value, (tuple, list)):
            if len(value) != len(names):
                self._problem(name, f"has {len(value)} numbers, must have {len(names)}: {', '.join(names)}")
            return list(value)
        assert isinstance(value, (float, int, Mapping))
        found = self._matched(name, value, names)
        return [found.get(i, _DEFAULTS[name]) for i in range(len(names))]

    def _clip(self, cfg: JointActionCfg, names: list[str]) -> list[tuple[float, float]]:
        """Bounds of each number, infinite for joints that are not named."""
        bounds = cfg.clip or {}
        lower = self._matched("clip", {k: low for k, (low, _) in bounds.items()}, names)
        upper = match_values({k: high for k, (_, high) in bounds.items()}, names) if lower else {}
        return [(lower.get(i, -math.inf), upper.get(i, math.inf)) for i in range(len(names))]

    def _inverse_kinematics(
        self, cfg: DifferentialInverseKinematicsActionCfg, asset: BoundAsset, ids: list[int]
    ) -> dict[str, object]:
        """Arguments of the functions of differential inverse kinematics."""
        controller, offset, values = cfg.controller, cfg.body_offset or cfg.OffsetCfg(), dict[str, object]()
        body = self._one("body_name", cfg.body_name, asset.layout.body_names, "body")
        if ids and len(body) == 1:
            try:
                values["chain"] = kinematic_chain(self._context.scene.sim, asset.layout, ids, body[0])
            except ValueError as error:
                self._problem("joint_names", error)
        scale = cfg.scale if isinstance(cfg.scale, (tuple, list)) else [cfg.scale] * controller.action_dim
        values |= {"scale": list(scale), "body_offset_pos": offset.pos, "body_offset_rot": offset.rot}
        values |= {"has_rotation": controller.command_type == "pose", "is_relative": controller.use_relative_mode}
        return values | controller.numbers

    def _matched(self, name: str, value: float | Mapping[str, float], names: list[str]) -> dict[int, float]:
        try:
            return match_values(value, names, what="joint")
        except ValueError as error:
            self._problem(name, error)
            return {}
