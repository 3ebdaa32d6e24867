# SPDX-License-Identifier: Apache-2.0
"""Comparison with mjlab: both sides are the same task, in model, observations, rewards and a control step.

mjlab runs under an interpreter of its own, named by the environment variable ``MJLAB_PYTHON``.
"""

from __future__ import annotations

import json
import os
import re
import sys
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from tests.helpers.checkout import TOOLS

sys.path.insert(0, str(TOOLS / "comparison"))

import compare_mjlab as tool
import compare_mjlab_env as ours

COUNT = 32
REQUEST = {"num_envs": COUNT, "seed": 3, "device": "cpu", "randomize": False}
FEET = [f"{foot}_calf" for foot in ours.FEET]
TOLERANCES = {
    "root_pos": 1e-5,
    "root_lin_vel": 1e-4,
    "root_ang_vel": 2e-4,
    "joint_pos": 1e-5,
    "joint_vel": 5e-4,
}
"""[m, m/s, rad/s, rad, rad/s] after a control step, for constraints that are solved in float32."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compare")


@pytest.fixture(scope="module")
def ask(folder):
    """Runs something under mjlab's interpreter and returns the path of the answer."""
    python = os.environ.get("MJLAB_PYTHON")
    if not python:
        pytest.skip("MJLAB_PYTHON names no interpreter that has mjlab")
    peer = tool.Peer(python, None)
    return lambda what, name, **request: peer.ask(what, {**REQUEST, **request}, folder / name)


@pytest.fixture(scope="module")
def facts(ask):
    return json.loads(ask("describe", "facts.json", randomize=True).read_text())


@pytest.fixture(scope="module")
def env(facts, folder):
    env = ours.Go1Env(ours.make_env_cfg(facts, folder / "robot.xml", REQUEST))
    env.reset(seed=1)
    yield env
    env.close()


@pytest.fixture(scope="module")
def states(facts):
    """Half of them in the air with joints anywhere, half on the ground; what feet feel has nothing to do with that."""
    rng, flies = np.random.default_rng(0), np.arange(COUNT)[:, None] % 2 == 1

    def uniform(low: float, high: float, *shape: int) -> np.ndarray:
        return rng.uniform(low, high, (COUNT, *shape))

    touches = rng.random((COUNT, 4)) < 0.5
    angles = uniform(-1.0, 1.0, 3) * np.where(flies, (3.1, 0.5, 0.5), (3.1, 0.05, 0.05))
    found = {
        "root_pos": np.hstack([uniform(-0.5, 0.5, 2), np.where(flies, 0.8, facts["root_pos"][2])]),
        "root_quat": Rotation.from_euler("ZYX", angles).as_quat(),
        "root_lin_vel": uniform(-1.0, 1.0, 3),
        "root_ang_vel": uniform(-2.0, 2.0, 3),
        "joint_pos": np.array(facts["joint_pos"]) + uniform(-1.0, 1.0, 12) * np.where(flies, 1.0, 0.1),
        "joint_vel": uniform(-5.0, 5.0, 12),
        "action": uniform(-1.0, 1.0, 12),
        "prev_action": uniform(-1.0, 1.0, 12),
        "command": uniform(-1.0, 1.0, 3) * (rng.random((COUNT, 1)) < 0.8),
        "force": uniform(-50.0, 50.0, 4, 3) * touches[..., None],
        "current_air_time": uniform(0.05, 0.5, 4) * ~touches,
        "current_contact_time": np.where(rng.random((COUNT, 4)) < 0.5, 0.015, 0.3) * touches,
        "peak": uniform(0.0, 0.15, 4),
    }
    return {name: values.astype(np.float32) for name, values in found.items()}


@pytest.fixture(scope="module")
def theirs(ask, states, folder):
    np.savez(folder / "states.npz", **states)
    return dict(np.load(ask("evaluate", "answer.npz", states=str(folder / "states.npz"))))


def enter(env: Any, states: dict[str, np.ndarray]) -> None:
    """Put our environments into the states, whose root velocities are of the link's origin."""
    given = {name: torch.from_numpy(values) for name, values in states.items()}
    robot, sensor, arrays = env.scene["robot"], env.scene["feet"].struct, env.context.arrays
    env.sim.clear_solver(torch.ones(COUNT, dtype=torch.bool))
    com = Rotation.from_quat(states["root_quat"]).apply(env.sim.per_env(env.sim.model.body_com)[:, 0].numpy())
    linear = states["root_lin_vel"] + np.cross(states["root_ang_vel"], com).astype(np.float32)
    root = [given["root_pos"] + env.scene.env_origins, given["root_quat"]]
    robot.write_root_state_to_sim(torch.cat([*root, torch.from_numpy(linear), given["root_ang_vel"]], dim=1))
    robot.write_joint_state_to_sim(given["joint_pos"], given["joint_vel"])
    env.sim.forward()
    for name in ("current_air_time", "current_contact_time"):
        wp.to_torch(getattr(sensor, name))[:] = given[name]
    wp.to_torch(sensor.net_forces_w)[:] = -given["force"]  # on the foot, mjlab's are of the foot
    wp.to_torch(sensor.net_forces_w_history)[:, 0] = -given["force"]
    for name, value in {"command": given["command"], "is_heading": 0, "is_standing": 0, "time_left": 1e3}.items():
        wp.to_torch(arrays[f"commands.twist.{name}"])[:] = value
    wp.to_torch(arrays["state.rewards.foot_swing_height.peak"])[:] = given["peak"]


def close(got: Any, expected: Any, name: str, atol: float) -> None:
    np.testing.assert_allclose(np.asarray(got), expected, rtol=1e-4, atol=atol, err_msg=name)


def test_the_models_agree(env, facts):
    model, options = env.sim.solver.mj_model, facts["env"]["sim"]["mujoco"]
    for name in ("iterations", "ls_iterations", "tolerance", "ls_tolerance", "impratio", "ccd_iterations"):
        assert getattr(model.opt, name) == pytest.approx(options[name]), name
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert not model.opt.disableflags
    assert len(facts["geoms"]) == model.ngeom
    for index in range(model.ngeom):
        name = re.sub(r"_\d+$", "", model.geom(index).name.rpartition("/")[2])
        for field, expected in facts["geoms"]["terrain" if name == "CollisionPlane" else name].items():
            close(getattr(model, f"geom_{field}")[index], expected, f"{name}: {field}", 1e-9)
    for name, (mass, *inertia) in facts["bodies"].items():
        index = next(b for b in range(model.nbody) if model.body(b).name.endswith(f"_{name}"))
        close(model.body_mass[index], mass, name, 0.0)
        close(sorted(model.body_inertia[index]), sorted(inertia), name, 1e-7)
    data = env.scene["robot"].data
    assert data.joint_names == facts["joint_names"]
    for index, name in enumerate(facts["joint_names"]):
        stiffness, damping, _, limit = facts["drives"][name]
        got = [float(v[0, index]) for v in (data.joint_stiffness, data.joint_damping, data.joint_effort_limits)]
        close(got, [-stiffness, -damping, limit], name, 0.0)
        dof = model.jnt_dofadr[1 + index]
        close([model.dof_armature[dof], model.dof_damping[dof]], facts["dofs"][name][:2], name, 1e-9)


def test_observations_and_rewards_agree(env, states, theirs, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(env.sim, "launch", lambda steps, before_each=None: None)  # no physics in these steps
        env.step(torch.from_numpy(states["prev_action"]))
        enter(env, states)
        obs, *_ = env.step(torch.from_numpy(states["action"]))
    assert not env.reset_buf.any()
    close(obs["policy"], theirs["obs_actor"], "policy", 2e-5)
    close(obs["critic"], theirs["obs_critic"], "critic", 2e-5)
    counted = {name.removeprefix("reward_") for name in theirs if name.startswith("reward_") and theirs[name].any()}
    assert counted == set(env.reward_manager.active_terms)
    for index, name in enumerate(env.reward_manager.active_terms):
        expected = theirs[f"reward_{name}"]
        close(env.reward_manager.step_reward[:, index], expected, name, 2e-5 * np.abs(expected).max())


def test_a_control_step_agrees(env, facts, states, theirs):
    nothing = {name: np.zeros_like(states[name]) for name in ("force", "current_air_time", "current_contact_time")}
    enter(env, states | nothing)
    drives = np.array([facts["drives"][name] for name in facts["joint_names"]])
    target = states["action"] * facts["action_scale"] + facts["joint_pos"]
    torque = (states["joint_pos"] - target) * drives[:, 0] + states["joint_vel"] * drives[:, 1]
    assert (np.abs(torque) > drives[:, 3]).sum() >= 3  # some drives saturate
    env.step(torch.from_numpy(states["action"]))
    data, sensor = env.scene["robot"].data, env.scene["feet"]
    com = Rotation.from_quat(data.root_quat_w.numpy()).apply(env.sim.per_env(env.sim.model.body_com)[:, 0].numpy())
    got = {
        "root_pos": data.root_pos_w - env.scene.env_origins,
        "root_lin_vel": data.root_lin_vel_w.numpy() - np.cross(data.root_ang_vel_w.numpy(), com),
        "root_ang_vel": data.root_ang_vel_w,
        "joint_pos": data.joint_pos,
        "joint_vel": data.joint_vel,
    }
    for name, tolerance in TOLERANCES.items():
        close(got[name], theirs[name], name, tolerance)
    feet, stands = sensor.find_bodies(FEET, preserve_order=True)[0], slice(0, None, 2)
    forces = sensor.data.net_forces_w[
        stands, feet
    ].numpy()  # in the air legs touch legs, which mjlab's feet do not feel
    pushes = np.linalg.norm(theirs["force"][stands], axis=-1) > 0.0
    assert 20 < pushes.sum() < 64
    np.testing.assert_array_equal(np.linalg.norm(forces, axis=-1) > 0.0, pushes)
    close(-forces, theirs["force"][stands], "force", 0.05)
    same = pushes == (theirs["found"][stands] > 0)  # mjlab also counts contacts that do not push
    assert same.mean() > 0.9
    air = sensor.data.current_air_time[stands, feet].numpy()
    assert (np.abs(air - theirs["air"][stands]) < 1e-6)[same].mean() > 0.9


def test_what_is_drawn_at_the_start(facts, folder):
    env = ours.Go1Env(ours.make_env_cfg(facts, folder / "robot.xml", {**REQUEST, "num_envs": 4, "randomize": True}))
    try:
        obs, _ = env.reset(seed=2)
        env.step(torch.zeros(4, 12))
        own, sim = env.scene["robot"].layout.body_names, env.sim
        com = sim.per_env(sim.model.body_com).numpy()[:, own.index("trunk")]
        slides = [geom for geom in sim.template.shape_label if geom.endswith("_foot_collision")]
        shapes = [sim.template.shape_label.index(geom) for geom in slides]
        fields = ("mu", "mu_torsional", "mu_rolling")
        frictions = [env.scene.controller.field(f"shape_material_{f}")[0][:, shapes].cpu().numpy() for f in fields]
        for name, friction in zip(("slide", "spin", "roll"), frictions, strict=True):
            low, high = facts["env"]["events"][f"foot_friction_{name}"]["params"]["ranges"]
            assert (friction == friction[:, :1]).all(), name
            assert low <= friction.min() < friction.max() <= high, name
        assert np.ptp(com, axis=0).min() > 0.0
        bias = obs["policy"][:, 9:21] - obs["critic"][:, 9:21]  # with the noise of the encoders
        assert 0.0 < float(bias.abs().max()) < 0.015 + 0.01
    finally:
        env.close()
