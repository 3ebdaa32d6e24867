# SPDX-License-Identifier: Apache-2.0
"""What the policy is asked to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
import warp as wp

from stripe_kernels.data import CommandData, Pose2dCommandData, PoseCommandData, VelocityCommandData
from stripe_kernels.mdp import (
    COMMANDS,
    advance_command,
    orientation_command_error,
    pose_2d_error_heading,
    pose_2d_error_pos,
    position_command_error,
    restart_command,
    velocity_error_xy,
    velocity_error_yaw,
)
from stripe_newton.fusion import Item, SceneEntityCfg, Section, bind_term

from .commands_cfg import (
    CommandTermCfg,
    NormalVelocityCommandCfg,
    NullCommandCfg,
    UniformPose2dCommandCfg,
    UniformPoseCommandCfg,
    UniformVelocityCommandCfg,
)
from .context import ManagerContext
from .manager_base import ManagerBase

__all__ = ["CommandManager"]


@dataclass
class _Term:
    cfg: CommandTermCfg
    data: CommandData
    resample: Any
    update: Any
    params: dict[str, Any]
    metrics: dict[str, Any] = field(default_factory=dict)


class CommandManager(ManagerBase):
    """Draws commands at the start of an episode and whenever their time is up.

    All bounds are parameters, such as ``commands.base_velocity.lin_vel_x``, that a curriculum may change.
    """

    name = "commands"

    def __init__(self, cfg: Any, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms: dict[str, _Term] = {}
        for name, term in self.terms(cfg, CommandTermCfg).items():
            if not isinstance(term, NullCommandCfg):
                self._terms[name] = self._make(name, term)
        self._null = [n for n, t in self.terms(cfg, CommandTermCfg).items() if isinstance(t, NullCommandCfg)]
        self._sums = context.array("commands.metrics", float, sum(len(t.metrics) for t in self._terms.values()))
        self._sums_name = context.scope.name("command_metrics", self._sums)

    def _make(self, name: str, cfg: CommandTermCfg) -> _Term:
        """Arrays, functions and parameters of a term."""
        context, path = self.context, f"commands.{name}"
        known = COMMANDS.get(type(cfg).__name__.removesuffix("Cfg"))
        size = cfg.size if known is None else known.size
        data = CommandData()
        data.command = context.array(f"{path}.command", float, size)
        data.time_left = context.array(f"{path}.time_left", float)
        data.counter = context.array(f"{path}.counter", int)
        context.provide(data, name)
        term = _Term(cfg, data, cfg.resample, cfg.update, dict(cfg.params), dict(cfg.metrics))
        ranges: Any = getattr(cfg, "ranges", None)
        if isinstance(cfg, (UniformVelocityCommandCfg, NormalVelocityCommandCfg)):
            velocity = VelocityCommandData()
            velocity.command = data.command
            velocity.heading_target = context.array(f"{path}.heading_target", float)
            velocity.is_heading = context.array(f"{path}.is_heading", wp.bool)
            velocity.is_standing = context.array(f"{path}.is_standing", wp.bool)
            context.provide(velocity, name)
            term.metrics |= {"error_vel_xy": velocity_error_xy, "error_vel_yaw": velocity_error_yaw}
            if isinstance(cfg, UniformVelocityCommandCfg):
                term.params |= {
                    "lin_vel_x": ranges.lin_vel_x,
                    "lin_vel_y": ranges.lin_vel_y,
                    "ang_vel_z": ranges.ang_vel_z,
                    "heading": ranges.heading or (0.0, 0.0),
                    "rel_heading_envs": cfg.rel_heading_envs if cfg.heading_command else 0.0,
                    "rel_standing_envs": cfg.rel_standing_envs,
                    "heading_control_stiffness": cfg.heading_control_stiffness,
                }
            else:
                term.params |= {k: getattr(ranges, k) for k in ("mean_vel", "std_vel", "zero_prob")}
                term.params["rel_standing_envs"] = cfg.rel_standing_envs
        elif isinstance(cfg, UniformPoseCommandCfg):
            pose = PoseCommandData()
            pose.pose = wp.from_torch(context.torch(data.command), dtype=wp.transform)
            context.provide(pose, name)
            axes = ("pos_x", "pos_y", "pos_z", "roll", "pitch", "yaw")
            term.params |= {
                "pose_range": [getattr(ranges, a) for a in axes],
                "make_quat_unique": cfg.make_quat_unique,
                "asset_cfg": SceneEntityCfg(cfg.asset_name, body_names=[cfg.body_name]),
            }
            term.metrics |= {
                "position_error": position_command_error,
                "orientation_error": orientation_command_error,
            }
        elif isinstance(cfg, UniformPose2dCommandCfg):
            place = Pose2dCommandData()
            place.command = data.command
            place.pos = context.array(f"{path}.pos", wp.vec3)
            place.heading = context.array(f"{path}.heading_w", float)
            context.provide(place, name)
            term.params |= {"pos_x": ranges.pos_x, "pos_y": ranges.pos_y, "heading": ranges.heading}
            term.params["simple_heading"] = cfg.simple_heading
            term.metrics |= {"error_pos_2d": pose_2d_error_pos, "error_heading": pose_2d_error_heading}
        if known is not None:
            term.resample, term.update = known.resample, known.update
        elif term.resample is None:
            context.problems.append(f"{path}.resample: is None, give the Warp function that draws the command")
        term.params.setdefault("asset_cfg", SceneEntityCfg(cfg.asset_name))
        return term

    # -- what it is

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return [*self._terms, *self._null]

    def get_command(self, name: str) -> torch.Tensor:
        """The command as the policy sees it, shape ``(num_envs, n)``.

        Raises:
            KeyError: if there is no such term.
        """
        if name not in self._terms:
            raise KeyError(f"no command '{name}'; there is {', '.join(self._terms) or 'none'}")
        return self.context.torch(self._terms[name].data.command)

    def functions(self) -> list[list[Any]]:
        """Warp functions of each term that run after the reset."""
        return [[t.resample, t.update, *t.metrics.values()] for t in self._terms.values()]

    # -- items

    def compute(self) -> list[Item]:
        """Items that run in every step: the clocks, draws that are due, updates, metrics."""
        context, body, metric = self.context, [], 0
        dt = context.parameters.add("step_dt", context.step_dt, float)
        for name, term in self._terms.items():
            data = context.scope.name(f"{name}_clock", term.data)
            advance = context.scope.function(advance_command)
            span = self._span(name, term)
            resample = self._call(name, term, term.resample)
            body += [
                f"if {advance}(env, {data}, rng, {span}, {dt}):",
                *(f"    {line}" for line in resample or ["pass"]),
            ]
            body += self._call(name, term, term.update)
            for what, func in term.metrics.items():
                line = self._call(name, term, func, f"{name}.{what}", "metric")
                body += [f"{self._sums_name}[env, {metric}] += {line[0]}"] if line else []
                metric += 1
        return [Section("commands", body, self.active_terms)] if body else []

    def reset(self) -> list[Item]:
        """Items that log the metrics, the mean over the steps of the episode, and draw the first command."""
        context, body, metric = self.context, [], 0
        for name, term in self._terms.items():
            for what in term.metrics:
                place = f"{self._sums_name}[env, {metric}]"
                steps = "float(wp.max(episode.length[env], wp.int64(1)))"
                body += [context.log.line(f"Metrics/{name}/{what}", f"{place} / {steps}"), f"{place} = 0.0"]
                metric += 1
            data = context.scope.name(f"{name}_clock", term.data)
            restart = context.scope.function(restart_command)
            body += [f"{restart}(env, {data}, rng, {self._span(name, term)})"]
            body += self._call(name, term, term.resample)
        return [Section("commands_reset", body, self.active_terms, where_reset=True)] if body else []

    def _span(self, name: str, term: _Term) -> str:
        path = f"commands.{name}.resampling_time_range"
        return self.context.parameters.add(path, term.cfg.resampling_time_range, wp.vec2)

    def _call(self, name: str, term: _Term, func: Any, where: str | None = None, kind: str = "command") -> list[str]:
        if func is None:
            return []
        takes = func.input_types
        params = {k: v for k, v in term.params.items() if k in takes or k == "asset_cfg"}
        if any(t in self.context.provided for t in takes.values()):
            params["command_name"] = name
        call = bind_term(self.context, func, params, f"commands.{where or name}", kind)
        return [call.expression()] if call is not None else []

    def __str__(self) -> str:
        rows = [
            (i, n, type(t.cfg).__name__.removesuffix("Cfg"), t.data.command.shape[1], t.cfg.resampling_time_range)
            for i, (n, t) in enumerate(self._terms.items())
        ]
        return self.table("Command terms", ("Index", "Name", "Type", "Size", "Resampled after [s]"), rows)
