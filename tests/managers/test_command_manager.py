# SPDX-License-Identifier: Apache-2.0
"""Command manager: command terms against NumPy references that draw the same numbers, over episodes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import CommandData, PoseCommandData, VelocityCommandData
from stripe_newton.configclass import configclass
from stripe_newton.envs import mdp as cfgs
from stripe_newton.fusion import KernelLaunches, Section, bind_term, code
from stripe_newton.managers import CommandManager
from tests.helpers import term_reference, term_reference_random
from tests.helpers.command_terms import drawn, normal_velocity, own, pose, pose_2d, velocity
from tests.helpers.manager_world import manager_context, plan, set_reset
from tests.helpers.term_reference_random import Stream

N, DT = 4, 1.0 / 60.0


class World:
    """A command manager on a robot in a random state."""

    def __init__(self, terms: Any, num_envs: int = N, seed: int = 3):
        self.context = context = manager_context(num_envs, seed=seed)
        self.num_envs = num_envs
        self.robot = context.entity("robot").data.struct
        self.scatter()
        self.manager = CommandManager(terms, context)
        items = self.manager.compute_items(), self.manager.reset_items()
        assert not context.problems, context.problems
        self._compute, self._reset = (plan(context, i, [KernelLaunches("log", context.log.finish)]) for i in items)

    def scatter(self, seed: int = 0) -> None:
        """Another state of the robot."""
        draw = np.random.default_rng(seed)
        for name in ("root_pose", "root_vel", "body_pose", "env_origin"):
            view = self.context.torch(getattr(self.robot, name))
            rows = draw.normal(size=(16, *view.shape[1:]))[: self.num_envs]
            view[:] = torch.as_tensor(rows, dtype=torch.float32)
            if view.shape[-1] == 7:
                view[..., 3:] /= view[..., 3:].norm(dim=-1, keepdim=True)

    def compute(self) -> None:
        self._compute.run()

    def reset(self, *envs: int) -> dict[str, float]:
        set_reset(self.context, [i in envs for i in range(self.num_envs)])
        self._reset.run()
        return dict(zip(self.context.log.keys, self.context.log.values.numpy().tolist(), strict=False))

    def values(self) -> dict[str, Any]:
        names = "root_pose", "root_vel", "body_pose", "env_origin", "default_root_pose"
        found = {"ArticulationData": {n: getattr(self.robot, n).numpy().astype(float) for n in names}}
        for kind, structs in self.context.structs.provided.items():
            fields = {n: getattr(s, n) for s in structs.values() for n in kind.vars}
            found[kind.key.rpartition(".")[2]] = {n: a.numpy() for n, a in fields.items()}
        return found

    def array(self, name: str) -> np.ndarray:
        return self.context.arrays[f"commands.{name}"].numpy()


UNIFORM = {
    "lin_vel_x": (-1.0, 1.5),
    "lin_vel_y": (-0.5, 0.5),
    "ang_vel_z": (-1.0, 0.7),
    "heading": (-3.0, 3.0),
    "rel_standing_envs": 0.2,
    "rel_heading_envs": 0.6,
    "heading_control_stiffness": 0.5,
}
NORMAL = {"mean_vel": (0.5, 0.0, 1.0), "std_vel": (0.1, 0.2, 0.0), "zero_prob": (0.1, 0.0, 0.5)}
POSE = [(-0.5, 0.5), (0.25, 0.25), (0.0, 0.3), (-0.7, 0.7), (-1.5, 1.5), (-3.1, 3.1)]
PLACE = {"pos_x": (-3.0, 3.0), "pos_y": (-2.0, 1.0), "heading": (-3.0, 3.0)}

CASES: dict[str, tuple[Any, str, dict[str, Any]]] = {
    "uniform velocity": (velocity(), "uniform_velocity", UNIFORM),
    "uniform velocity without heading": (
        velocity(heading_command=False), "uniform_velocity", UNIFORM | {"rel_heading_envs": 0.0},
    ),
    "normal velocity": (normal_velocity(), "normal_velocity", NORMAL | {"rel_standing_envs": 0.2}),
    "pose": (pose(make_quat_unique=True), "uniform_pose", {"pose_range": POSE, "make_quat_unique": True}),
    "pose 2d": (pose_2d(), "uniform_pose_2d", PLACE | {"simple_heading": False}),
    "pose 2d, simple heading": (
        pose_2d(simple_heading=True), "uniform_pose_2d", PLACE | {"simple_heading": True},
    ),
}  # fmt: skip


def _result(function: Any) -> Any:
    return lambda v, p: function(v, p, None)["result"][""]


ERRORS: dict[str, dict[str, Any]] = {
    "velocity": {
        "error_vel_xy": _result(term_reference_random.velocity_error_xy),
        "error_vel_yaw": _result(term_reference_random.velocity_error_yaw),
    },
    "pose": {
        "position_error": term_reference.position_command_error,
        "orientation_error": term_reference.orientation_command_error,
    },
    "pose_2d": {
        "error_pos_2d": _result(term_reference_random.pose_2d_error_pos),
        "error_heading": _result(term_reference_random.pose_2d_error_heading),
    },
}


class Reference:
    """The same commands with NumPy, drawn from the same streams, environment by environment as they fall due."""

    def __init__(self, world: World, kind: str, params: dict[str, Any], seed: int = 3):
        self.world, self.kind = world, kind
        self.params = params | {"step_dt": DT, "resampling_time_range": (0.04, 0.09), "body_ids": [6]}
        self.stream = Stream(seed, world.num_envs)
        self.values = world.values()
        self.errors = ERRORS[kind.partition("_")[2]]
        self.samples: list[list[dict[str, float]]] = [[] for _ in range(world.num_envs)]

    def _write(self, written: dict[str, Any], where: np.ndarray) -> None:
        for struct, fields in written.items():
            for name, new in fields.items():
                old = self.values[struct][name]
                mask = where.reshape(-1, *[1] * (np.ndim(new) - 1))
                self.values[struct][name] = np.where(mask, new, old)

    def _function(self, name: str, where: np.ndarray, params: dict[str, Any] | None = None) -> Any:
        """Write what a reference function writes; the streams of the other environments stay."""
        before = self.stream.n.copy()
        written = getattr(term_reference_random, name)(self.values, params or self.params, self.stream)
        self.stream.n = np.where(where, self.stream.n, before)
        result = written.pop("result", {}).get("")
        self._write(written, where)
        return result

    def reset(self, *envs: int) -> dict[str, float]:
        """Mean over the environments of the means over their episodes."""
        where = np.isin(np.arange(self.world.num_envs), envs)
        means = {k: np.mean([np.mean([s[k] for s in self.samples[e]] or 0.0) for e in envs]) for k in self.errors}
        self._function("restart_command", where)
        self._function(f"resample_{self.kind}", where)
        for env in envs:
            self.samples[env] = []
        return means

    def compute(self) -> None:
        robot = self.world.values()["ArticulationData"]
        self.values["ArticulationData"] = robot
        everyone = np.ones(self.world.num_envs, dtype=bool)
        due = self.values["CommandData"]["time_left"] - DT <= 0.0
        assert (self._function("advance_command", everyone) == due).all()
        self._function(f"resample_{self.kind}", due)
        if hasattr(term_reference_random, f"update_{self.kind}"):
            self._function(f"update_{self.kind}", everyone)
        if self.kind == "uniform_pose":
            self.values["CommandData"]["command"] = self.values["PoseCommandData"]["pose"]
        found = {k: error(self.values, self.params) for k, error in self.errors.items()}
        for env, samples in enumerate(self.samples):
            samples.append({k: v[env] for k, v in found.items()})


@pytest.mark.parametrize("case", CASES)
def test_commands_and_metrics_are_those_of_the_reference(case):
    cfg, kind, params = CASES[case]
    world = World({"goal": cfg})
    expected = Reference(world, kind, params)
    for step in range(12):
        if step in (0, 4, 9):
            envs = [range(N), (1, 3), (0, 1)][step // 4]
            log, means = world.reset(*envs), expected.reset(*envs)
            for name, mean in means.items():
                np.testing.assert_allclose(log[f"Metrics/goal/{name}"], mean, rtol=1e-4, atol=1e-5, err_msg=name)
        world.scatter(step)
        world.compute()
        expected.compute()
        now = world.values()
        for struct, fields in expected.values.items():
            for name, value in fields.items():
                np.testing.assert_allclose(now[struct][name], value, rtol=1e-4, atol=1e-5, err_msg=f"{struct}.{name}")
    command = {"uniform_pose": now.get("PoseCommandData", {}).get("pose")}.get(kind, now["CommandData"]["command"])
    np.testing.assert_array_equal(world.manager.get_command("goal").numpy(), command)


# -- behaviour


def test_own_command_is_drawn_at_the_reset_and_when_its_time_is_up():
    world = World({"own": own()})
    assert world.manager.get_command("own").shape == (N, 3)
    world.reset(*range(N))
    np.testing.assert_allclose(world.array("own.time_left"), 0.095, rtol=1e-6)
    counts = []
    for _ in range(13):  # a command lasts 6 steps of 1/60 s
        world.compute()
        counts.append(int(world.array("own.counter")[0]))
        command = world.manager.get_command("own").numpy()
        np.testing.assert_array_equal(command[:, 0], 2.0 * counts[-1])
        np.testing.assert_array_equal(command[:, 2], world.array("own.time_left"))
    assert counts == [1] * 5 + [2] * 6 + [3] * 2
    log = world.reset(0, 2)
    assert log["Metrics/own/drawn"] == pytest.approx(10.0 * np.mean(counts))
    np.testing.assert_array_equal(world.array("own.counter"), [1, 3, 1, 3])
    world.compute()
    world.compute()
    log = world.reset(2, 3)  # 2 steps with one command; 15 steps, the last two with the third
    assert log["Metrics/own/drawn"] == pytest.approx(10.0 * np.mean([1.0, (sum(counts) + 6) / 15]))


def test_times_between_draws_cover_their_range():
    world = World({"goal": velocity(resampling_time_range=(0.5, 2.0))}, num_envs=16)
    drawn_times = []
    for _ in range(20):
        world.reset(*range(16))
        drawn_times += world.array("goal.time_left").tolist()
    assert 0.5 <= min(drawn_times) < 0.55
    assert 1.95 < max(drawn_times) < 2.0
    assert np.mean(drawn_times) == pytest.approx(1.25, abs=5 * 1.5 / math.sqrt(12 * 320))


def test_share_that_stands_gets_no_command():
    world = World({"goal": velocity(rel_standing_envs=0.25, rel_heading_envs=0.5)}, num_envs=16)
    standing, heading = [], []
    for _ in range(25):
        world.reset(*range(16))
        world.compute()
        standing.append(world.array("goal.is_standing"))
        heading.append(world.array("goal.is_heading"))
        command = world.manager.get_command("goal").numpy()
        np.testing.assert_array_equal((command == 0.0).all(axis=1), standing[-1])
    for share, flags in ((0.25, standing), (0.5, heading)):
        assert np.mean(flags) == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / 400))


def test_heading_is_reached_by_turning_as_told():
    cfg = velocity(rel_standing_envs=0.0, rel_heading_envs=1.0, resampling_time_range=(100.0, 100.0))
    world = World({"goal": cfg})
    world.reset(*range(N))
    target = world.array("goal.heading_target")
    pose = world.context.torch(world.robot.root_pose)
    yaw = np.array([3.0, -3.0, 0.0, 1.5])
    for _ in range(2000):
        pose[:, 3:] = torch.as_tensor(np.stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1))
        world.compute()
        rate = world.manager.get_command("goal").numpy()[:, 2]
        assert (rate >= -1.0).all()
        assert (rate <= 0.7).all()
        yaw = yaw + rate * DT
    np.testing.assert_allclose(np.cos(yaw - target), 1.0, atol=1e-5)


def test_draws_do_not_depend_on_the_number_of_environments_and_repeat():
    terms = {"a": velocity(), "b": pose_2d(), "c": pose()}
    few, many, again = (World(terms, n) for n in (3, 7, 3))
    for step in range(8):
        for world in (few, many, again):
            if step in (0, 3):
                world.reset(*range(step // 3, 2), 2)
            world.compute()
        for name in terms:
            shown = few.manager.get_command(name).numpy()
            np.testing.assert_array_equal(shown, many.manager.get_command(name).numpy()[:3])
            np.testing.assert_array_equal(shown, again.manager.get_command(name).numpy())
    other = World(terms, 3, seed=4)
    other.reset(0, 1, 2)
    other.compute()
    assert not np.array_equal(other.manager.get_command("a").numpy(), few.manager.get_command("a").numpy())


# -- what may change while it runs, and what others read


def test_bounds_are_parameters_that_may_change():
    world = World({"base_velocity": velocity(rel_standing_envs=0.0, heading_command=False), "hand": pose()})
    parameters = world.context.parameters
    parameters["commands.base_velocity.ranges.lin_vel_x"] = (7.0, 7.0)
    parameters["commands.hand.ranges.pos_z"] = (5.0, 5.0)
    parameters["commands.hand.ranges.yaw"] = (0.0, 0.0)
    parameters["commands.hand.ranges.roll"] = (0.0, 0.0)
    parameters["commands.hand.ranges.pitch"] = (math.pi / 2, math.pi / 2)
    parameters["commands.hand.resampling_time_range"] = (9.0, 9.0)
    world.reset(*range(N))
    np.testing.assert_array_equal(world.manager.get_command("base_velocity").numpy()[:, 0], 7.0)
    np.testing.assert_array_equal(world.array("hand.time_left"), 9.0)
    hand = world.manager.get_command("hand").numpy()
    np.testing.assert_array_equal(hand[:, 2], 5.0)
    np.testing.assert_allclose(hand[:, 3:], [[0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)]] * N, atol=1e-6)
    parameters["commands.base_velocity.rel_standing_envs"] = 1.0
    world.reset(*range(N))
    world.compute()
    np.testing.assert_array_equal(world.manager.get_command("base_velocity").numpy(), 0.0)


@wp.func
def seen_by_kind(env: int, a: CommandData, b: VelocityCommandData, c: PoseCommandData, out: wp.array[float]):
    out[0] = a.command[env, 0]
    out[1] = b.command[env, 0]
    out[2] = c.pose[env][6]
    out[3] = float(a.command.shape[1])


def test_terms_read_commands_by_name_and_kind():
    world = World({"walk": velocity(), "hand": pose()})
    context = world.context
    call = bind_term(context, seen_by_kind, {"a_name": "hand"}, "observations.policy.seen", "observation")
    shown = bind_term(context, mdp.generated_commands, {"command_name": "walk"}, "observations.policy.c", "observation")
    assert shown.counts["num_command"] == 3
    out = context.array("out", float, 4)
    reader = plan(context, [Section("read", [call.expression(code("{}[env]", context.scope.name("out", out)))])])
    world.reset(*range(N))
    world.compute()
    reader.run()
    walk, hand = (world.manager.get_command(n).numpy() for n in ("walk", "hand"))
    np.testing.assert_array_equal(out.numpy(), np.stack([hand[:, 0], walk[:, 0], hand[:, 6], 0 * hand[:, 0] + 7], 1))


def test_null_command_has_no_numbers():
    world = World({"nothing": cfgs.NullCommandCfg(), "off": None, "walk": velocity()})
    assert world.manager.active_terms == ["nothing", "walk"]
    with pytest.raises(KeyError, match="'nothing' is a NullCommand"):
        world.manager.get_command("nothing")
    with pytest.raises(KeyError, match="no command 'run'; there is walk"):
        world.manager.get_command("run")
    alone = CommandManager({"nothing": cfgs.NullCommandCfg()}, manager_context(2))
    assert alone.compute_items() == alone.reset_items() == []


def test_table_shows_kind_size_and_time():
    text = str(World({"walk": velocity(), "hand": pose()}).manager)
    for part in ("walk", "UniformVelocityCommand", "3", "(0.04, 0.09)", "hand", "UniformPoseCommand", "7"):
        assert part in text


# -- subclasses


@wp.func
def always_forward(env: int, command: VelocityCommandData, lin_vel_x: wp.vec2, factor: float):
    command.command[env, 0] = factor * lin_vel_x[1]


@configclass
class ForwardCommandCfg(cfgs.UniformVelocityCommandCfg):
    factor: float = 2.0


def test_subclass_of_a_config_is_of_its_kind_and_may_have_own_functions_and_fields():
    ranges = velocity().ranges
    forward = ForwardCommandCfg(
        resampling_time_range=(1.0, 1.0), ranges=ranges, resample=always_forward, metrics={"drawn": drawn}
    )
    world = World({"plain": ForwardCommandCfg(resampling_time_range=(1.0, 1.0), ranges=ranges),
                   "forward": forward.replace(params={"scale": 3.0})})  # fmt: skip
    world.reset(*range(N))
    np.testing.assert_array_equal(world.manager.get_command("forward").numpy(), [[3.0, 0.0, 0.0]] * N)
    assert (world.manager.get_command("plain").numpy()[:, :2] != 0.0).all()
    world.context.parameters["commands.forward.factor"] = 4.0
    world.reset(*range(N))
    np.testing.assert_array_equal(world.manager.get_command("forward").numpy()[:, 0], 6.0)
    world.compute()
    log = world.reset(0)
    assert {k for k in log if "forward" in k} == {
        "Metrics/forward/error_vel_xy", "Metrics/forward/error_vel_yaw", "Metrics/forward/drawn",
    }  # fmt: skip
    assert log["Metrics/forward/drawn"] == 3.0


@pytest.mark.parametrize("cfg", [c for c, *_ in CASES.values()])
def test_good_configs_are_let_through(cfg):
    cfg.validate()
