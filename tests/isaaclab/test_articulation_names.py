# SPDX-License-Identifier: Apache-2.0
"""Names that Isaac Lab's articulations, devices and cameras have beside those of the package."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stripe_newton.actuators import IdealPDActuatorCfg, ImplicitActuatorCfg
from stripe_newton.isaaclab import assets, input_devices, point_clouds
from stripe_tasks.robots import CARTPOLE_CFG
from tests.helpers.small_scenes import make_scene


@pytest.fixture(scope="module")
def robot() -> assets.Articulation:
    rail = ImplicitActuatorCfg(joint_names_expr=["slider.*"], stiffness=30.0, damping=2.0, viscous_friction=0.1)
    pole = IdealPDActuatorCfg(joint_names_expr=["cart.*"], stiffness=5.0, damping=0.5, effort_limit=7.0)
    cfg = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", actuators={"rail": rail, "pole": pole})
    return make_scene({"robot": cfg.replace(class_type=assets.Articulation)}).articulations["robot"]


def test_groups_of_actuators_have_their_numbers(robot):
    rail, pole = robot.actuators["rail"], robot.actuators["pole"]
    assert (rail.joint_names, rail.joint_indices.tolist(), rail.is_implicit_model) == (["slider_to_cart"], [0], True)
    assert (pole.num_joints, pole.joint_indices.tolist(), pole.is_implicit_model) == (1, [1], False)
    assert rail.stiffness.tolist() == [[30.0], [30.0]]
    assert pole.effort_limit.tolist() == [[7.0], [7.0]]
    robot.write_joint_stiffness_to_sim(40.0, joint_ids=rail.joint_indices)
    assert rail.stiffness.tolist() == [[40.0], [40.0]]
    assert robot.data.default_joint_stiffness.tolist() == [[30.0, 5.0]] * 2
    with pytest.raises(RuntimeError, match="converted copy"):
        rail.stiffness[:] = 3.0
    with pytest.raises(AttributeError, match="has no 'gear'"):
        _ = rail.gear


def test_limits_of_speed_hold_after_a_step(robot):
    robot.write_joint_velocity_limit_to_sim(torch.tensor([[0.5], [0.25]]), joint_ids=[0])
    robot.write_joint_velocity_to_sim(torch.full((2, 2), 3.0))
    robot._sim.step()
    np.testing.assert_allclose(robot.data.joint_vel[:, 0], [0.5, 0.25])
    assert (robot.data.joint_vel[:, 1] > 1.0).all()
    assert robot.data.joint_vel_limits[:, 0].tolist() == [0.5, 0.25]


def test_viscous_friction_slows_a_joint(robot):
    assert robot.data.joint_viscous_friction_coeff[:, 0].tolist() == pytest.approx([0.1, 0.1])
    robot.write_joint_viscous_friction_coefficient_to_sim(200.0, joint_ids=[1], env_ids=[1])
    robot.write_joint_velocity_to_sim(torch.ones(2, 2))
    robot._sim.step(10)
    assert abs(float(robot.data.joint_vel[1, 1])) < 0.2 < abs(float(robot.data.joint_vel[0, 1]))


@pytest.mark.parametrize(("kind", "size"), [(input_devices.Se2Device, 3), (input_devices.Se3Device, 7)])
def test_devices_are_never_touched(kind, size):
    device = kind("config")
    device.add_callback("R", device.reset)
    device.reset()
    assert device.advance()[:3].tolist() == [0.0, 0.0, 0.0]
    assert len(device.advance()) == size


def test_point_clouds_are_pinhole_projections_undone():
    matrix = np.array([[50.0, 0.0, 2.0], [0.0, 60.0, 1.5], [0.0, 0.0, 1.0]], dtype=np.float32)
    depth = np.arange(1.0, 13.0, dtype=np.float32).reshape(3, 4)
    depth[1, 2] = np.inf
    image = np.stack((depth, 2.0 * depth, 3.0 * depth), axis=-1)  # a colour that tells the pixel
    points, colors = point_clouds.create_pointcloud_from_rgbd(matrix, depth, np.nan_to_num(image, posinf=0.0))
    assert points.shape == colors.shape == (11, 3)
    np.testing.assert_allclose(colors, points[:, 2:] * [1.0, 2.0, 3.0])
    pixels = points @ matrix.T / points[:, 2:]
    rows, columns = np.divmod(points[:, 2] - 1.0, 4)
    np.testing.assert_allclose(pixels[:, 0], columns, atol=1e-5)
    np.testing.assert_allclose(pixels[:, 1], rows, atol=1e-5)
    alone = point_clouds.create_pointcloud_from_depth(
        torch.from_numpy(matrix), torch.from_numpy(depth), position=(1.0, 2.0, 3.0), orientation=(0.0, 1.0, 0.0, 0.0)
    )
    expected = points * [1.0, -1.0, -1.0] + [1.0, 2.0, 3.0]  # half a turn about x, (w, x, y, z)
    np.testing.assert_allclose(alone, expected, atol=1e-5)
    with pytest.raises(ValueError, match="num_channels: is 2"):
        point_clouds.create_pointcloud_from_rgbd(matrix, depth, num_channels=2)
