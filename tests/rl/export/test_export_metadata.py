# SPDX-License-Identifier: Apache-2.0
"""Export metadata about robots, actions and observations; environments that are refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import onnx
import pytest
import torch

from stripe_newton.actuators import DelayedPDActuatorCfg
from stripe_newton.cli import main
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RunningNormCfg,
    SceneEntityCfg,
)
from stripe_newton.noise import GaussianNoiseCfg
from stripe_newton.registration import register_task
from stripe_newton.rl import (
    CheckpointError,
    OnnxPolicy,
    OnPolicyRunner,
    RslRlVecEnvWrapper,
    export_policy,
    read_policy_metadata,
)
from stripe_newton.rl.export.env_description import sensors
from stripe_newton.rl.export.metadata_format import ArticulationInfo
from stripe_newton.rl.export.plain_values import plain
from stripe_newton.sensors import GridPatternCfg, RayCasterCfg
from stripe_newton.sim import MuJoCoSolverCfg
from stripe_newton.value_types import mismatches
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg, CartpoleManagerPPORunnerCfg, EventsCfg
from tests.helpers.cart_env import CartCfg, CartEnv

pytest.importorskip("onnxruntime")
CART, POLE = "slider_to_cart", "cart_to_pole"


@configclass
class SeenCfg:
    """Two groups, of which one has all that a term can have."""

    @configclass
    class PolicyCfg(ObservationGroupCfg):
        """The pole, with a past."""

        angle: ObservationTermCfg = ObservationTermCfg(
            func=mdp.joint_pos,
            params={"asset_cfg": SceneEntityCfg("robot", joint_names=[POLE])},
            noise=GaussianNoiseCfg(std=0.1),
            scale=2.0,
            clip=(-1.0, 1.0),
            history_length=3,
            delay_max_lag=2,
        )
        rates: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel, scale=(0.1, 0.2))
        enable_corruption: bool = True

    @configclass
    class OtherCfg(ObservationGroupCfg):
        """The cart, normalised by the environment."""

        joints: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos)
        done: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)
        normalization: RunningNormCfg = RunningNormCfg(eps=0.5)

    policy: PolicyCfg = PolicyCfg()
    other: OtherCfg = OtherCfg()


@configclass
class GainsCfg(EventsCfg):
    """Robots that differ."""

    gains: EventTermCfg = EventTermCfg(
        func=mdp.randomize_actuator_gains,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", joint_names=[CART]),
            "stiffness_distribution_params": (0.5, 0.8),
            "operation": "scale",
        },
    )


def env_cfg(**actions: Any) -> CartpoleManagerEnvCfg:
    cfg = CartpoleManagerEnvCfg(seed=1)
    cfg.sim.device, cfg.scene.num_envs = "cpu", 3
    cfg.sim.solver = MuJoCoSolverCfg(disable_contacts=True)
    cfg.actions.joint_effort = mdp.JointPositionActionCfg(
        joint_names=[".*"], scale={CART: 0.5, POLE: 2.0}, clip={POLE: (-0.2, 0.3)}, **actions
    )
    group = DelayedPDActuatorCfg(
        joint_names_expr=[CART], stiffness=30.0, damping=3.0, effort_limit=50.0, min_delay=1, max_delay=2
    )
    cfg.scene.robot.actuators = {"cart": group}
    cfg.scene.robot.init_state.joint_pos = {CART: 0.0, POLE: 0.25}
    cfg.observations = SeenCfg()
    cfg.events = GainsCfg()
    return cfg


def agent_cfg(groups: tuple[str, ...] = ("policy", "other")) -> CartpoleManagerPPORunnerCfg:
    agent = CartpoleManagerPPORunnerCfg(obs_groups={"actor": list(groups), "critic": list(groups)})
    agent.algorithm.num_mini_batches = 1
    return agent


def make_runner(env: Any) -> OnPolicyRunner:
    agent = agent_cfg(tuple(g for g in ("policy", "other") if g in env.single_observation_space.spaces))
    return OnPolicyRunner(RslRlVecEnvWrapper(env), agent)


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> tuple[Any, dict[str, Any], Path]:
    """An environment that has taken some steps, the metadata, and the file."""
    env = ManagerBasedRLEnv(env_cfg())
    runner = make_runner(env)
    for _ in range(4):
        runner.env.step(torch.rand(3, 2))
    found = export_policy(runner, tmp_path_factory.mktemp("out"), task="Poles-v0")
    return runner.env, read_policy_metadata(found.onnx), found.onnx


def test_the_robot(exported):
    env, metadata, _ = exported
    robot, data = metadata["assets"]["robot"], env.unwrapped.scene["robot"].data
    assert robot["joint_names"] == [CART, POLE]
    assert robot["default_joint_pos"] == [0.0, 0.25]
    assert robot["fixed_base"]
    stiffness = data.joint_stiffness[:, 0]
    assert ((stiffness >= 15.0) & (stiffness <= 24.0)).all()  # as it is now
    assert robot["stiffness"][0] == 30.0  # as it was made
    assert (robot["damping"][0], robot["effort_limit"][0]) == (3.0, 50.0)
    assert robot["varies"] == ["stiffness"]
    np.testing.assert_allclose(robot["armature"], data.joint_armature[0])
    group = robot["actuators"]["cart"]
    assert (group["type"], group["joint_names"], group["min_delay"], group["max_delay"]) == (
        "DelayedPDActuatorCfg", [CART], 1, 2,
    )  # fmt: skip
    assert metadata["rates"]["step_dt"] == pytest.approx(
        metadata["rates"]["physics_dt"] * metadata["rates"]["decimation"]
    )
    assert (metadata["solver"]["type"], metadata["solver"]["disable_contacts"]) == ("MuJoCoSolverCfg", True)


def test_actions_become_targets_as_they_say(exported):
    env, metadata, _ = exported
    (term,) = metadata["actions"]["terms"]
    assert (term["type"], term["joint_names"], term["first"], term["size"]) == (
        "JointPositionAction", [CART, POLE], 0, 2,
    )  # fmt: skip
    assert term["clip"] == [[None, None], [-0.2, 0.3]]
    for action in (torch.tensor([0.3, 0.01]), torch.tensor([-2.0, 0.5])):
        env.step(action.repeat(3, 1))
        raw = np.array(term["scale"]) * action.numpy() + np.array(term["offset"])
        expected = [raw[0], np.clip(raw[1], -0.2, 0.3)]
        np.testing.assert_allclose(env.unwrapped.processed_actions[0].numpy(), expected, rtol=1e-6)


def test_observations(exported):
    env, metadata, _ = exported
    policy, other = metadata["observations"]
    assert [(g["name"], g["shape"]) for g in (policy, other)] == [("policy", [5]), ("other", [4])]
    angle, rates = policy["terms"]
    assert angle == {
        "name": "angle",
        "function": "stripe_kernels.mdp.observations:joint_pos",
        "params": {"asset_cfg": {"name": "robot", "joint_names": [POLE]}},
        "first": 0,
        "size": 1,
        "scale": 2.0,
        "clip": [-1.0, 1.0],
        "history_length": 3,
        "history_order": "oldest first",
        "modifiers": [],
        "noise": {"type": "GaussianNoiseCfg", "operation": "add", "mean": 0.0, "std": 0.1},
        "delay_steps": [0, 2],
    }
    assert (rates["first"], rates["size"], rates["scale"], rates["noise"]) == (3, 2, [0.1, 0.2], None)
    data = env.unwrapped.scene["robot"].data
    seen = env.get_observations()["policy"][:, 3:]
    np.testing.assert_allclose(seen, data.joint_vel * torch.tensor(rates["scale"]), rtol=1e-6)
    norm = other["normalization"]
    assert (norm["inside"], norm["eps"], norm["clip"]) == (False, 0.5, 10.0)
    assert len(norm["mean"]) == len(norm["std"]) == 4
    assert min(norm["std"][:2]) > 0.0
    assert policy["normalization"] is None


def test_onnx_file_has_a_string_of_json_for_each_part(exported):
    _, metadata, path = exported
    stored = {p.key: p.value for p in onnx.load(str(path)).metadata_props}
    assert {key: json.loads(stored[key]) for key in metadata} == metadata
    assert metadata["task"] == "Poles-v0"


def test_other_joints_and_observations_are_refused_by_name(exported):
    _, _, path = exported
    cfg = env_cfg(preserve_order=True)
    cfg.actions.joint_effort.joint_names = [POLE, CART]
    cfg.observations.policy.angle.history_length = 2
    cfg.observations.policy.rates.params = {"asset_cfg": SceneEntityCfg("robot", joint_names=[CART])}
    cfg.observations.policy.rates.scale = 1.0
    env = RslRlVecEnvWrapper(ManagerBasedRLEnv(cfg))
    with pytest.raises(CheckpointError) as caught:
        OnnxPolicy(path, env)
    assert str(caught.value).splitlines() == [
        f"{path} (of Poles-v0) does not fit this environment:",
        "  observations 'policy': the policy reads angle (3), rates (2); the environment has angle (2), rates (1)",
        f"  joints: the policy moves {CART}, {POLE}; the environment has {POLE}, {CART}",
    ]


def test_a_direct_environment_says_what_it_can(tmp_path):
    cfg = CartCfg(seed=1)
    runner = make_runner(CartEnv(cfg))
    found = export_policy(runner, tmp_path)
    metadata = found.metadata
    assert metadata["actions"] == {"size": 1, "clip": None, "terms": None}
    assert metadata["observations"] == [{"name": "policy", "shape": [4], "terms": None}]
    assert metadata["commands"] == {}
    assert metadata["assets"]["robot"]["joint_names"] == [CART, POLE]
    assert metadata["rates"] == {"physics_dt": 0.01, "decimation": 2, "step_dt": 0.02}
    OnnxPolicy(found.onnx, runner.env)
    model = onnx.load(str(found.onnx))
    stored = next(p for p in model.metadata_props if p.key == "assets")
    stored.value = stored.value.replace(CART, "left_wheel")
    onnx.save_model(model, str(found.onnx))
    with pytest.raises(CheckpointError) as caught:
        OnnxPolicy(found.onnx, runner.env)
    assert f"  joints of 'robot': the policy moves left_wheel, {POLE}; the environment has {CART}, {POLE}" in str(
        caught.value
    )


def test_plain_values():
    assert plain(np.float32(0.1)) == 0.1
    assert plain(torch.tensor([0.1, 1.5])) == [0.1, 1.5]
    assert plain({"a": (1, float("inf"), None, True), 2: range(2)}) == {"a": [1, None, None, True], "2": [0, 1]}
    assert plain(GaussianNoiseCfg(std=0.5)) == {
        "type": "GaussianNoiseCfg", "func": "stripe_newton.noise:gaussian_noise", "operation": "add", "mean": 0.0,
        "std": 0.5,
    }  # fmt: skip
    assert plain(mdp.joint_pos) == "stripe_kernels.mdp.observations:joint_pos"
    assert json.dumps(plain(np.arange(3))) == "[0, 1, 2]"


def test_sensors_that_terms_read():
    scan = RayCasterCfg(prim_path="/Robot/base", pattern_cfg=GridPatternCfg(resolution=0.1, size=(1.6, 1.0)))
    there = {"scan": SimpleNamespace(cfg=scan), "feet": SimpleNamespace(cfg=None)}
    terms = [{"params": {"sensor_cfg": {"name": "scan"}}}, {"params": {"asset_cfg": {"name": "robot"}, "std": 0.5}}]
    found = plain(sensors(there, [{"terms": terms}, {"terms": None}]))
    assert list(found) == ["scan"]
    assert (found["scan"]["pattern_cfg"]["resolution"], found["scan"]["pattern_cfg"]["size"]) == (0.1, [1.6, 1.0])


@pytest.fixture
def task() -> Iterator[str]:
    """The environment above as a task."""
    name = "Test-Export-Poles-v0"
    here = "tests.rl.export.test_export_metadata"
    register_task(
        name, env="stripe_newton.envs:ManagerBasedRLEnv", env_cfg=f"{here}:env_cfg", rsl_rl_cfg=f"{here}:agent_cfg"
    )
    yield name
    del gymnasium.registry[name]


def test_export_of_a_run_with_its_robot(task, capsys, monkeypatch):
    """The command; what the environment normalises by comes from the checkpoint."""
    from stripe_newton.cli import train

    monkeypatch.setattr(train, "record_video", lambda *args, **kwargs: None)
    assert main(["train", task, "--device", "cpu", "--max-iterations", "1"]) == 0
    (run,) = (path for path in Path("logs").glob("*/*") if path.is_dir())
    assert main(["export", str(run), "--mjcf", "--out", "out", "--device", "cpu"]) == 0
    assert "out/robot.xml" in capsys.readouterr().out
    assert "<mujoco" in Path("out/robot.xml").read_text()
    one, other = read_policy_metadata(run), read_policy_metadata("out")
    for part in ("assets", "actions", "observations", "rates", "task", "run", "iteration"):
        assert one[part] == other[part]
    assert one["observations"][1]["normalization"]["std"][0] != 1.0
    command = ["play", task, "--checkpoint", "out/policy.onnx", "--viewer", "none", "--num-envs", "2", "--steps", "3"]
    assert main([*command, "--device", "cpu"]) == 0


def test_an_asset_without_the_names_of_its_joints_is_named():
    problems = list(mismatches({"joint_oames": ["a"], "default_joint_pos": [0.0]}, ArticulationInfo, "assets.robot"))
    assert problems == ["assets.robot.joint_names: is missing, must be a sequence of texts"]
