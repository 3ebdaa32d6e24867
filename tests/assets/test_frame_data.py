# SPDX-License-Identifier: Apache-2.0
"""Frames of a body at its link and at its centre of mass, against SciPy, on a body whose centre of mass is off."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.helpers.small_scenes import COM, LOPSIDED, make_scene, mjcf_robot, numpy

POSE = np.array([[0.3, -0.4, 1.2], [-2.0, 0.5, 0.7]])
TURN = Rotation.from_euler("xyz", [[0.3, -0.8, 1.9], [-1.1, 0.4, 0.2]])
LINEAR = np.array([[0.5, 1.5, -0.7], [2.0, -0.3, 0.1]])
ANGULAR = np.array([[1.0, -2.0, 0.5], [0.2, 3.0, -1.4]])
ARM = TURN.apply(COM)


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    return make_scene({"body": mjcf_robot(folder, LOPSIDED, fix_base=None)})["body"]


def rows(*parts: np.ndarray) -> torch.Tensor:
    return torch.tensor(np.hstack(parts), dtype=torch.float32)


def check(body, pos: np.ndarray, linear: np.ndarray) -> None:
    """Compare every quantity with the state in which the link is at ``pos`` and its origin moves with ``linear``."""
    data, quat, com = body.data, TURN.as_quat(), pos + ARM
    at_com = linear + np.cross(ANGULAR, ARM)
    body_frame = TURN.inv().apply
    expected = {
        "link_pose_w": np.hstack([pos, quat]),
        "link_vel_w": np.hstack([linear, ANGULAR]),
        "link_state_w": np.hstack([pos, quat, linear, ANGULAR]),
        "com_pose_w": np.hstack([com, quat]),
        "com_vel_w": np.hstack([at_com, ANGULAR]),
        "com_state_w": np.hstack([com, quat, at_com, ANGULAR]),
    }
    for point, position, velocity in (("link", pos, linear), ("com", com, at_com)):
        expected |= {f"{point}_pos_w": position, f"{point}_quat_w": quat}
        expected |= {f"{point}_lin_vel_w": velocity, f"{point}_ang_vel_w": ANGULAR}
    body.write_data_to_sim()
    body._sim.forward()
    for name, value in expected.items():
        np.testing.assert_allclose(numpy(getattr(data, f"root_{name}")), value, atol=2e-6, err_msg=f"root_{name}")
        of_body = numpy(getattr(data, f"body_{name}"))[:, 0]
        np.testing.assert_allclose(of_body, value, atol=2e-6, err_msg=f"body_{name}")
    for point, velocity in (("link", linear), ("com", at_com)):
        for kind, value in (("lin", velocity), ("ang", ANGULAR)):
            found = numpy(getattr(data, f"root_{point}_{kind}_vel_b"))
            np.testing.assert_allclose(found, body_frame(value), atol=2e-6)
    np.testing.assert_allclose(numpy(data.body_com_pose_b)[:, 0], [[*COM, 0, 0, 0, 1]] * 2, atol=1e-6)


def test_states_of_the_link_are_written_and_read(body):
    body.write_root_link_state_to_sim(rows(POSE, TURN.as_quat(), LINEAR, ANGULAR))
    check(body, POSE, LINEAR)


def test_pose_and_velocity_of_the_link_are_written_one_by_one(body):
    body.write_root_link_pose_to_sim(rows(POSE + 1.0, TURN.as_quat()))
    body.write_root_link_velocity_to_sim(rows(-LINEAR, ANGULAR))
    check(body, POSE + 1.0, -LINEAR)


def test_states_of_the_centre_of_mass_are_written_and_read(body):
    body.write_root_com_state_to_sim(rows(POSE, TURN.as_quat(), LINEAR, ANGULAR))
    check(body, POSE - ARM, LINEAR - np.cross(ANGULAR, ARM))


def test_pose_and_velocity_of_the_centre_of_mass_are_written_one_by_one(body):
    body.write_root_com_pose_to_sim(rows(POSE + 2.0, TURN.as_quat())[[1]], env_ids=[1])
    body.write_root_com_pose_to_sim(rows(POSE + 2.0, TURN.as_quat())[[0]], env_ids=[0])
    body.write_root_com_velocity_to_sim(rows(LINEAR, ANGULAR))
    check(body, POSE + 2.0 - ARM, LINEAR - np.cross(ANGULAR, ARM))
