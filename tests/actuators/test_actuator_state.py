# SPDX-License-Identifier: Apache-2.0
"""Actuator state: resets, environments and seeds; stages with actuators; errors of configs."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.actuators import (
    ActuatorNetLSTMCfg,
    ActuatorNetMLPCfg,
    DCMotorCfg,
    DelayedPDActuatorCfg,
    ImplicitActuatorCfg,
    PIDActuatorCfg,
)
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.robots import CARTPOLE_CFG
from tests.helpers.actuator_world import GAINS, JOINTS, KINDS, LATE, Drill, actuator_scene, reset_mask
from tests.helpers.small_scenes import make_scene, sim_cfg
from tools.checks.model_arrays import different_arrays


@pytest.fixture(scope="module")
def networks(tmp_path_factory):
    """Configs of learned actuators, by name of their joints."""
    folder = tmp_path_factory.mktemp("networks")

    class Memory(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.lstm, self.out = torch.nn.LSTM(2, 4, 2), torch.nn.Linear(4, 1)

        def forward(self, x: torch.Tensor, state: tuple[torch.Tensor, torch.Tensor]):
            y, state = self.lstm(x, state)
            return self.out(y[-1]), state

    torch.manual_seed(0)
    torch.jit.script(Memory()).save(str(folder / "lstm.pt"))
    torch.jit.script(torch.nn.Sequential(torch.nn.Linear(6, 8), torch.nn.Tanh(), torch.nn.Linear(8, 1))).save(
        str(folder / "mlp.pt")
    )
    common = {"effort_limit": 4.0, "saturation_effort": 9.0, "velocity_limit": 5.0}
    mlp = {"input_idx": [0, 1, 2], "pos_scale": 3.0, "torque_scale": 8.0}
    return {
        "lstm": ActuatorNetLSTMCfg(joint_names_expr=["lstm"], network_file=str(folder / "lstm.pt"), **common),
        "mlp": ActuatorNetMLPCfg(joint_names_expr=["mlp"], network_file=str(folder / "mlp.pt"), **mlp, **common),
    }


def arrays_of(scene) -> dict[str, np.ndarray]:
    """State that lasts from step to step, by name."""
    return {name: array.numpy().copy() for name, array in scene.sim.actuation.arrays.items()}


def by_env(name: str, array: np.ndarray, num_envs: int) -> np.ndarray:
    """Environments first; networks have ``(layers, num_envs * joints, width)`` or ``(past, num_envs * joints)``."""
    if "drive_state" in name:
        return np.moveaxis(array, 1, 0).reshape(num_envs, -1)
    return np.moveaxis(array, 1, 0) if name == "history" else array


# -- episodes


def test_a_mask_resets_its_environments_alone(tmp_path, networks):
    scene = actuator_scene(tmp_path, KINDS | networks, [*JOINTS, *networks], num_envs=4)
    drill = Drill(scene)
    for _ in range(9):
        drill.targets()
        scene.sim.step(1)
    before = arrays_of(scene)
    scene.sim.clear_solver(reset_mask(scene, [1, 3]))
    after = arrays_of(scene)
    assert set(after) == {
        "integral", "lag", "pushes", "history", "rng", "0.drive_state.hidden", "0.drive_state.cell",
        "1.drive_state.pos_error_history", "1.drive_state.vel_history",
    }  # fmt: skip
    for name in after:
        old, new = by_env(name, before[name], 4), by_env(name, after[name], 4)
        np.testing.assert_array_equal(new[[0, 2]], old[[0, 2]], err_msg=name)
        if name not in ("lag", "rng", "history"):
            assert np.abs(old).reshape(4, -1).max(axis=1).min() > 0, name
            assert not new[[1, 3]].any(), name
    assert (after["rng"] != before["rng"]).tolist() == [False, True, False, True]


def test_an_environment_does_not_depend_on_how_many_there_are(tmp_path, networks):
    kinds, joints = KINDS | networks, [*JOINTS, *networks]
    few, many = (actuator_scene(tmp_path, kinds, joints, num_envs=n) for n in (2, 5))
    for scene in (few, many):
        drill = Drill(scene)
        for step in range(30):
            if step in (4, 11, 20):
                scene.sim.clear_solver(reset_mask(scene, [1]))
            drill.targets()
            scene.sim.step(1 + step % 3)
    for name, array in arrays_of(few).items():
        other = arrays_of(many)[name]
        np.testing.assert_array_equal(by_env(name, array, 2), by_env(name, other, 5)[:2], err_msg=name)
    for field in ("joint_pos", "joint_vel", "applied_torque", "computed_torque"):
        assert torch.equal(getattr(few["robot"].data, field), getattr(many["robot"].data, field)[:2]), field


def test_lags_are_drawn_uniformly_and_anew(tmp_path):
    kinds = {"late": KINDS["late"]}
    scene = actuator_scene(tmp_path, kinds, ["late", "later"], num_envs=64)
    drawn = []
    for _ in range(60):
        scene.sim.clear_solver(reset_mask(scene, list(range(64))))
        lags = scene.sim.actuation.drives.lag.numpy()
        np.testing.assert_array_equal(lags[:, 0], lags[:, 1])
        drawn.append(lags[:, 0].copy())
    counts = np.bincount(np.array(drawn).ravel(), minlength=LATE[1] + 2)
    assert counts[: LATE[0]].sum() == counts[LATE[1] + 1] == 0
    share = 64 * 60 / 5
    assert np.abs(counts[LATE[0] : LATE[1] + 1] - share).max() < 4.5 * math.sqrt(share * 0.8)
    assert len({tuple(x) for x in drawn}) == 60


@configclass
class _Policy(ObservationGroupCfg):
    joint_pos = ObservationTermCfg(func=mdp.joint_pos)


def _env(num_envs: int = 4) -> ManagerBasedRLEnv:
    """A cart whose motor is late and remembers errors, in episodes of 0.1 to 0.3 s."""
    names = {"joint_names_expr": ["slider_to_cart"], "stiffness": 60.0, "damping": 2.0, "effort_limit": 50.0}
    drives = {
        "cart": DelayedPDActuatorCfg(**names, min_delay=0, max_delay=6),
        "pole": PIDActuatorCfg(joint_names_expr=["cart_to_pole"], stiffness=1.0, damping=0.0, integral_gain=30.0),
    }
    robot = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", actuators=drives)
    cfg = ManagerBasedRLEnvCfg(decimation=2, episode_length_s=0.3)
    cfg.sim = SimulationCfg(device="cpu", dt=0.01, solver=MuJoCoSolverCfg(disable_contacts=True))
    cfg.scene = RobotSceneCfg(num_envs=num_envs, env_spacing=4.0, robot=robot)
    cfg.observations = {"policy": _Policy()}
    cfg.actions = {"cart": mdp.JointPositionActionCfg(joint_names=["slider_to_cart"], scale=0.5)}
    cfg.rewards = {"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)}
    cfg.terminations = {"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)}
    cfg.events = {
        "reset": EventTermCfg(
            func=mdp.reset_joints_by_offset, mode="reset",
            params={"position_range": (-0.2, 0.2), "velocity_range": (-0.2, 0.2)},
        )
    }  # fmt: skip
    return ManagerBasedRLEnv(cfg)


def _roll(env: ManagerBasedRLEnv, steps: int, start: int = 0) -> torch.Tensor:
    seen = []
    for step in range(start, start + steps):
        action = torch.sin(torch.arange(1.0, env.num_envs + 1) * 0.7 * (step + 1)).unsqueeze(1)
        seen.append(env.step(action)[0]["policy"])
        seen.append(wp.to_torch(env.sim.actuation.drives.lag).float())
    return torch.cat(seen, dim=1)


def test_seeds_and_saved_states_cover_actuators():
    env = _env()
    env.reset(seed=5)
    first = _roll(env, 25)
    state = env.get_state()
    rest = _roll(env, 25, 25)
    env.reset(seed=5)
    assert torch.equal(_roll(env, 25), first)
    env.reset(seed=6)
    assert not torch.equal(_roll(env, 25), first)
    env.set_state(state)
    assert torch.equal(_roll(env, 25, 25), rest)
    fresh = _env()
    fresh.reset(seed=9)
    fresh.set_state(state)
    assert torch.equal(_roll(fresh, 25, 25), rest)
    other = _env(num_envs=7)
    other.reset(seed=5)
    columns = torch.tensor([0, 1, 2, 3])
    assert torch.equal(_roll(other, 25)[columns], first)


# -- stages


def test_actuators_of_a_file_are_replaced_not_doubled(tmp_path):
    """A stage with explicit actuators; a config may take their joints over, and keeps the gains it does not name."""
    kinds = {"pd": KINDS["pd"], "late": KINDS["late"], "pid": KINDS["pid"]}
    scene = actuator_scene(tmp_path, kinds, ["pd", "late", "later", "pid"], num_envs=1)
    builder = scene.sim.template
    dofs = {name: scene["robot"].layout.dofs[i] for i, name in enumerate(scene["robot"].joint_names)}
    names = list(dofs)
    again = {
        "solver": ImplicitActuatorCfg(joint_names_expr=["late"], damping=7.0),
        "motor": DCMotorCfg(joint_names_expr=["pd"], saturation_effort=9.0, velocity_limit=3.0, stiffness=11.0),
    }
    for cfg in again.values():
        cfg.apply(builder, names, list(dofs.values()))
    entries = {
        (entry.drive_class.__name__, *(c.__name__ for c in entry.clamping_classes)): entry.indices
        for entry in builder.actuator_entries.values()
    }
    assert entries == {
        ("DrivePD", "ClampingMaxEffort"): [dofs["later"]],
        ("DrivePID", "ClampingMaxEffort"): [dofs["pid"]],
        ("DrivePD", "ClampingDCMotor"): [dofs["pd"]],
    }
    motor = next(e for e in builder.actuator_entries.values() if e.indices == [dofs["pd"]])
    assert (motor.drive_args[0]["kp"], motor.drive_args[0]["kd"]) == (11.0, GAINS["damping"])
    assert builder.joint_target_ke[dofs["late"]] == GAINS["stiffness"]
    assert builder.joint_target_kd[dofs["late"]] == 7.0


def test_every_kind_survives_export_and_import(tmp_path, networks):
    drives = {
        "slider": KINDS["remote"].replace(joint_names_expr=["slider_to_cart"], max_delay=2, min_delay=2),
        "pole": networks["mlp"].replace(joint_names_expr=["cart_to_pole"]),
    }
    more = {
        "slider": KINDS["pid"].replace(joint_names_expr=["slider_to_cart"]),
        "pole": KINDS["motor"].replace(joint_names_expr=["cart_to_pole"], velocity_limit=2.0),
    }
    last = {
        "slider": KINDS["late"].replace(joint_names_expr=["slider_to_cart"]),
        "pole": networks["lstm"].replace(joint_names_expr=["cart_to_pole"]),
    }
    for number, actuators in enumerate((drives, more, last)):
        robot = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", actuators=actuators)
        scene = make_scene({"robot": robot}, sim=sim_cfg())
        path = tmp_path / f"scene{number}.usda"
        if number == 2:
            with pytest.warns(UserWarning, match="USD cannot say that a delay is drawn for each episode"):
                scene.export(path)
            scene.sim.actuation.drives.lag.fill_(LATE[1])
        else:
            scene.export(path)
        again = InteractiveScene.from_usd(path, 2, 3.0, sim_cfg())
        assert len(again.sim.model.actuators) == 2
        assert different_arrays(scene.sim.model, again.sim.model) in ([], ["joint_velocity_limit"])
        speeds = (s.sim.model.joint_velocity_limit.numpy() for s in (scene, again))
        np.testing.assert_allclose(*speeds, rtol=1e-6)  # USD has it in degrees
        robots = [scene["robot"], next(iter(again.articulations.values()))]
        for step in range(20):
            for own in robots:
                own.set_joint_position_target(torch.full((2, 2), 0.3 * math.sin(step)))
                own._sim.step(1)
            for field in ("joint_pos", "computed_torque", "applied_torque"):
                one, two = (getattr(own.data, field) for own in robots)
                torch.testing.assert_close(one, two, rtol=1e-5, atol=1e-5)
