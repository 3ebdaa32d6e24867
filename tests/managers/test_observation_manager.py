# SPDX-License-Identifier: Apache-2.0
"""Observation manager: values and layout of groups, history, delay, resets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.envs import mdp
from stripe_newton.managers import (
    DigitalFilterCfg,
    IntegratorCfg,
    RunningNormCfg,
    SceneEntityCfg,
)
from stripe_newton.managers import ObservationTermCfg as Term
from stripe_newton.noise import (
    GaussianNoiseCfg,
    NoiseModelCfg,
    NoiseModelWithAdditiveBiasCfg,
    UniformNoiseCfg,
)
from tests.helpers.manager_world import ObservationWorld
from tests.helpers.manager_world import observation_group as group
from tests.helpers.observation_terms import (
    ALL_FEET,
    ALL_LEGS,
    FEET,
    LEGS,
    ONE,
    J,
    N,
    Whole,
    joints,
    moment,
    torch_squares,
)
from tests.helpers.term_reference import OBSERVATIONS


@wp.func
def tiled(env: int, robot: ArticulationData, out: wp.array[float]):
    for i in range(out.shape[0]):
        out[i] = robot.joint_pos[env, 0] + 0.25 * float(i)


def randomise(world: ObservationWorld, seed: int) -> dict[str, Any]:
    """Draw a state of the robot; returns it in float64, as the references take it."""
    robot, draw = world.robot, np.random.default_rng(seed)
    names = "root_pose", "root_vel", "body_pose", "joint_pos", "joint_vel", "default_joint_pos", "default_joint_vel"
    for name in names:
        view = world.context.torch(getattr(robot, name))
        view[:] = torch.as_tensor(draw.normal(size=tuple(view.shape)))
        if "pose" in name:
            view[..., 3:] /= view[..., 3:].norm(dim=-1, keepdim=True)
    length = draw.integers(0, 60, world.context.num_envs)
    world.context.torch(world.context.episode.length)[:] = torch.as_tensor(length)
    fields = {n: getattr(robot, n).numpy().astype(float) for n in (*names, "joint_pos_lower", "joint_pos_upper")}
    fields |= {
        "soft_limit_factor": robot.soft_limit_factor,
        "env_origin": robot.env_origin.numpy().astype(float),
        "gravity_dir": np.array(list(robot.gravity_dir)),
    }
    return {"ArticulationData": fields, "EpisodeData": {"length": length, "step_dt": 1.0 / 60.0, "max_length_s": 1.0}}


# -- values and layout


CHAIN = joints("right_back_foot", "front_.*_leg", preserve_order=True)  # joints 7, 0, 2
TORSO_AND_FOOT = {"asset_cfg": SceneEntityCfg("robot", body_names=["torso", "left_back_foot"])}  # bodies 0, 6
VALUES = {
    "lin_vel": Term(mdp.base_lin_vel, scale=(2.0, -1.0, 0.5)),
    "nothing": None,
    "gravity": Term(mdp.projected_gravity, clip=(-0.3, 0.4)),
    "joint_pos": Term(mdp.joint_pos_rel, CHAIN, scale=[1.0, 10.0, 100.0]),
    "joint_vel": Term(mdp.joint_vel, scale=0.05, clip=(-1.0, 1.5)),
    "bodies": Term(mdp.body_pose_w, TORSO_AND_FOOT, clip=(-1.0, 9.0)),
    "own": Term(moment, {**CHAIN, "gain": -2.0}, size=lambda counts: counts["joint_ids"] + 1),
    "torch": Term(torch_squares, CHAIN, size=3, clip=(0.0, 1.0), scale=3.0),
    "time": Term(mdp.remaining_time_s),
}
CRITIC = {
    "quat": Term(mdp.root_quat_w, {"make_quat_unique": True}),
    "limits": Term(mdp.joint_pos_limit_normalized, ALL_FEET, scale=0.5),
    "torch": Term(torch_squares, ONE, size=1),
}


def expected_values(v: dict[str, Any]) -> dict[str, dict[str, np.ndarray]]:
    """Groups and terms in float64, without a kernel."""
    r, chain = v["ArticulationData"], [7, 0, 2]
    own = np.concatenate([-2.0 * r["joint_vel"][:, chain] ** 2, r["joint_pos"][:, chain].sum(1, keepdims=True)], 1)
    policy = {
        "lin_vel": OBSERVATIONS["base_lin_vel"](v, {}) * [2.0, -1.0, 0.5],
        "gravity": np.clip(OBSERVATIONS["projected_gravity"](v, {}), -0.3, 0.4),
        "joint_pos": (r["joint_pos"] - r["default_joint_pos"])[:, chain] * [1.0, 10.0, 100.0],
        "joint_vel": 0.05 * np.clip(r["joint_vel"], -1.0, 1.5),
        "bodies": np.clip(OBSERVATIONS["body_pose_w"](v, {"body_ids": [0, 6]}), -1.0, 9.0),
        "own": own,
        "torch": 3.0 * np.clip(r["joint_pos"][:, chain] ** 2, 0.0, 1.0),
        "time": 1.0 - v["EpisodeData"]["length"][:, None] / 60.0,
    }
    critic = {
        "quat": OBSERVATIONS["root_quat_w"](v, {"make_quat_unique": True}),
        "limits": 0.5 * OBSERVATIONS["joint_pos_limit_normalized"](v, {"joint_ids": FEET}),
        "torch": r["joint_pos"][:, [5]] ** 2,
    }
    return {"policy": policy, "critic": critic}


@pytest.fixture(scope="module")
def values_world() -> ObservationWorld:
    groups = {"policy": group(VALUES), "critic": group(CRITIC, concatenate_terms=False), "off": None}
    return ObservationWorld(groups, where_reset=True)


def observed(world: ObservationWorld) -> dict[str, np.ndarray]:
    return {name: world[name] for name in world.manager.flat_buffers()}


def flat(expected: dict[str, dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    joined = {"policy": np.concatenate(list(expected["policy"].values()), axis=1)}
    return joined | {f"critic.{n}": v for n, v in expected["critic"].items()}


def assert_close(found: dict[str, np.ndarray], expected: dict[str, np.ndarray], rows: Any = slice(None)) -> None:
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(found[name][rows], values[rows], rtol=2e-5, atol=2e-6, err_msg=name)


def test_values_are_those_of_the_terms_computed_another_way(values_world):
    for seed in (1, 2):
        expected = flat(expected_values(randomise(values_world, seed)))
        values_world.step()
        assert_close(observed(values_world), expected)


def test_layout_follows_the_config(values_world):
    manager = values_world.manager
    names = [n for n, t in VALUES.items() if t is not None]
    sizes = [3, 3, 3, 8, 14, 4, 3, 1]
    assert manager.active_terms == {"policy": names, "critic": list(CRITIC)}
    assert manager.group_obs_dim == {"policy": (39,), "critic": [(4,), (4,), (1,)]}
    assert manager.group_obs_term_dim == {"policy": [(s,) for s in sizes], "critic": [(4,), (4,), (1,)]}
    assert list(manager.flat_buffers()) == ["policy", "critic.quat", "critic.limits", "critic.torch"]
    assert list(manager.buffers["critic"]) == list(CRITIC)
    assert [line.split() for line in str(manager).splitlines()[3:]] == [
        *(["policy", str(i), n, str(s)] for i, (n, s) in enumerate(zip(names, sizes, strict=True))),
        ["critic", "0", "quat", "4"], ["critic", "1", "limits", "4"], ["critic", "2", "torch", "1"],
    ]  # fmt: skip


def test_joints_and_bodies_that_do_not_depend_on_each_other_have_a_thread_each(values_world):
    parts = {i.name: i.parts for i in values_world.items if hasattr(i, "parts")}
    alone = 5  # lin_vel, gravity, own, torch, time
    # A term of eight parts or more has neighbouring threads, and a section for them.
    few, many = (
        {"observations_policy": alone + 3 + 2, "observations_critic": 1 + 4 + 1},
        "observations_policy_joint_vel",
    )
    assert parts == few | {many: 8}


def test_environments_that_ended_are_observed_alone(values_world):
    before = flat(expected_values(randomise(values_world, 3)))
    values_world.step()
    held = observed(values_world)
    after = flat(expected_values(randomise(values_world, 4)))
    values_world.observe_ended(1, 3)
    found = observed(values_world)
    assert_close(found, after, [1, 3])
    assert_close(found, before, [0, 2])
    for name in found:
        np.testing.assert_array_equal(found[name][[0, 2]], held[name][[0, 2]])


def test_clip_scale_and_arguments_may_change_while_it_runs(values_world):
    v = randomise(values_world, 5)
    expected = expected_values(v)
    parameters, arrays = values_world.context.parameters, values_world.context.arrays
    before = {n: parameters[n] for n in parameters.paths()}
    parameters["observations.policy.joint_vel.scale"] = 2.0
    parameters["observations.policy.joint_vel.clip.high"] = 0.1
    parameters["observations.policy.own.gain"] = 0.0
    scale = values_world.context.torch(arrays["observations.policy.lin_vel.scale"])
    scale[1] = 0.0
    values_world.step()
    expected["policy"]["joint_vel"] = 2.0 * np.clip(v["ArticulationData"]["joint_vel"], -1.0, 0.1)
    expected["policy"]["own"][:, :3] = 0.0
    expected["policy"]["lin_vel"][:, 1] = 0.0
    assert_close(observed(values_world), flat(expected))
    for name, value in before.items():
        parameters[name] = value
    scale[1] = -1.0


# -- history


HISTORY = {
    "legs": Term(mdp.joint_pos, ALL_LEGS, history_length=3, scale=2.0, clip=(-1.0, 1.0)),
    "now": Term(mdp.joint_pos, ONE),
    "one": Term(mdp.joint_pos, ALL_FEET, history_length=1),
    "wide": Term(tiled, size=20, history_length=2),
    "torch": Term(torch_squares, ONE, size=1, history_length=4),
}


def stacked(past: list[np.ndarray], starts: np.ndarray, length: int) -> np.ndarray:
    """The last ``length`` entries, oldest first; those before the start of an episode are its first."""
    rows = []
    for env, start in enumerate(starts):
        last = len(past) - 1
        rows.append(np.concatenate([past[max(start, last - k)][env] for k in reversed(range(length))]))
    return np.stack(rows)


def test_history_is_oldest_first_and_starts_with_the_first_value_of_the_episode():
    groups = {
        "policy": group(HISTORY),
        "short": group(HISTORY, history_length=2, concatenate_terms=False),
        "none": group(HISTORY, history_length=0),
    }
    world = ObservationWorld(groups)
    assert world.manager.group_obs_dim["policy"] == (3 * 4 + 1 + 4 + 2 * 20 + 4,)
    assert world.manager.group_obs_dim["short"] == [(8,), (2,), (8,), (40,), (2,)]
    assert world.manager.group_obs_dim["none"] == (4 + 1 + 4 + 20 + 1,)
    draw, starts = np.random.default_rng(0), np.zeros(N, dtype=int)
    past: dict[str, list[np.ndarray]] = {name: [] for name in HISTORY}
    for step in range(11):
        if step in (4, 5, 8):  # before the first step nobody says that an episode starts
            ended = {4: [1, 3], 5: [1], 8: list(range(N))}[step]
            world.reset(*ended)
            starts[ended] = step
        q = draw.normal(size=(N, J)).astype(np.float32)
        world.step(q)
        past["legs"].append(2.0 * np.clip(q[:, LEGS], -1.0, 1.0))
        past["now"].append(q[:, [5]])
        past["one"].append(q[:, FEET])
        past["wide"].append(q[:, :1] + 0.25 * np.arange(20))
        past["torch"].append(q[:, [5]] ** 2)
        lengths = {n: max(1, t.history_length) for n, t in HISTORY.items()}
        for name, expected in (
            ("policy", [stacked(past[n], starts, lengths[n]) for n in HISTORY]),
            ("none", [stacked(past[n], starts, 1) for n in HISTORY]),
        ):
            np.testing.assert_allclose(world[name], np.concatenate(expected, axis=1), rtol=1e-6, err_msg=str(step))
        for name in HISTORY:
            np.testing.assert_allclose(world[f"short.{name}"], stacked(past[name], starts, 2), rtol=1e-6)


# -- environments do not depend on each other


NOISE = GaussianNoiseCfg(std=0.1)
BIAS = NoiseModelWithAdditiveBiasCfg(noise_cfg=NOISE, bias_noise_cfg=UniformNoiseCfg(n_min=-0.5, n_max=0.5))
EVERYTHING = {
    "noisy": Term(mdp.joint_pos, ALL_LEGS, noise=NOISE, history_length=2),
    "biased": Term(mdp.joint_pos, ALL_FEET, noise=BIAS, delay_max_lag=3),
    "shared": Term(mdp.joint_pos, ALL_LEGS, noise=BIAS.replace(sample_bias_per_component=False)),
    "filtered": Term(
        mdp.joint_pos,
        ALL_LEGS,
        modifiers=[DigitalFilterCfg(A=(-0.5,), B=(0.5, 0.1)), IntegratorCfg(dt=0.1)],
        noise=NoiseModelCfg(noise_cfg=UniformNoiseCfg(n_min=-0.1, n_max=0.1)),
    ),
    "torch": Term(torch_squares, ONE, size=1, noise=NOISE, delay_min_lag=1, delay_max_lag=2, history_length=2),
}


def everything(num_envs: int, **options: Any) -> ObservationWorld:
    groups = {"policy": group(EVERYTHING, enable_corruption=True), "critic": group(EVERYTHING)}
    return ObservationWorld(groups, num_envs, **options)


def signal_at(step: int, num_envs: int) -> np.ndarray:
    return np.random.default_rng(step).normal(size=(9, J)).astype(np.float32)[:num_envs]


def test_values_of_an_environment_do_not_depend_on_how_many_there_are():
    few, many, again, other = everything(3), everything(9), everything(3), everything(3, seed=4)
    differ = 0.0
    for step in range(8):
        for world in (few, many, again, other):
            if step in (0, 4):
                world.reset(*{0: range(world.context.num_envs), 4: [0, 2]}[step])
            world.step(signal_at(step, world.context.num_envs))
        for name in ("policy", "critic"):
            np.testing.assert_array_equal(few[name], many[name][:3])
            np.testing.assert_array_equal(few[name], again[name])
        differ += np.abs(few["policy"] - other["policy"]).max()
    assert differ > 0.1  # another seed is another noise


def rows_that_changed(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Environments in which an array changed, by array; of all arrays that did."""
    found = {}
    for name, old in before.items():
        differ = old != after[name]
        if differ.any():
            assert len(old) == N, f"{name} belongs to no environment"
            found[name] = np.flatnonzero(differ.reshape(N, -1).any(axis=1))
    return found


def test_last_observation_and_reset_of_some_environments_leave_the_others_alone():
    one, two = everything(N, where_reset=True), everything(N)
    for step in range(4):
        for world in (one, two):
            if step == 0:
                world.reset(*range(N))
            world.step(signal_at(step, N))
    states = [one.state()]
    one.observe_ended(1, 3)
    states.append(one.state())
    one.reset(1, 3)
    states.append(one.state())
    for state in states:  # the mask itself, and what a torch term returns before it is handed on
        for name in ("reset", "observations.policy.torch.now", "observations.critic.torch.now"):
            del state[name]
    observe, reset = (rows_that_changed(*states[i : i + 2]) for i in range(2))
    assert {"observations.policy", "observations.critic", "observations.policy.noisy.rng"} <= observe.keys()
    assert {n.rpartition(".")[2] for n in reset} <= {"rng", "bias", "fresh", "lag", "filled"}
    assert {f"observations.policy.{n}" for n in ("biased.bias", "shared.bias", "torch.fresh", "biased.filled")} <= (
        reset.keys()
    )
    for changed in (observe, reset):
        assert all(set(rows) <= {1, 3} for rows in changed.values()), changed
    for step in range(4, 9):
        for world in (one, two):
            world.step(signal_at(step, N))
        for name in ("policy", "critic"):
            np.testing.assert_array_equal(one[name][[0, 2]], two[name][[0, 2]])
            assert (one[name][[1, 3]] != two[name][[1, 3]]).any(axis=1).all(), name


def test_privileged_group_sees_what_the_noisy_one_hides():
    terms = {n: t.replace(delay_min_lag=0, delay_max_lag=0) for n, t in EVERYTHING.items()}
    world = ObservationWorld({"policy": group(terms, enable_corruption=True), "critic": group(terms)})
    world.reset(*range(N))
    q = signal_at(0, N)
    world.step(q)
    filtered = 0.5 * 0.1 * (0.5 + 0.1 + 0.5) * q[:, LEGS]  # past values are the first, the integral starts at zero
    exact = [q[:, LEGS], q[:, LEGS], q[:, FEET], q[:, LEGS], filtered, q[:, [5]] ** 2, q[:, [5]] ** 2]
    np.testing.assert_allclose(world["critic"], np.concatenate(exact, axis=1), rtol=1e-5, atol=1e-6)
    off = world["policy"] - world["critic"]
    assert (off != 0.0).all()
    assert np.abs(off).max() < 1.2


@pytest.mark.parametrize(("params", "size"), [(ONE, 1), (ALL_LEGS, 4), (joints(".*"), J)])
def test_size_of_a_torch_term_is_that_of_its_values(params, size):
    world = ObservationWorld({"policy": group({"t": Term(torch_squares, params, history_length=2)})}, num_envs=N)
    assert world.manager.group_obs_term_dim == {"policy": [(2 * size,)]}


def test_good_configs_are_let_through():
    Whole(observations={"policy": group(EVERYTHING, history_length=2), "critic": group(VALUES), "off": None}).validate()
    Whole(
        observations={"policy": group({"t": Term(mdp.joint_pos, clip=(1.0, 1.0))}, normalization=RunningNormCfg())}
    ).validate()
