# SPDX-License-Identifier: Apache-2.0
"""Command manager: velocities, poses and other goals for the policy, resampled at intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
import warp as wp

from stripe_kernels.data import ArticulationData, CommandData, Pose2dCommandData, PoseCommandData, VelocityCommandData
from stripe_kernels.mdp import (
    COMMANDS,
    advance_command,
    motion_anchor_position_error,
    motion_body_orientation_error,
    motion_body_position_error,
    motion_joint_position_error,
    orientation_command_error,
    pose_2d_error_heading,
    pose_2d_error_pos,
    position_command_error,
    restart_command,
    velocity_error_xy,
    velocity_error_yaw,
)
from stripe_kernels.mdp import CommandTerm as KnownCommand
from stripe_newton.fusion import Code, HostFunction, Item, NamedStructs, SceneEntityCfg, Section, bind_term, block, code
from stripe_newton.fusion.warp_types import Struct, StructInstance, struct_of
from stripe_newton.matching import match_names

from .command_term import CommandTerm, KernelCommandTerm, view_of
from .commands_cfg import (
    CommandTermCfg,
    MotionCommandCfg,
    NormalVelocityCommandCfg,
    NullCommandCfg,
    UniformPose2dCommandCfg,
    UniformPoseCommandCfg,
    UniformVelocityCommandCfg,
)
from .context import ManagerContext
from .manager_base import ManagerBase, is_warp_term, terms_of
from .motion_command import MODES, MotionCommand, MotionError, motion_robot
from .term_class import make_instance
from .term_params import params_for, unknown_params
from .terrain_checks import check_terrain
from .torch_command import TorchCommand

__all__ = ["CommandManager"]


class CommandStructs(NamedStructs):
    """Resolver of the structs of commands, by ``command_name``."""

    def __init__(self, kind: Struct):
        super().__init__(kind, ["command_name"])


@dataclass
class _Term:
    """A command term: its config, arrays, functions and their arguments."""

    cfg: CommandTermCfg
    data: CommandData
    resample: wp.Function | None
    update: wp.Function | None
    params: dict[str, object]
    metrics: dict[str, wp.Function] = field(default_factory=dict)
    fixed: dict[str, Code] = field(default_factory=dict)
    """Source of arguments that are not parameters."""
    struct: StructInstance | None = None
    """The struct of its kind, where it has one."""

    def functions(self) -> dict[str, wp.Function | None]:
        """All functions by their path below the term's."""
        metrics = {f"metrics.{name}": function for name, function in self.metrics.items()}
        return {"resample": self.resample, "update": self.update, **metrics}


class CommandManager(ManagerBase):
    """Resamples commands at the start of an episode and whenever their time is up.

    All bounds are parameters that a curriculum may change, such as ``commands.base_velocity.ranges.lin_vel_x``.

    ``Metrics/<command>/<metric>`` is ``(1/n) sum_t e_t``, ``n`` the steps in which commands were updated.
    Isaac Lab divides the sum of a velocity's errors by the largest number of steps that a command may last, and logs
    the last error of a pose.
    """

    name = "commands"

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms: dict[str, _Term] = {}
        self._lines: dict[tuple[str, wp.Function], list[Code]] = {}
        self._null: list[str] = []
        self._torch: dict[str, TorchCommand] = {}
        """Terms of a user's class."""
        self._views: dict[str, KernelCommandTerm] = {}
        self._motions: dict[str, MotionCommand] = {}
        """Motions of the motion commands."""
        for name, term in self.terms(cfg, CommandTermCfg).items():
            if isinstance(term, NullCommandCfg):
                self._null.append(name)
            elif term.is_users and term.class_type is not None:
                self._make_torch(name, term, term.class_type)
            else:
                self._terms[name] = self._make(name, term)
                context.config_watch.add(f"commands.{name}", term)
        self._sums = context.array("commands.metrics", float, sum(len(t.metrics) for t in self._terms.values()))
        self._sums_name = context.scope.name("command_metrics", self._sums)
        self._steps_name = context.scope.name("command_steps", context.array("commands.steps", int))

    # -- construction

    def _make(self, name: str, cfg: CommandTermCfg) -> _Term:
        """Make a term: find its functions, allocate its arrays, and collect the arguments."""
        path, known = f"commands.{name}", _known_kind(cfg)
        before = len(self.context.problems)
        term = self._make_data(path, name, cfg, known)
        if known is None and cfg.size < 1:
            self.context.problems.append(f"{path}.size: is {cfg.size}, must be 1 or more")
        if isinstance(cfg, (UniformVelocityCommandCfg, NormalVelocityCommandCfg)):
            self._add_velocity(path, name, term)
        elif isinstance(cfg, UniformPoseCommandCfg):
            self._add_pose(path, name, term)
        elif isinstance(cfg, UniformPose2dCommandCfg):
            self._add_pose_2d(path, name, term)
        elif isinstance(cfg, MotionCommandCfg):
            self._add_motion(path, name, term)
        term.metrics |= cfg.metrics
        self.context.problems += self._function_problems(path, term)
        if len(self.context.problems) == before:
            functions = [f for f in term.functions().values() if f is not None]
            self.context.problems += unknown_params(self.context.structs, path, functions, cfg.params)
            self._add_fields(path, term, functions)
        else:  # do not report problems that follow from the first
            term.resample, term.update, term.metrics = None, None, {}
        return term

    def _make_torch(self, name: str, cfg: CommandTermCfg, class_type: type) -> None:
        """Make the instance of a user's class, and the structs by which Warp terms read its command."""
        path, context = f"commands.{name}", self.context
        if not issubclass(class_type, CommandTerm):
            text = f"is '{class_type.__name__}', must be derived from CommandTerm"
            context.problems.append(f"{path}.class_type: {text}")
            return
        term = self._instances[path] = make_instance(f"{path}.class_type", class_type, cfg, context.env)
        data = _clock(context, path, term.command.shape[1])
        command = self._torch[name] = TorchCommand(context, path, term, data)
        for struct in (data, *command.structs()):
            self._provide(struct, name, data)
        command.copy()

    def instance_states(self) -> list[dict[str, Any]]:
        """Attributes of class terms, and their metrics."""
        return [*super().instance_states(), *(command.term.metrics for command in self._torch.values())]

    def reset_instance_items(self) -> list[Item]:
        """No items: :meth:`reset_items` resets the terms and logs their metrics."""
        return []

    def _make_data(self, path: str, name: str, cfg: CommandTermCfg, known: KnownCommand | None) -> _Term:
        data = _clock(self.context, path, self._size(path, cfg, known))
        self._provide(data, name, data)
        own = known if known is not None else KnownCommand(None, None, cfg.size)
        params = {"asset_cfg": SceneEntityCfg(cfg.asset_name)} | cfg.params
        return _Term(cfg, data, cfg.resample or own.resample, cfg.update or own.update, params)

    def _size(self, path: str, cfg: CommandTermCfg, known: KnownCommand | None) -> int:
        """Number of values of a command."""
        if isinstance(cfg, MotionCommandCfg):
            robot = motion_robot(self.context, path, cfg)
            return 2 * robot.num_joints if robot is not None else 0
        return cfg.size if known is None else known.size

    def _provide(self, struct: StructInstance, name: str, data: CommandData) -> None:
        """Offer a struct of a command to terms by the command's name."""
        counts = {"num_command": data.command.shape[1]}
        self.context.structs.named(struct_of(struct), CommandStructs).add(name, struct, counts)

    def _function_problems(self, path: str, term: _Term) -> Iterator[str]:
        for what, function in term.functions().items():
            if not is_warp_term(function) and (what != "update" or function is not None):
                yield f"{path}.{what}: is {function!r}, must be a Warp function (@wp.func)"
        every = [f for f in term.functions().values() if is_warp_term(f)]
        if any(ArticulationData in f.input_types.values() for f in every):
            try:
                self.context.entity(term.cfg.asset_name)
            except KeyError as error:
                yield f"{path}.asset_name: {error.args[0]}"

    def _add_velocity(self, path: str, name: str, term: _Term) -> None:
        velocity, array = VelocityCommandData(), self.context.array
        velocity.command = term.data.command
        velocity.heading_target = array(f"{path}.heading_target", float)
        velocity.is_heading = array(f"{path}.is_heading", wp.bool)
        velocity.is_standing = array(f"{path}.is_standing", wp.bool)
        self._provide(velocity, name, term.data)
        term.struct = velocity
        term.metrics |= {"error_vel_xy": velocity_error_xy, "error_vel_yaw": velocity_error_yaw}
        if isinstance(term.cfg, UniformVelocityCommandCfg) and not term.cfg.heading_command:
            term.params["rel_heading_envs"] = 0.0

    def _add_pose(self, path: str, name: str, term: _Term) -> None:
        context, cfg, pose = self.context, term.cfg, PoseCommandData()
        assert isinstance(cfg, UniformPoseCommandCfg)
        if cfg.update is None:
            pose.pose = wp.from_torch(context.torch(term.data.command), dtype=wp.transform)
        else:  # its own functions say how the numbers of the command follow from the pose
            pose.pose = context.array(f"{path}.pose", wp.transform)
        self._provide(pose, name, term.data)
        term.struct = pose
        if cfg.asset_name in context.entity_names():
            names = context.asset(cfg.asset_name).data.body_names
            try:
                bodies = match_names(cfg.body_name, names, what=f"body of '{cfg.asset_name}'")[1]
                if len(bodies) > 1:
                    raise ValueError(f"'{cfg.body_name}' matches more than one body, name one of: {', '.join(bodies)}")
            except ValueError as error:
                context.problems.append(f"{path}.body_name: {error}")
        term.params["asset_cfg"] = SceneEntityCfg(cfg.asset_name, body_names=cfg.body_name)
        term.metrics |= {"position_error": position_command_error, "orientation_error": orientation_command_error}
        axes = ("pos_x", "pos_y", "pos_z", "roll", "pitch", "yaw")
        # Bounds stay parameters, which a curriculum may change, and are an array for the function at the same time: the
        # numbers of new parameters lie side by side in memory.
        for axis in axes:
            context.parameters.add(f"{path}.ranges.{axis}", getattr(cfg.ranges, axis), wp.vec2)
        first = context.parameters.reference(f"{path}.ranges.pos_x.0").index
        numbers = context.torch(context.parameters.floats)[first : first + 2 * len(axes)]
        term.params["pose_range"] = wp.from_torch(numbers.view(len(axes), 2), dtype=wp.vec2)

    def _add_pose_2d(self, path: str, name: str, term: _Term) -> None:
        place, array = Pose2dCommandData(), self.context.array
        place.command = term.data.command
        place.pos = array(f"{path}.pos", wp.vec3)
        place.heading = array(f"{path}.heading_w", float)
        self._provide(place, name, term.data)
        term.struct = place
        term.metrics |= {"error_pos_2d": pose_2d_error_pos, "error_heading": pose_2d_error_heading}
        check_terrain(self.context, path, term.resample)

    def _add_motion(self, path: str, name: str, term: _Term) -> None:
        context, cfg = self.context, term.cfg
        assert isinstance(cfg, MotionCommandCfg)
        robot = motion_robot(context, path, cfg)
        if robot is None:
            return  # `_size` has reported the problem
        try:
            motion = MotionCommand(context, path, cfg, robot, term.data)
        except MotionError as error:
            context.problems.append(f"{path}.motion_file: {error}")
            return
        except ValueError as error:
            context.problems.append(f"{path}.anchor_body_name: {error}")
            return
        self._motions[name], term.struct = motion, motion.struct
        self._provide(motion.struct, name, term.data)
        term.params["asset_cfg"] = SceneEntityCfg(cfg.asset_name, body_names=cfg.body_names)
        term.params["sampling_mode"] = MODES[cfg.sampling_mode]
        term.metrics |= {
            "error_anchor_pos": motion_anchor_position_error,
            "error_body_pos": motion_body_position_error,
            "error_body_rot": motion_body_orientation_error,
            "error_joint_pos": motion_joint_position_error,
        }

    def _add_fields(self, path: str, term: _Term, functions: Sequence[wp.Function]) -> None:
        """Give arguments the values of fields of the same name, of the config and of its ``ranges``."""
        cfg, ranges = term.cfg, getattr(term.cfg, "ranges", None)
        for argument, kind in {a: k for f in functions for a, k in f.input_types.items()}.items():
            if argument in term.params:
                continue
            if argument in getattr(ranges, "__dataclass_fields__", ()):
                value = getattr(ranges, argument)
                value = (0.0, 0.0) if value is None else value
                term.fixed[argument] = self.context.parameters.add(f"{path}.ranges.{argument}", value, kind)
            elif argument in cfg.__dataclass_fields__:
                term.params[argument] = getattr(cfg, argument)

    # -- properties

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        there = {*self._terms, *self._torch, *self._null}
        return [name for name in terms_of(self.cfg) if name in there]

    @property
    def torch_terms(self) -> list[str]:
        """Names of the terms that are a user's classes."""
        return list(self._torch)

    def get_command(self, name: str) -> torch.Tensor:
        """The current command of a term, shape ``(num_envs, n)``.

        Raises:
            KeyError: if there is no such term.
        """
        if name in self._null:
            raise KeyError(f"command '{name}' is a NullCommand, which has no numbers")
        if name in self._terms:
            return self.context.torch(self._terms[name].data.command)
        return self.get_term(name).command

    def get_term(self, name: str) -> CommandTerm:
        """A term: the instance of a user's class, or the view of a term of kernels, whose ``cfg`` may be changed.

        Raises:
            KeyError: if there is no such term.
        """
        if name in self._torch:
            return self._torch[name].term
        if name not in self._terms:
            raise KeyError(f"no command '{name}'; there is {', '.join([*self._terms, *self._torch]) or 'none'}")
        if name not in self._views:
            term = self._terms[name]
            self._views[name] = view_of(term.cfg, self.context, term.data, term.struct)
        self.context.config_watch.hand_out(f"commands.{name}")
        return self._views[name]

    # -- between steps

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Sample new commands in some environments; None means all of them."""
        self._outside.run_in("commands", self.reset_items, env_ids)

    # -- items

    def compute_items(self) -> list[Item]:
        """Items that run in every step: clocks, resampling where it is due, updates, metrics."""
        context, metric = self.context, 0
        body = [code("{steps}[env] = {steps}[env] + 1", steps=self._steps_name)] if self._terms else []
        dt = context.parameters.add("step_dt", context.step_dt, float)
        for name, term in self._terms.items():
            data, rng = context.scope.name(f"{name}_clock", term.data), context.code("{rng}")
            due = context.scope.call(advance_command, "env", data, rng, self._span(name, term), dt)
            body += block(code("if {}:", due), self._call(name, term, term.resample))
            body += self._call(name, term, term.update)
            for what, func in term.metrics.items():
                line = self._call(name, term, func, f"{name}.{what}", "metric")
                body += [code("{}[env, {}] += {}", self._sums_name, metric, line[0])] if line else []
                metric += 1
        section: list[Item] = [Section("commands", body, list(self._terms))] if body else []
        section += [item for motion in self._motions.values() for item in motion.items()]
        return [*section, *(self._eager(name, self._compute_torch) for name in self._torch)]

    def _eager(self, name: str, run: Callable[[str], None]) -> HostFunction:
        """Item that runs something of a user's class on the host."""
        return HostFunction("commands", partial(run, name), f"torch term '{name}'", [name])

    def _compute_torch(self, name: str) -> None:
        self._torch[name].term.compute(self.context.step_dt)
        self._torch[name].copy()

    def _reset_torch(self, name: str) -> None:
        env_ids = self.context.reset_mask.indices()
        if not len(env_ids):
            return
        for metric, value in self._torch[name].term.reset(env_ids).items():
            self.context.log_now(f"Metrics/{name}/{metric}", value)
        self._torch[name].copy()

    def reset_items(self) -> list[Item]:
        """Items that log the metrics, as means over the steps of the episode, and sample the first command."""
        context, steps, metric = self.context, self._steps_name, 0
        body = [code("steps = float(wp.max({}[env], 1))", steps), code("{}[env] = 0", steps)]
        for name, term in self._terms.items():
            for what in term.metrics:
                sum_ = code("{}[env, {}]", self._sums_name, metric)
                body.append(context.log.line(f"Metrics/{name}/{what}", code("{} / steps", sum_)))
                body.append(code("{} = 0.0", sum_))
                metric += 1
            data, rng = context.scope.name(f"{name}_clock", term.data), context.code("{rng}")
            body.append(context.scope.call(restart_command, "env", data, rng, self._span(name, term)))
            body += [*self._call(name, term, term.resample), *self._call(name, term, term.update)]
        own = [Section("commands_reset", body, list(self._terms)).only(context.is_reset)] if self._terms else []
        return [*own, *(self._eager(name, self._reset_torch) for name in self._torch)]

    def _span(self, name: str, term: _Term) -> Code:
        """Bounds of the time from one command to the next [s], as a parameter."""
        path = f"commands.{name}.resampling_time_range"
        return self.context.parameters.add(path, term.cfg.resampling_time_range, wp.vec2)

    def _call(
        self, name: str, term: _Term, func: wp.Function | None, where: str | None = None, kind: str = "command"
    ) -> list[Code]:
        """The line that calls a function of a term; none without such a function or after problems."""
        if func is None:
            return []
        place = f"commands.{where or name}"
        if (place, func) not in self._lines:
            params = self._own_structs(name, func) | params_for(self.context.structs, func, term.params)
            call = bind_term(self.context, func, params, place, kind, term.fixed)
            self._lines[place, func] = [call.expression()] if call is not None else []
        return self._lines[place, func]

    def _own_structs(self, name: str, func: wp.Function) -> dict[str, object]:
        """Parameters by which a function gets the structs of its own command."""
        own, given = dict[str, object](), self._terms[name].params.keys()
        for argument, kind in func.input_types.items():
            resolver = self.context.structs.resolver(kind)
            if isinstance(resolver, NamedStructs) and name in resolver.structs:
                own |= {} if given & set(resolver.parameters(argument)) else {argument: name}
        return own

    def __str__(self) -> str:
        every = [(name, t.cfg, t.data) for name, t in self._terms.items()]
        every += [(name, command.term.cfg, command.data) for name, command in self._torch.items()]
        rows = [
            (i, name, type(cfg).__name__.removesuffix("Cfg"), data.command.shape[1], cfg.resampling_time_range)
            for i, (name, cfg, data) in enumerate(every)
        ]
        return self.table("Command terms", ("Index", "Name", "Type", "Size", "Resampled after [s]"), rows)


def _clock(context: ManagerContext, path: str, size: int) -> CommandData:
    """Arrays of a command: its ``size`` numbers, the time left until the next one, and how many there were."""
    data = CommandData()
    data.command = context.array(f"{path}.command", float, size)
    data.time_left = context.array(f"{path}.time_left", float)
    data.counter = context.array(f"{path}.counter", int)
    return data


def _known_kind(cfg: CommandTermCfg) -> KnownCommand | None:
    """Functions and size of a command of the package; subclasses of its config are of the same kind."""
    kinds = [c.__name__.removesuffix("Cfg") for c in type(cfg).__mro__]
    return next((COMMANDS[kind] for kind in kinds if kind in COMMANDS), None)
