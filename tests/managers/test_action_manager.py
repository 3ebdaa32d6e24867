# SPDX-License-Identifier: Apache-2.0
"""Action manager: action terms against NumPy references, over steps and resets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ActionData, ArticulationData
from stripe_kernels.mdp import ACTIONS
from stripe_newton.envs import mdp as cfgs
from stripe_newton.fusion import Section, bind_term, code
from stripe_newton.managers import ActionManager, ActionTermCfg, ManagerContext
from stripe_newton.noise import ConstantNoiseCfg, GaussianNoiseCfg, NoiseCfg, UniformNoiseCfg
from tests.helpers import term_reference_random as reference
from tests.helpers.manager_world import manager_context, plan, set_reset

N = 4
INF = np.inf
LEGS = ["front_left_leg", "front_right_leg", "left_back_leg", "right_back_leg"]
TARGETS = "joint_pos_target", "joint_vel_target", "joint_effort_target"
DRAWN = "joint_pos", "joint_vel", "default_joint_pos", "default_joint_vel", "body_pose", *TARGETS
FIELDS = *DRAWN, "joint_pos_lower", "joint_pos_upper", "root_pose"


class World:
    """An action manager on a robot in a random state."""

    def __init__(self, terms: Any, num_envs: int = N, seed: int = 3):
        self.context = context = manager_context(num_envs, seed=seed)
        self.robot = context.entity("robot").data.struct
        draw = np.random.default_rng(seed)
        for name in DRAWN:
            array = getattr(self.robot, name)
            view = context.torch(array)
            view[:] = torch.as_tensor(draw.normal(size=tuple(view.shape)), dtype=torch.float32)
        poses = context.torch(self.robot.body_pose)
        poses[..., 3:] /= poses[..., 3:].norm(dim=-1, keepdim=True)
        self.manager = ActionManager(terms, context)
        self.process_items, self.apply_items, self.reset_items = (
            self.manager.process_items(), self.manager.apply_items(), self.manager.reset_items(),
        )  # fmt: skip
        assert not context.problems, context.problems
        self._process, self._apply, self._reset = (
            plan(context, items) for items in (self.process_items, self.apply_items, self.reset_items)
        )

    def step(self, action: Any) -> None:
        self.context.torch(self.manager.input)[:] = torch.as_tensor(action)
        self._process.run()

    def substep(self) -> None:
        self._apply.run()

    def reset(self, *envs: int) -> None:
        set_reset(self.context, [i in envs for i in range(self.context.num_envs)])
        self._reset.run()

    def values(self) -> dict[str, Any]:
        """The state in float64, as the references take it."""
        found = {n: getattr(self.robot, n).numpy().astype(float) for n in FIELDS}
        return {"ArticulationData": found | {"soft_limit_factor": self.robot.soft_limit_factor}}

    def processed(self, name: str) -> np.ndarray:
        return self.context.arrays[f"actions.{name}.processed"].numpy()


def bounds(*pairs: tuple[float, float]) -> np.ndarray:
    return np.array(pairs)


FREE = bounds(*[(-INF, INF)] * 4)
SCALES = {"front_.*": 0.5, "left_back_leg": -2.0}
SCALE = np.array([0.5, 0.5, -2.0, 1.0])
CLIP = {"front_left_.*": (-0.2, 0.3), "right_back_leg": (0.1, INF)}
LIMITS = bounds((-0.2, 0.3), (-INF, INF), (-INF, INF), (0.1, INF))
OPEN, CLOSE = {"front_.*": 0.4, ".*back.*": -0.1}, {".*leg": 0.2}
GRIPPER = {"open_command": np.array([0.4, 0.4, -0.1, -0.1]), "close_command": np.full(4, 0.2)}
BASE = {
    "body_name": "torso",
    "x_joint_name": "left_back_foot",
    "y_joint_name": "front_left_leg",
    "yaw_joint_name": "right_back_leg",
}

CASES: dict[str, tuple[Any, dict[str, Any]]] = {
    "JointPosition": (
        cfgs.JointPositionActionCfg(asset_name="robot", joint_names=LEGS, scale=SCALES, clip=CLIP),
        {"scale": SCALE, "clip": LIMITS, "use_default_offset": True},
    ),
    "JointPosition with offset": (
        cfgs.JointPositionActionCfg(
            asset_name="robot", joint_names=[".*leg"], use_default_offset=False, offset={"left.*": 0.7}
        ),
        {"scale": 1.0, "offset": np.array([0.0, 0.0, 0.7, 0.0]), "clip": FREE, "use_default_offset": False},
    ),
    "RelativeJointPosition": (
        cfgs.RelativeJointPositionActionCfg(asset_name="robot", joint_names=LEGS, scale=0.1, clip=CLIP),
        {"scale": 0.1, "offset": 0.0, "clip": LIMITS},
    ),
    "RelativeJointPosition with offset": (
        cfgs.RelativeJointPositionActionCfg(joint_names=LEGS, use_zero_offset=False, offset=0.3),
        {"scale": 1.0, "offset": 0.3, "clip": FREE},
    ),
    "JointVelocity": (
        cfgs.JointVelocityActionCfg(asset_name="robot", joint_names=LEGS, scale=2.0),
        {"scale": 2.0, "clip": FREE, "use_default_offset": True},
    ),
    "JointEffort": (
        cfgs.JointEffortActionCfg(asset_name="robot", joint_names=LEGS, scale=15.0, offset=-1.0),
        {"scale": 15.0, "offset": -1.0, "clip": FREE},
    ),
    "JointPositionToLimits": (
        cfgs.JointPositionToLimitsActionCfg(asset_name="robot", joint_names=LEGS, scale=0.5, clip=CLIP),
        {"scale": 0.5, "clip": LIMITS, "rescale_to_limits": True},
    ),
    "JointPositionToLimits without": (
        cfgs.JointPositionToLimitsActionCfg(joint_names=LEGS, rescale_to_limits=False),
        {"scale": 1.0, "clip": FREE, "rescale_to_limits": False},
    ),
    "EMAJointPositionToLimits": (
        cfgs.EMAJointPositionToLimitsActionCfg(joint_names=LEGS, scale=0.5, alpha={"front.*": 0.2}),
        {"scale": 0.5, "clip": FREE, "rescale_to_limits": True, "alpha": np.array([0.2, 0.2, 1.0, 1.0])},
    ),
    "BinaryJointPosition": (
        cfgs.BinaryJointPositionActionCfg(joint_names=LEGS, open_command_expr=OPEN, close_command_expr=CLOSE),
        {**GRIPPER, "clip": FREE},
    ),
    "BinaryJointVelocity": (
        cfgs.BinaryJointVelocityActionCfg(
            joint_names=LEGS, open_command_expr=OPEN, close_command_expr=CLOSE, clip={".*": (-0.05, 0.3)}
        ),
        {**GRIPPER, "clip": bounds(*[(-0.05, 0.3)] * 4)},
    ),
    "NonHolonomic": (
        cfgs.NonHolonomicActionCfg(
            asset_name="robot",
            **BASE,
            scale=(2.0, -1.0),
            offset=(0.1, 0.2),
            clip={"left_back_foot": (-0.5, 0.5), "right_back_leg": (-0.3, 9.0)},
        ),
        {
            "scale": np.array([2.0, -1.0]),
            "offset": np.array([0.1, 0.2]),
            "clip": bounds((-0.5, 0.5), (-0.3, 9.0)),
            "joint_ids": [5, 0, 6],
        },
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_targets_are_those_of_the_reference(case):
    cfg, params = CASES[case]
    kind = ACTIONS[case.split()[0]]
    world = World({"term": cfg})
    world.reset(*range(N))
    draw = np.random.default_rng(1)
    before = world.values()
    params = {"joint_ids": [0, 2, 4, 6], "body_ids": [0], "processed": np.zeros((N, 4))} | params
    if kind.reset is not None:
        params["processed"] = reference.ACTIONS[kind.reset.func.__name__](before, params, None)["processed"][""]
    for _ in range(2):
        params["action"] = draw.normal(size=(N, world.manager.total_action_dim)).astype(np.float32)
        world.step(params["action"])
        world.substep()
        params["processed"] = reference.ACTIONS[kind.process.func.__name__](before, params, None)["processed"][""]
        np.testing.assert_allclose(world.processed("term"), params["processed"], rtol=1e-5, atol=1e-6)
    expected = dict(before["ArticulationData"])
    expected |= reference.ACTIONS[kind.apply.func.__name__](before, params, None)["ArticulationData"]
    for name in FIELDS:  # what no term writes stays as it is
        after = getattr(world.robot, name).numpy()
        np.testing.assert_allclose(after, expected[name], rtol=1e-5, atol=1e-6, err_msg=name)


def test_terms_share_the_actions_in_the_order_of_the_config():
    world = World(
        {
            "feet": cfgs.JointEffortActionCfg(joint_names=["right_back_foot", "front.*foot"], preserve_order=True),
            "nothing": None,
            "grip": cfgs.BinaryJointVelocityActionCfg(
                joint_names=["left_back_foot"], open_command_expr={".*": 1.0}, close_command_expr={".*": -1.0}
            ),
            "legs": cfgs.JointPositionActionCfg(joint_names=LEGS, use_default_offset=False),
        }
    )
    manager = world.manager
    assert manager.active_terms == ["feet", "grip", "legs"]
    assert (manager.total_action_dim, manager.action_term_dim) == (8, [3, 1, 4])
    assert world.manager.action_spans == {"feet": (0, 3), "grip": (3, 1), "legs": (4, 4)}
    assert [line.split() for line in str(manager).splitlines()[3:]] == [
        ["0", "feet", "3"], ["1", "grip", "1"], ["2", "legs", "4"],
    ]  # fmt: skip
    action = np.random.default_rng(1).normal(size=(N, 8)).astype(np.float32)
    world.step(action)
    np.testing.assert_array_equal(world.robot.joint_effort_target.numpy()[:, [7, 1, 3]], action[:, :3])
    np.testing.assert_array_equal(world.robot.joint_vel_target.numpy()[:, 5], np.where(action[:, 3] < 0, -1, 1))
    np.testing.assert_array_equal(world.robot.joint_pos_target.numpy()[:, ::2], action[:, 4:])
    processed = np.concatenate([world.processed(n) for n in manager.active_terms], axis=1)
    np.testing.assert_array_equal(manager.processed_actions.numpy(), processed)


def test_only_what_depends_on_the_state_runs_before_each_physics_step():
    world = World(
        {
            "legs": cfgs.JointPositionActionCfg(joint_names=LEGS),
            "feet": cfgs.RelativeJointPositionActionCfg(joint_names=[".*foot"]),
        }
    )
    assert [list(i.terms) for i in world.apply_items] == [["feet"]]
    target = world.robot.joint_pos_target.numpy().copy()
    world.step(np.full((N, 8), 0.25))
    feet = [1, 3, 5, 7]
    np.testing.assert_array_equal(world.robot.joint_pos_target.numpy()[:, feet], target[:, feet])
    for shift in (0.0, 1.0):
        world.context.torch(world.robot.joint_pos)[:] += shift
        world.substep()
        there = world.robot.joint_pos.numpy()[:, feet]
        np.testing.assert_allclose(world.robot.joint_pos_target.numpy()[:, feet], there + 0.25, rtol=1e-6)


@pytest.mark.parametrize("relative_first", [True, False])
def test_of_two_terms_on_a_joint_the_later_one_holds(relative_first):
    both = {
        "relative": cfgs.RelativeJointPositionActionCfg(joint_names=["front.*"]),
        "absolute": cfgs.JointPositionActionCfg(joint_names=["front_left_leg"], use_default_offset=False),
    }
    world = World(both if relative_first else dict(reversed(both.items())))
    world.step(np.full((N, 5), 0.5))
    world.substep()
    expected = 0.5 if relative_first else world.robot.joint_pos.numpy()[:, 0] + 0.5
    np.testing.assert_allclose(world.robot.joint_pos_target.numpy()[:, 0], expected, rtol=1e-6)


def test_terms_that_meet_on_a_joint_are_not_spread_over_threads():
    legs = cfgs.JointPositionActionCfg(joint_names=LEGS)
    apart = World({"a": legs, "b": cfgs.JointEffortActionCfg(joint_names=LEGS)})
    meet = World({"a": legs, "b": cfgs.JointPositionToLimitsActionCfg(joint_names=["front.*"])})
    assert [i.parts for i in apart.process_items] == [8]
    assert [i.parts for i in meet.process_items] == [0]


# -- last action and the one before


@wp.func
def copy_both(env: int, actions: ActionData, out: wp.array[float]):
    for i in range(actions.action.shape[1]):
        out[2 * i] = actions.action[env, i]
        out[2 * i + 1] = actions.prev_action[env, i]


@pytest.mark.parametrize("delay", [0, 1], ids=["side by side", "one thread"])
def test_previous_action_is_that_of_the_step_before_and_zero_after_a_reset(delay):
    world = World({"legs": cfgs.JointEffortActionCfg(joint_names=LEGS, delay_max_lag=delay)})
    a, b, c = np.random.default_rng(2).normal(size=(3, N, 4)).astype(np.float32)
    for before, now in ((np.zeros_like(a), a), (a, b)):
        world.step(now)
        np.testing.assert_array_equal(world.manager.action.numpy(), now)
        np.testing.assert_array_equal(world.manager.prev_action.numpy(), before)
    world.reset(1, 3)
    ended = np.array([False, True, False, True])[:, None]
    np.testing.assert_array_equal(world.manager.action.numpy(), np.where(ended, 0.0, b))
    np.testing.assert_array_equal(world.manager.prev_action.numpy(), np.where(ended, 0.0, a))
    world.step(c)
    np.testing.assert_array_equal(world.manager.action.numpy(), c)
    np.testing.assert_array_equal(world.manager.prev_action.numpy(), np.where(ended, 0.0, b))


def test_a_term_reads_all_actions_or_those_of_one_action_term():
    world = World(
        {
            "legs": cfgs.JointEffortActionCfg(joint_names=LEGS),
            "feet": cfgs.JointEffortActionCfg(joint_names=["front.*foot"]),
        }
    )
    context, outs, lines = world.context, {}, []
    for params in ({}, {"action_name": "feet"}, {"action_name": "legs"}):
        call = bind_term(context, copy_both, params, "observations.policy.last", "observation")
        size = call.counts["num_actions"]
        key = params.get("action_name", "all")
        outs[key] = context.array(f"out_{key}", float, 2 * size)
        lines.append(call.expression(code("{}[env]", context.scope.name(f"out_{key}", outs[key]))))
    a, b = np.random.default_rng(2).normal(size=(2, N, 6)).astype(np.float32)
    world.step(a)
    world.step(b)
    plan(context, [Section("read", lines)]).run()
    for key, columns in (("all", slice(0, 6)), ("legs", slice(0, 4)), ("feet", slice(4, 6))):
        np.testing.assert_array_equal(outs[key].numpy()[:, 0::2], b[:, columns])
        np.testing.assert_array_equal(outs[key].numpy()[:, 1::2], a[:, columns])


@pytest.mark.parametrize("delay", [0, 1], ids=["side by side", "one thread"])
def test_actions_that_are_not_finite_are_replaced_and_counted(delay):
    clip = {"front_right_leg": (-2.0, 2.0)}
    cfg = cfgs.JointEffortActionCfg(joint_names=LEGS, scale=2.0, clip=clip, delay_max_lag=delay)
    world = World({"legs": cfg})
    action = np.full((N, 4), 1.0e20, dtype=np.float32)
    action[0] = np.nan, INF, -INF, INF
    action[2, 1] = np.nan
    world.step(action)
    assert world.context.arrays["actions.nonfinite"].numpy().tolist() == [5]
    taken = world.manager.action.numpy()
    np.testing.assert_array_equal(taken[0], np.float32([0.0, 1.0e6, -1.0e6, 1.0e6]))
    np.testing.assert_array_equal(taken[2], np.float32([1.0e20, 0.0, 1.0e20, 1.0e20]))
    np.testing.assert_array_equal(world.processed("legs")[0], np.float32([0.0, 2.0, -2.0e6, 2.0e6]))
    world.step(np.ones((N, 4)))
    assert world.context.arrays["actions.nonfinite"].numpy().tolist() == [5]


# -- noise and delay


def noise_reference(cfg: NoiseCfg, action: np.ndarray, stream: reference.Stream) -> np.ndarray:
    drawn = []
    for _ in range(action.shape[1]):
        if isinstance(cfg, ConstantNoiseCfg):
            drawn.append(np.full(len(action), cfg.bias))
        elif isinstance(cfg, UniformNoiseCfg):
            drawn.append(stream.uniform(cfg.n_min, cfg.n_max))
        else:
            drawn.append(cfg.mean + cfg.std * stream.normal())
    noise = np.stack(drawn, axis=1)
    return {"add": action + noise, "scale": action * noise, "abs": noise}[cfg.operation]


@pytest.mark.parametrize(
    "noise",
    [
        UniformNoiseCfg(n_min=-0.5, n_max=0.25),
        GaussianNoiseCfg(mean=1.0, std=0.1, operation="scale"),
        ConstantNoiseCfg(bias=0.5),
        UniformNoiseCfg(n_min=1.0, n_max=2.0, operation="abs"),
    ],
    ids=["add", "scale", "constant", "abs"],
)
def test_noise_is_on_what_is_done_not_on_what_was_asked(noise):
    legs = cfgs.JointEffortActionCfg(joint_names=LEGS, scale=3.0, noise=noise)
    world = World({"feet": cfgs.JointEffortActionCfg(joint_names=[".*foot"]), "legs": legs}, seed=5)
    stream = reference.Stream(5, N)
    action = np.random.default_rng(0).normal(size=(N, 8)).astype(np.float32)
    for _ in range(2):
        world.step(action)
        expected = 3.0 * noise_reference(noise, action[:, 4:], stream)
        np.testing.assert_allclose(world.processed("legs"), expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(world.manager.action.numpy(), action)
    np.testing.assert_array_equal(world.processed("feet"), action[:, :4])


def test_noise_is_a_parameter_that_may_change():
    world = World({"legs": cfgs.JointEffortActionCfg(joint_names=LEGS, noise=ConstantNoiseCfg(bias=0.5))})
    world.context.parameters["actions.legs.noise.bias"] = 2.0
    world.step(np.zeros((N, 4)))
    np.testing.assert_array_equal(world.processed("legs"), 2.0)


def test_noise_does_not_depend_on_the_number_of_environments():
    terms = {"legs": cfgs.JointEffortActionCfg(joint_names=LEGS, noise=GaussianNoiseCfg(), delay_max_lag=2)}
    few, many, again = (World(terms, n) for n in (3, 7, 3))
    for step in range(4):
        for world in (few, many, again):
            if step == 2:
                world.reset(0, 1)
            world.step(np.full((world.context.num_envs, 4), float(step)))
        np.testing.assert_array_equal(few.processed("legs"), many.processed("legs")[:3])
        np.testing.assert_array_equal(few.processed("legs"), again.processed("legs"))


def test_delayed_actions_are_those_of_the_lag_that_the_episode_drew():
    n, low, high = 24, 1, 3
    cfg = cfgs.JointEffortActionCfg(joint_names=LEGS, delay_min_lag=low, delay_max_lag=high)
    world = World({"feet": cfgs.JointEffortActionCfg(joint_names=[".*foot"]), "legs": cfg}, num_envs=n)
    draw = np.random.default_rng(0)
    world.reset(*range(n))
    history: list[list[np.ndarray]] = [[np.zeros(4)] * high for _ in range(n)]
    lags, seen = world.context.arrays["actions.legs.lag"], []
    for step in range(14):
        action = draw.normal(size=(n, 8)).astype(np.float32)
        world.step(action)
        lag = lags.numpy()
        seen += lag.tolist()
        for env in range(n):
            history[env].append(action[env, 4:])
            np.testing.assert_array_equal(world.processed("legs")[env], history[env][-1 - lag[env]])
        np.testing.assert_array_equal(world.processed("feet"), action[:, :4])
        np.testing.assert_array_equal(world.manager.action.numpy(), action)
        if step in (1, 6):
            ended = np.flatnonzero(draw.uniform(size=n) < 0.5).tolist()
            world.reset(*ended)
            still = np.setdiff1d(np.arange(n), ended)
            np.testing.assert_array_equal(lags.numpy()[still], lag[still])
            for env in ended:
                history[env] = [np.zeros(4)] * high
    assert sorted(set(seen)) == [1, 2, 3]


# -- what may change while it runs


def test_scale_offset_and_clip_are_arrays_that_may_change():
    cfg = cfgs.JointPositionActionCfg(joint_names=LEGS, use_default_offset=False, clip={".*": (-1.0, 1.0)})
    world = World({"legs": cfg})
    arrays, torch_ = world.context.arrays, world.context.torch
    torch_(arrays["actions.legs.scale"])[1] = 0.5
    torch_(arrays["actions.legs.offset"])[2] = 0.25
    torch_(arrays["actions.legs.clip"])[3] = torch.tensor([-9.0, 0.1])
    world.step(np.full((N, 4), 0.5))
    np.testing.assert_allclose(world.processed("legs"), [[0.5, 0.25, 0.75, 0.1]] * N, rtol=1e-6)
    world.context.parameters["actions.legs.use_default_offset"] = True
    world.step(np.zeros((N, 4)))
    default = world.robot.default_joint_pos.numpy()[:, [0, 2, 4]]
    np.testing.assert_allclose(world.processed("legs")[:, :3], np.clip(default, -1.0, 1.0), rtol=1e-6)


# -- own terms


@wp.func
def mix(env: int, action: wp.array[float], weights: wp.array[float], gain: float, processed: wp.array[float]):
    total = wp.float32(0.0)
    for i in range(action.shape[0]):
        total += weights[i] * action[i]
    processed[0] = gain * total
    processed[1] = processed[1] + 1.0


@wp.func
def push(env: int, processed: wp.array[float], robot: ArticulationData, joint_ids: wp.array[int], damping: float):
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        robot.joint_effort_target[env, joint] = processed[0] - damping * robot.joint_vel[env, joint]


@wp.func
def start(env: int, processed: wp.array[float], first: float):
    processed[1] = first


def own_term(**changes: Any) -> ActionTermCfg:
    params = {"weights": [1.0, -2.0, 0.5], "gain": 2.0, "damping": 0.1, "first": -3.0}
    cfg = ActionTermCfg(
        joint_names=["front_left_.*"],
        process=mix,
        apply=push,
        reset=start,
        action_size=3,
        processed_size=2,
        params=params,
    )
    return cfg.replace(**changes)


@pytest.mark.parametrize("per_substep", [True, False])
def test_own_term_with_arguments_of_each_function(per_substep):
    world = World({"own": own_term(per_substep=per_substep), "legs": cfgs.JointPositionActionCfg(joint_names=LEGS)})
    assert world.manager.action_term_dim == [3, 4]
    world.reset(0, 1)
    action = np.random.default_rng(0).normal(size=(N, 7)).astype(np.float32)
    world.context.parameters["actions.own.gain"] = 4.0
    world.step(action)
    total = 4.0 * action[:, :3] @ np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(world.processed("own")[:, 0], total, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(world.processed("own")[:, 1], [-2.0, -2.0, 1.0, 1.0])
    vel = world.context.torch(world.robot.joint_vel)
    expected = total[:, None] - 0.1 * vel[:, :2].numpy()
    vel += 1.0
    world.substep()
    expected -= 0.1 * per_substep
    np.testing.assert_allclose(world.robot.joint_effort_target.numpy()[:, :2], expected, rtol=1e-4, atol=1e-5)


@wp.func
def halve(env: int, action: wp.array[float], scale: wp.array[float], processed: wp.array[float]):
    for i in range(action.shape[0]):
        processed[i] = 0.5 * scale[i] * action[i]


def test_built_in_term_with_own_process():
    world = World({"legs": cfgs.JointEffortActionCfg(joint_names=LEGS, scale={"front.*": 3.0}, process=halve)})
    world.step(np.ones((N, 4)))
    np.testing.assert_array_equal(world.robot.joint_effort_target.numpy()[:, ::2], [[1.5, 1.5, 0.5, 0.5]] * N)


# -- what is wrong with a config


def problems(terms: Any) -> list[str]:
    context: ManagerContext = manager_context(2)
    manager = ActionManager(terms, context)
    for items in (manager.process_items, manager.apply_items, manager.reset_items):
        items()
    return context.problems


def legs(**fields: Any) -> Any:
    return cfgs.JointPositionActionCfg(joint_names=LEGS, **fields)


GRIP = {"joint_names": LEGS, "open_command_expr": {".*": 1.0}, "close_command_expr": {".*": 0.0}}


@pytest.mark.parametrize(
    ("term", "start", "parts"),
    [
        (legs().replace(joint_names=["knee_.*"]), "actions.t.joint_names", ["knee_.*", *LEGS]),
        (legs(asset_name="arm"), "actions.t.asset_name", ["'arm'", "robot"]),
        (legs(scale={"knee": 1.0}), "actions.t.scale", ["knee", *LEGS]),
        (legs(scale={"front.*": 1.0, ".*leg": 2.0}), "actions.t.scale", ["front_left_leg", "exclusive"]),
        (legs(offset=(0.0, 1.0)), "actions.t.offset", ["2", "4"]),
        (legs(clip={"knee": (0.0, 1.0)}), "actions.t.clip", ["knee", *LEGS]),
        (
            cfgs.BinaryJointPositionActionCfg(**(GRIP | {"close_command_expr": {"front.*": 0.0}})),
            "actions.t.close_command_expr",
            ["left_back_leg, right_back_leg"],
        ),
        (cfgs.NonHolonomicActionCfg(**(BASE | {"body_name": "cabin"})), "actions.t.body_name", ["cabin", "torso"]),
        (
            cfgs.NonHolonomicActionCfg(**(BASE | {"body_name": ".*leg"})),
            "actions.t.body_name",
            ["more than one body", *LEGS],
        ),
        (cfgs.NonHolonomicActionCfg(**(BASE | {"x_joint_name": "x"})), "actions.t.x_joint_name", ["'x'", *LEGS]),
        (own_term(process=None), "actions.t.process", ["None"]),
        (own_term(apply=None), "actions.t.apply", ["None"]),
        (own_term(process=print), "actions.t.process", ["print", "@wp.func"]),
        (own_term(params={"gain": 1.0, "damping": 0.0, "first": 0.0}), "actions.t.params.weights", ["missing"]),
        (own_term(params=own_term().params | {"dampnig": 1.0}), "actions.t.params.dampnig", ["damping"]),
        (own_term(action_size=0), "actions.t.action_size", ["0"]),
        (legs(noise=NoiseCfg(func=print)), "actions.t.noise", ["UniformNoiseCfg"]),
        (UniformNoiseCfg(), "actions.t", ["UniformNoiseCfg", "ActionTermCfg"]),
    ],
)
def test_problems_say_where_and_what_would_be_right(term, start, parts):
    found = problems({"t": term})
    assert len(found) == 1, found
    assert found[0].startswith(f"{start}:")
    for part in parts:
        assert part in found[0]


def test_problems_of_all_terms_are_gathered():
    found = problems({"a": legs(scale={"x": 1.0}, clip={"y": (0.0, 1.0)}), "b": legs(asset_name="arm")})
    assert [p.partition(":")[0] for p in found] == ["actions.a.scale", "actions.a.clip", "actions.b.asset_name"]


@pytest.mark.parametrize(
    ("cfg", "field"),
    [
        (legs(delay_min_lag=2, delay_max_lag=1), "delay_min_lag"),
        (legs(clip={"a": (1.0, 0.0)}), "clip['a']"),
        (legs(scale=float("nan")), "scale"),
        (legs(kind=""), "kind"),
        (legs(kind="Unknown"), "kind"),
        (cfgs.NonHolonomicActionCfg(**BASE, offset=(0.0, INF)), "offset"),
        (cfgs.EMAJointPositionToLimitsActionCfg(alpha=1.5), "alpha"),
    ],
)
def test_config_refuses_numbers_that_make_no_sense(cfg, field):
    assert [name for name, _ in cfg.problems()] == [field]


def test_functions_of_the_configs_are_those_of_the_kernels():
    assert {c.kind for c, _ in CASES.values()} == set(mdp.ACTIONS)
