# SPDX-License-Identifier: Apache-2.0
"""Laws of explicit actuators, against float64 and against Newton's own actuators on random states."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.actuators import DCMotorCfg, DelayedPDActuatorCfg, IdealPDActuatorCfg, ImplicitActuatorCfg
from stripe_newton.sim import FeatherstoneSolverCfg
from tests.helpers.actuator_world import (
    I_MAX,
    JOINTS,
    KD,
    KI,
    KP,
    LATE,
    LIMIT,
    NO_LOAD,
    SATURATION,
    TABLE,
    Drill,
    actuator_scene,
    reset_mask,
)  # fmt: skip
from tests.helpers.small_scenes import DT, MASS, make_scene, mjcf_robot, numpy, sim_cfg, sliders


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return actuator_scene(tmp_path_factory.mktemp("robot"))


def motor_range(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Effort within the line through (0, saturation) and (no-load speed, 0) and within the limit, in float64."""
    meeting = NO_LOAD * (1.0 + LIMIT / SATURATION)
    v = np.clip(v, -meeting, meeting)
    line = np.poly1d([-SATURATION / NO_LOAD, SATURATION])
    return np.maximum(-line(-v), -LIMIT), np.minimum(line(v), LIMIT)


class Reference:
    """Efforts of the actuators of ``KINDS``, in float64; a row for each environment."""

    def __init__(self, num_envs: int, lags: dict[str, np.ndarray]):
        self.lags, self.integral = lags, np.zeros(num_envs)
        self.past: list[list[np.ndarray]] = [[] for _ in range(num_envs)]

    def reset(self, env: int, lags: dict[str, np.ndarray]) -> None:
        self.integral[env], self.past[env], self.lags = 0.0, [], lags

    def __call__(self, q: np.ndarray, v: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Asked and given efforts; ``targets`` of shape ``(3, num_envs, joints)``."""
        seen = targets.copy()
        for env, past in enumerate(self.past):
            past.append(targets[:, env])
            for joint, lag in self.lags.items():
                i = JOINTS.index(joint)
                seen[:, env, i] = past[max(len(past) - 1 - lag[env], 0)][:, i]
        asked = KP * (seen[0] - q) + KD * (seen[1] - v) + seen[2]
        pid = JOINTS.index("pid")
        self.integral = np.clip(self.integral + DT * (seen[0] - q)[:, pid], -I_MAX, I_MAX)
        asked[:, pid] += KI * self.integral
        given = np.clip(asked, -LIMIT, LIMIT)
        motor, remote = JOINTS.index("motor"), JOINTS.index("remote")
        given[:, motor] = np.clip(asked[:, motor], *motor_range(v[:, motor]))
        most = np.interp(q[:, remote], [row[0] for row in TABLE], [row[2] for row in TABLE])
        given[:, remote] = np.clip(asked[:, remote], -most, most)
        return asked, given


def lags_of(scene) -> dict[str, np.ndarray]:
    drives = scene.sim.actuation.drives
    slots, lags = drives.delay_slot.numpy(), drives.lag.numpy()
    dofs = scene["robot"].layout.dofs
    return {name: lags[:, slots[dofs[i]]] for i, name in enumerate(JOINTS) if slots[dofs[i]] >= 0}


def test_every_law_on_random_states(scene):
    """Positions, velocities and targets are new in each step; environment 2 begins anew in between."""
    drill, robot = Drill(scene), scene["robot"]
    scene.controller.reset_robots()
    reference = Reference(4, lags_of(scene))
    explicit = [i for i, name in enumerate(JOINTS) if name != "solver"]
    bound = free = 0
    for step in range(40):
        if step == 17:
            scene.sim.clear_solver(reset_mask(scene, [2]))
            reference.reset(2, lags_of(scene))
        drill.targets()
        drill.state()
        data = robot.data
        before = numpy(data.joint_pos), numpy(data.joint_vel)
        targets = np.array([numpy(getattr(data, f"joint_{k}_target")) for k in ("pos", "vel", "effort")])
        scene.sim.step(1)
        asked, given = reference(*before, targets)
        np.testing.assert_allclose(numpy(data.computed_torque), asked, rtol=2e-5, atol=2e-5)
        np.testing.assert_allclose(numpy(data.applied_torque)[:, explicit], given[:, explicit], rtol=2e-5, atol=2e-5)
        clipped = np.abs(asked - given)[:, explicit] > 1e-3
        bound, free = bound + clipped.sum(axis=0), free + (~clipped).sum(axis=0)
    assert (bound > 5).all()
    assert (free > 5).all()
    assert {int(x) for x in reference.lags["late"]} <= set(range(LATE[0], LATE[1] + 1))
    np.testing.assert_array_equal(reference.lags["late"], reference.lags["later"])


def test_newtons_own_actuators_give_the_same(scene):
    """The one launch against ``newton.actuators.Actuator.step``, to the last digits."""
    drill, sim = Drill(scene, seed=1), scene.sim
    control = sim.model.control()
    scene.controller.reset_robots()
    late = [a for a in sim.model.actuators if a.delay is not None]
    own = lags_of(scene)
    dofs = list(scene["robot"].layout.dofs)
    for actuator in late:
        mine = [JOINTS[dofs.index(d)] for d in actuator.indices.numpy() if d in dofs]
        actuator.delay.delay_steps.assign(np.stack([own[name] for name in mine], axis=1).ravel().astype(np.int32))
    states = [(a.state(), a.state()) if a.is_stateful() else (None, None) for a in sim.model.actuators]
    assert len(late) == 2
    for step in range(30):
        drill.targets()
        drill.state()
        for name in ("joint_target_q", "joint_target_qd", "joint_act"):
            wp.copy(getattr(control, name), getattr(sim.control, name))
        sim.actuation.launch()
        control.joint_f.zero_()
        for actuator, pair in zip(sim.model.actuators, states, strict=True):
            actuator.step(sim.state, control, *(pair if step % 2 == 0 else pair[::-1]), dt=DT)
        explicit = np.tile(sim.actuation.explicit, 4)
        mine, theirs = sim.control.joint_f.numpy()[explicit], control.joint_f.numpy()[explicit]
        np.testing.assert_allclose(mine, theirs, rtol=3e-6, atol=3e-6)


@pytest.mark.parametrize(
    ("speed", "low", "high"),
    [
        (0.0, -6.0, 6.0), (2.0 / 3.0, -6.0, 6.0), (1.0, -6.0, 4.5), (2.0, -6.0, 0.0), (3.0, -6.0, -4.5),
        (10.0 / 3.0, -6.0, -6.0), (50.0, -6.0, -6.0), (-1.0, -4.5, 6.0), (-2.0, 0.0, 6.0), (-50.0, 6.0, 6.0),
    ],
)  # fmt: skip
def test_the_torque_speed_curve_at_its_corners(scene, speed, low, high):
    robot = scene["robot"]
    i = JOINTS.index("motor")
    for effort, expected in ((1000.0, high), (-1000.0, low)):
        scene.controller.reset_robots()
        robot.write_joint_velocity_to_sim(torch.full((4, 1), speed), [i])
        robot.set_joint_effort_target(torch.full((4, 1), effort), [i])
        scene.sim.actuation.launch()
        assert robot.data.applied_torque[:, i].tolist() == pytest.approx([expected] * 4, abs=1e-5)


def test_a_delay_shifts_a_step_of_the_target_by_its_lag(scene):
    robot, i = scene["robot"], JOINTS.index("late")
    scene.controller.reset_robots()
    lags = lags_of(scene)["late"]
    scene.sim.step(10)
    robot.set_joint_effort_target(torch.full((4, 1), 1.0), [i])
    felt = []
    for _ in range(LATE[1] + 2):
        scene.sim.step(1)
        felt.append(numpy(robot.data.computed_torque)[:, i] > 0.5)
    np.testing.assert_array_equal(np.array(felt).argmax(axis=0), lags)


def test_what_is_no_number_stays_visible(scene):
    robot = scene["robot"]
    scene.controller.reset_robots()
    robot.write_joint_position_to_sim(torch.full((1, 7), float("nan")), env_ids=[1])
    scene.sim.actuation.launch()
    explicit = [i for i, name in enumerate(JOINTS) if name != "solver"]
    torque = robot.data.computed_torque
    assert torch.isnan(torque[1]).all()
    assert torch.isfinite(torque[[0, 2, 3]]).all()
    assert torch.isnan(scene.sim.per_env(scene.sim.control.joint_f)[1, robot.layout.dofs][explicit]).all()
    scene.controller.reset_robots()
    scene.sim.step(1)
    assert torch.isfinite(robot.data.applied_torque).all()


# -- gains


@pytest.mark.parametrize("name", ["pd", "pid", "motor", "late", "remote", "solver"])
def test_gains_are_views_of_what_is_used(scene, name):
    """Written into the struct that terms read, on the device, they act in the next physics step."""
    robot, i = scene["robot"], JOINTS.index(name)
    struct, data = robot.data.struct, robot.data
    assert data.joint_stiffness[:, i].tolist() == [KP] * 4
    assert data.joint_damping[:, i].tolist() == [KD] * 4
    gains = {"joint_stiffness": 10.0, "joint_damping": 1.0, "joint_effort_limit": 1.25}
    before = {key: wp.to_torch(getattr(struct, key))[:, i].clone() for key in gains}
    try:
        for key, value in gains.items():
            wp.to_torch(getattr(struct, key))[2, i] = value
        scene.controller.reset_robots()
        robot.write_joint_state_to_sim(torch.full((4, 1), -0.02), torch.full((4, 1), 0.1), [i])
        scene.sim.actuation.launch()
        integral = KI * DT * 0.02 if name == "pid" else 0.0
        expected = [KP * 0.02 - KD * 0.1 + integral] * 4
        expected[2] = 10.0 * 0.02 - 0.1 + integral
        assert data.computed_torque[:, i].tolist() == pytest.approx(expected, rel=1e-5)
        robot.write_joint_state_to_sim(torch.full((4, 1), -0.3), torch.zeros(4, 1), [i])
        scene.sim.notify(-1)
        scene.sim.step(1)
        assert float(data.applied_torque[2, i]) == pytest.approx(1.25, rel=1e-5)
        assert (data.applied_torque[[0, 1, 3], i] > 1.3).all()
    finally:
        for key, value in before.items():
            wp.to_torch(getattr(struct, key))[:, i] = value
        scene.sim.notify(-1)


# -- other solvers


def test_another_solver_moves_by_the_same_laws(tmp_path):
    """Featherstone knows no modes of drives: it must not see the gains of explicit actuators."""
    scene = actuator_scene(tmp_path, sim=sim_cfg(solver=FeatherstoneSolverCfg(angular_damping=0.0)))
    drill, robot = Drill(scene), scene["robot"]
    reference = Reference(4, lags_of(scene))
    v = numpy(robot.data.joint_vel)
    for _ in range(25):
        drill.targets()
        q, data = numpy(robot.data.joint_pos), robot.data
        targets = np.array([numpy(getattr(data, f"joint_{k}_target")) for k in ("pos", "vel", "effort")])
        scene.sim.step(1)
        asked, given = reference(q, v, targets)
        i = JOINTS.index("solver")
        given[:, i] = asked[:, i]  # this solver knows no limits
        np.testing.assert_allclose(numpy(data.joint_vel), v + DT * given / MASS, atol=2e-4)
        np.testing.assert_allclose(numpy(data.computed_torque), asked, rtol=1e-4, atol=1e-3)
        v = numpy(data.joint_vel)
    assert robot.data.joint_stiffness[0].tolist() == [KP] * 7
    limited = np.clip(asked[:, i], -LIMIT, LIMIT)
    np.testing.assert_allclose(numpy(robot.data.applied_torque)[:, i], limited, rtol=1e-4, atol=1e-3)


def test_gains_written_while_another_solver_runs(tmp_path):
    drive = {"all": ImplicitActuatorCfg(joint_names_expr=["a"], stiffness=100.0, damping=0.0)}
    drive["b"] = IdealPDActuatorCfg(joint_names_expr=["b"], stiffness=100.0, damping=0.0, effort_limit=1e6)
    scene = actuator_scene(tmp_path, drive, ["a", "b"], sim=sim_cfg(solver=FeatherstoneSolverCfg()))
    robot = scene["robot"]
    robot.set_joint_position_target(torch.full((4, 2), 1.0))
    robot.write_joint_stiffness_to_sim(torch.tensor([[10.0, 20.0]]), env_ids=[3])
    scene.sim.step(1)
    expected = np.array([[100.0, 100.0]] * 3 + [[10.0, 20.0]]) / MASS * DT
    np.testing.assert_allclose(numpy(robot.data.joint_vel), expected, rtol=1e-4)


# -- where they fit


def test_ball_joints_before_others_do_not_shift_them(tmp_path):
    """A ball joint has four coordinates and three degrees of freedom."""
    base = '<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>'
    text = (
        f'<mujoco><worldbody><body name="base">{base}<body name="ball"><joint name="ball" type="ball"/>{base}</body>'
        f'<body name="x"><joint name="x" type="slide" axis="1 0 0"/>{base}</body></body></worldbody></mujoco>'
    )
    drive = {"x": IdealPDActuatorCfg(joint_names_expr=["x"], stiffness=100.0, damping=0.0, effort_limit=1e3)}
    scene = make_scene({"robot": mjcf_robot(tmp_path, text, actuators=drive)}, sim=sim_cfg(gravity=(0, 0, 0)))
    wp.to_torch(scene.sim.control.joint_target_q).view(2, -1)[:, -1] = 0.25
    scene.sim.step(1)
    assert scene["robot"].data.joint_vel[:, 3].tolist() == pytest.approx([100.0 * 0.25 * DT] * 2, rel=1e-4)
    wrong = {"ball": IdealPDActuatorCfg(joint_names_expr=["ball:1"], stiffness=1.0)}
    with pytest.raises(ValueError, match="joint 'ball:1' is a ball joint, which ImplicitActuatorCfg alone drives"):
        make_scene({"robot": mjcf_robot(tmp_path, text, actuators=wrong)})


def test_delays_without_range_and_without_delay(tmp_path):
    kinds = {
        "a": DelayedPDActuatorCfg(joint_names_expr=["a"], stiffness=1.0, damping=0.0, min_delay=2, max_delay=2),
        "b": DelayedPDActuatorCfg(joint_names_expr=["b"], stiffness=1.0, damping=0.0),
    }
    scene = actuator_scene(tmp_path, kinds, ["a", "b"], num_envs=2)
    robot = scene["robot"]
    asked = []
    for step in range(5):
        robot.set_joint_effort_target(torch.full((2, 2), float(step)))
        scene.sim.actuation.launch()
        asked.append(robot.data.computed_torque[0].tolist())
    assert asked == [[0.0, 0.0], [0.0, 1.0], [0.0, 2.0], [1.0, 3.0], [2.0, 4.0]]


def test_fields_of_a_file_hold_where_the_config_is_silent(tmp_path):
    text = sliders({"a": "1 0 0"}).replace('axis="1 0 0"', 'axis="1 0 0" actuatorfrcrange="-3 3"')
    motor = DCMotorCfg(joint_names_expr=["a"], stiffness=1.0, damping=0.0, saturation_effort=50.0, velocity_limit=4.0)
    scene = make_scene({"robot": mjcf_robot(tmp_path, text, actuators={"a": motor})})
    assert scene["robot"].data.joint_effort_limits.tolist() == [[3.0], [3.0]]
    assert scene["robot"].data.joint_vel_limits.tolist() == [[4.0], [4.0]]
