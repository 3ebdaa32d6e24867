# SPDX-License-Identifier: Apache-2.0
"""Jacobians, mass matrices, gravity compensation and joint wrenches are those of plain MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from stripe_newton.math import quat_apply_inverse
from stripe_newton.scene import InteractiveScene
from tests.helpers.small_scenes import ARM, make_scene, mjcf_robot, numpy, sim_cfg

FLOATING = ARM.replace('<body name="base">', '<body name="base" pos="0 0 1"><freejoint/>')
POSE = {"shoulder": 0.4, "elbow": -0.7, "grip": 0.15}
SPEED = {"shoulder": 0.8, "elbow": -1.2, "grip": 0.3}


def plain(text: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """MuJoCo's model and its state in the pose and at the speeds of the test."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = 0.002
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    for name, value in POSE.items():
        data.joint(name).qpos[:] = value
        data.joint(name).qvel[:] = SPEED[name]
    mujoco.mj_forward(model, data)
    return model, data


def built(folder, text: str, order: str, **sim) -> InteractiveScene:
    robot = mjcf_robot(folder, text, fix_base=None, joint_order=order)
    robot.init_state = robot.init_state.replace(pos=None, rot=None, joint_pos=POSE, joint_vel=SPEED)
    return make_scene({"robot": robot}, sim=sim_cfg(**sim))


@pytest.mark.parametrize("order", ["file", "breadth_first"])
@pytest.mark.parametrize("text", [ARM, FLOATING], ids=["fixed", "floating"])
def test_jacobians_masses_and_gravity_are_those_of_mujoco(tmp_path, text, order):
    scene = built(tmp_path, text, order)
    robot, (model, data) = scene["robot"], plain(text)
    dynamics, root = robot.dynamics, 6 if text is FLOATING else 0
    assert dynamics.jacobians().shape == (2, robot.num_bodies, 6, root + robot.num_joints)

    # Newton's root columns are those of the centre of mass, MuJoCo's of the origin: the joints alone are compared.
    columns = [model.joint(n).dofadr[0] for n in robot.joint_names]
    for index, name in enumerate(robot.body_names):
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, linear, angular, model.body(name).id)
        expected = np.concatenate((linear, angular))[:, columns]
        for env in range(2):
            np.testing.assert_allclose(dynamics.jacobians()[env, index, :, root:], expected, atol=1e-5, err_msg=name)

    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    np.testing.assert_allclose(
        dynamics.mass_matrices()[1, root:, root:], full[np.ix_(columns, columns)], rtol=1e-4, atol=1e-5
    )
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(dynamics.gravity_compensation()[1, root:], data.qfrc_bias[columns], atol=1e-4)


def test_joint_velocities_times_jacobians_are_body_velocities(tmp_path):
    scene = built(tmp_path, FLOATING, "breadth_first")
    robot = scene["robot"]
    robot.write_root_velocity_to_sim(torch.tensor([[0.3, -0.2, 0.1, 0.5, 0.4, -0.6]]).repeat(2, 1))
    scene.sim.forward()
    speeds = torch.cat((robot.data.root_vel_w, robot.data.joint_vel), dim=-1)
    found = torch.einsum("nbic,nc->nbi", robot.dynamics.jacobians(), speeds)
    np.testing.assert_allclose(numpy(found), numpy(robot.data.body_vel_w), atol=1e-5)
    energy = 0.5 * torch.einsum("nc,ncd,nd->n", speeds, robot.dynamics.mass_matrices(), speeds)
    linear, angular = robot.data.body_lin_vel_w, quat_apply_inverse(robot.data.body_quat_w, robot.data.body_ang_vel_w)
    own = 0.5 * (robot.data.body_mass * linear.square().sum(dim=-1)).sum(dim=1)
    own += 0.5 * torch.einsum("nbi,nbij,nbj->n", angular, robot.data.body_inertia, angular)
    np.testing.assert_allclose(numpy(energy), numpy(own), rtol=1e-5)


def test_joint_wrenches_carry_what_hangs_on_them(tmp_path):
    """In motion, beside MuJoCo's interaction forces; refused where the solver was not asked for them."""
    scene = built(tmp_path, ARM, "file", observables=("body_parent_f",))
    robot, (model, data) = scene["robot"], plain(ARM)
    scene.sim.step(1)
    # The solver reports what acted in the step, so at its beginning, 1.6 mrad before the pose that it is turned by.
    mujoco.mj_rnePostConstraint(model, data)
    wrenches = robot.dynamics.incoming_joint_wrenches()
    for name in ("upper", "lower", "hand"):
        body = model.body(name).id
        torque, force = data.cfrc_int[body, :3], data.cfrc_int[body, 3:]
        torque = torque + np.cross(data.subtree_com[model.body_rootid[body]] - data.xpos[body], force)
        turn = data.xmat[body].reshape(3, 3).T
        expected = np.concatenate((turn @ force, turn @ torque))
        np.testing.assert_allclose(wrenches[0, robot.body_names.index(name)], expected, atol=0.03, err_msg=name)
    plain_scene = built(tmp_path, ARM, "file")
    with pytest.raises(RuntimeError, match=r"set sim.observables=\('body_parent_f',\)"):
        plain_scene["robot"].dynamics.incoming_joint_wrenches()
