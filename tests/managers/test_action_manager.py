# SPDX-License-Identifier: Apache-2.0
"""Action manager: action terms against NumPy references, over steps and resets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ActionData
from stripe_kernels.mdp import ACTIONS
from stripe_newton.envs import mdp as cfgs
from stripe_newton.fusion import Section, bind_term, code
from tests.helpers import term_reference_random as reference
from tests.helpers.action_world import BASE, FIELDS, INF, LEGS, N, World, own_term
from tests.helpers.manager_world import plan


def bounds(*pairs: tuple[float, float]) -> np.ndarray:
    return np.array(pairs)


FREE = bounds(*[(-INF, INF)] * 4)
SCALES = {"front_.*": 0.5, "left_back_leg": -2.0}
SCALE = np.array([0.5, 0.5, -2.0, 1.0])
CLIP = {"front_left_.*": (-0.2, 0.3), "right_back_leg": (0.1, INF)}
LIMITS = bounds((-0.2, 0.3), (-INF, INF), (-INF, INF), (0.1, INF))
OPEN, CLOSE = {"front_.*": 0.4, ".*back.*": -0.1}, {".*leg": 0.2}
GRIPPER = {"open_command": np.array([0.4, 0.4, -0.1, -0.1]), "close_command": np.full(4, 0.2)}
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


def test_functions_of_the_configs_are_those_of_the_kernels():
    assert {c.kind for c, _ in CASES.values()} == set(mdp.ACTIONS)
