# SPDX-License-Identifier: Apache-2.0
"""Usage of Warp functions: what they read, write and call, and what cannot be resolved."""

from __future__ import annotations

import pytest
import warp as wp

from stripe_kernels.data import ArticulationData, CommandData, EpisodeData
from stripe_kernels.mdp import frames
from stripe_newton.fusion import usage_of


@wp.struct
class Goal:
    place: wp.array[wp.vec3]
    reached: wp.array[int]


@wp.func
def height(robot: ArticulationData, env: int) -> float:
    return wp.transform_get_translation(robot.root_pose[env])[2]


@wp.func
def fill(values: wp.array[float], value: float):
    for i in range(values.shape[0]):
        values[i] = value


@wp.func
def reads_one_field(env: int, robot: ArticulationData) -> float:
    """Says robot.body_pose in its docstring and calls wp.length, which is no episode.length."""
    text = "robot.body_vel"  # noqa: F841  (robot.body_acc in a comment)
    return wp.length(wp.vec3(robot.joint_pos[env, 0], 0.0, 0.0))


@wp.func
def through_a_helper(env: int, robot: ArticulationData) -> float:
    return height(robot, env)


@wp.func
def through_a_module(env: int, robot: ArticulationData) -> float:
    return frames.heading_w(env, robot)


@wp.func
def through_a_variable(env: int, robot: ArticulationData) -> float:
    pose = robot.root_pose
    mine = robot
    return pose[env][0] + mine.joint_vel[env, 0]


@wp.func
def writes(env: int, robot: ArticulationData, episode: EpisodeData, goal: Goal):
    robot.joint_vel[env, 0] = robot.default_joint_vel[env, 0]
    robot.joint_pos[env, 0] += 1.0
    wp.atomic_add(goal.reached, env, 1)
    fill(robot.joint_pos_target[env], 0.0)
    row = robot.joint_effort_target[env]
    row[0] = float(episode.length[env])


@wp.func
def writes_its_array(env: int, out: wp.array[float]):
    fill(out[1:3], 2.0)


@wp.func_native("out.data[0] = robot.body_pose.data[env].p[0];")
def native_with_a_struct(env: int, robot: ArticulationData, out: wp.array[float]): ...


@wp.func_native("out.data[0] = 1.0;")
def native_with_an_array(out: wp.array[float]): ...


@wp.func
def calls_native(env: int, robot: ArticulationData, out: wp.array[float]):
    native_with_a_struct(env, robot, out)


@wp.func
def hands_an_array_to_native(env: int, robot: ArticulationData):
    native_with_an_array(robot.joint_pos_target[env])


@wp.func
def overloaded(env: int, robot: ArticulationData) -> float:
    return robot.joint_pos[env, 0]


@wp.func
def overloaded(env: int, command: CommandData) -> float:  # noqa: F811
    return command.time_left[env]


def fields(function: wp.Function) -> tuple[set[str], set[str]]:
    usage = usage_of(function)
    assert not usage.unresolved
    return set(usage.reads - {"shape"}), set(usage.writes)


def test_comments_texts_and_functions_of_warp_are_no_reads():
    assert fields(reads_one_field) == ({"joint_pos"}, set())


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (through_a_helper, {"root_pose"}),
        (through_a_module, {"root_pose"}),
        (through_a_variable, {"root_pose", "joint_vel"}),
    ],
)
def test_reads_through_others(function, expected):
    assert fields(function) == (expected, set())


def test_writes_direct_and_through_others():
    read, written = fields(writes)
    assert written == {"joint_vel", "joint_pos", "reached", "joint_pos_target", "joint_effort_target"}
    assert read >= {"default_joint_vel", "joint_pos", "length"}
    assert "joint_vel" not in read


def test_arguments_that_are_written():
    assert usage_of(fill).writes_arguments == {"values"}
    assert usage_of(writes_its_array).writes_arguments == {"out"}
    assert usage_of(through_a_helper).writes_arguments == frozenset()


def test_calls_are_those_of_the_whole_tree():
    assert {f.key for f in usage_of(through_a_helper).calls} == {"height"}
    assert height in usage_of(through_a_helper).calls


def test_a_closure_is_resolved_and_hides_a_global():
    def make(height: wp.Function) -> wp.Function:
        @wp.func
        def by_closure(env: int, robot: ArticulationData) -> float:
            return height(env, robot)

        return by_closure

    assert fields(make(frames.heading_w)) == ({"root_pose"}, set())
    assert fields(make(reads_one_field)) == ({"joint_pos"}, set())


def test_static_expressions_are_resolved():
    known = {"height": height}

    @wp.func
    def by_static(env: int, robot: ArticulationData) -> float:
        return wp.static(known["height"])(robot, env) + wp.static(2.0 * 3.0)

    assert fields(by_static) == ({"root_pose"}, set())


def test_a_static_expression_that_only_warp_can_evaluate_may_be_anything():
    @wp.func
    def by_counter(env: int, robot: ArticulationData) -> float:
        total = wp.float32(0.0)
        for i in range(3):
            total += wp.static(float(i))
        return total

    usage = usage_of(by_counter)
    assert usage.unresolved == ("wp.static(float(i))",)
    assert usage.may_use(["body_pose"])


def test_native_code_may_do_anything_with_a_struct():
    usage = usage_of(calls_native)
    assert usage.unresolved == ("native_with_a_struct, which is native code",)
    assert usage.may_use(["body_pose"])
    assert fields(hands_an_array_to_native) == ({"joint_pos_target"}, {"joint_pos_target"})


def test_an_unknown_name_may_do_anything():
    @wp.func
    def calls_nothing_known(env: int, robot: ArticulationData) -> float:
        return not_there(robot)  # noqa: F821

    assert usage_of(calls_nothing_known).unresolved == ("not_there",)


def test_a_function_that_is_an_argument_may_do_anything():
    @wp.func
    def applies(env: int, robot: ArticulationData, function: wp.Function) -> float:
        return function(env, robot)

    assert usage_of(applies).unresolved == ("function",)


def test_overloads_count_together():
    assert fields(overloaded) == ({"joint_pos", "time_left"}, set())


def test_may_use():
    usage = usage_of(writes)
    assert usage.may_use(["joint_vel"])
    assert usage.may_use(["body_pose", "length"])
    assert not usage.may_use(["body_pose"])
    assert usage.among({"joint_vel": 1, "body_pose": 2}) == {"joint_vel": 1}
