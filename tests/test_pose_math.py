# SPDX-License-Identifier: Apache-2.0
"""Poses, pose matrices, interpolation, projection and samples of stripe_newton.math, against SciPy and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from stripe_newton import math as sm

ROTATIONS = Rotation.random(6, random_state=0)
OTHERS = Rotation.random(6, random_state=1)
Q, P = torch.from_numpy(ROTATIONS.as_quat()), torch.from_numpy(OTHERS.as_quat())
T = torch.from_numpy(np.random.default_rng(0).normal(size=(6, 3)))


def close(actual: torch.Tensor, expected: np.ndarray) -> None:
    np.testing.assert_allclose(actual.numpy(), expected, atol=1e-9)


def test_euler_matrices_and_cross_products():
    angles = np.random.default_rng(1).normal(size=(6, 3))
    for convention in ("XYZ", "ZYX", "ZXZ"):
        expected = Rotation.from_euler(convention, angles).as_matrix()
        close(sm.matrix_from_euler(torch.from_numpy(angles), convention), expected)
    close(sm.skew_symmetric_matrix(T) @ T.flip(0).unsqueeze(-1), np.cross(T, T.flip(0))[..., None])
    for bad in ("XX", "XXY", "XYW"):
        with pytest.raises(ValueError, match="three letters"):
            sm.matrix_from_euler(torch.zeros(3), bad)


def test_differences_of_rotations():
    close(sm.quat_box_minus(Q, P), (ROTATIONS * OTHERS.inv()).as_rotvec())
    turned = Rotation.from_quat(sm.quat_box_plus(Q, T).numpy())
    np.testing.assert_allclose((turned * (Rotation.from_rotvec(T.numpy()) * ROTATIONS).inv()).magnitude(), 0, atol=1e-7)
    for tau in (0.0, 0.25, 1.0):
        expected = [Slerp([0, 1], Rotation.concatenate([a, b]))(tau).as_matrix() for a, b in zip(ROTATIONS, OTHERS)]
        close(sm.matrix_from_quat(sm.quat_slerp(Q, P, tau)), np.array(expected))
    assert torch.equal(sm.quat_slerp(Q, Q, 0.5), Q)


def test_pose_errors_and_displacements_are_inverse():
    move, turn = sm.compute_pose_error(T, Q, T.flip(0), P)
    close(turn, (OTHERS * ROTATIONS.inv()).as_rotvec())
    pos, quat = sm.apply_delta_pose(T, Q, torch.cat((move, turn), dim=-1))
    close(pos, T.flip(0).numpy())
    close(sm.matrix_from_quat(quat), OTHERS.as_matrix())
    assert torch.equal(sm.apply_delta_pose(T, Q, torch.zeros(6, 6).double())[1], Q)
    with pytest.raises(ValueError, match="rot_error_type 'euler'"):
        sm.compute_pose_error(T, Q, T, P, "euler")


def test_velocities_move_with_the_point():
    v, w = T.flip(0), 2.0 * T.flip(1)
    linear, angular = sm.rigid_body_twist_transform(v, w, T, Q)
    close(linear, ROTATIONS.inv().apply(v.numpy() + np.cross(w, T)))
    close(angular, ROTATIONS.inv().apply(w))


def test_pose_matrices():
    pose = sm.make_pose(T, sm.matrix_from_quat(Q))
    close(sm.pose_inv(pose), np.linalg.inv(pose.numpy()))
    carried = sm.transform_poses_from_frame_A_to_frame_B(pose, pose[1], pose[2])
    close(carried, pose[1].numpy() @ np.linalg.inv(pose[2].numpy()) @ pose.numpy())
    points = torch.from_numpy(np.random.default_rng(2).normal(size=(6, 4, 3)))
    moved = sm.transform_points(points, T, Q)
    close(moved[3], ROTATIONS[3].apply(points[3]) + T[3].numpy())
    with pytest.raises(ValueError, match="make_pose: expected"):
        sm.make_pose(T, sm.matrix_from_quat(Q[:2]))


def test_ways_between_poses():
    pose = sm.make_pose(T, sm.matrix_from_quat(Q))
    way, between = sm.interpolate_poses(pose[0], pose[1], num_steps=3)
    assert between == 3
    assert way.shape == (5, 4, 4)
    fractions = np.linspace(0, 1, 5)
    close(way[:, :3, :3], Slerp([0, 1], ROTATIONS[:2])(fractions).as_matrix())
    close(way[:, :3, 3], T[0].numpy() + fractions[:, None] * (T[1] - T[0]).numpy())
    ends, between = sm.interpolate_poses(pose[0], pose[1], num_steps=0)
    assert between == 0
    assert torch.equal(ends, pose[:2])
    for wrong in ({}, {"num_steps": 2, "step_size": 0.1}):
        with pytest.raises(ValueError, match="interpolate_poses"):
            sm.interpolate_poses(pose[0], pose[1], **wrong)


def test_depth_images_unproject_to_points_that_project_back():
    matrix = torch.tensor([[50.0, 0, 3.5], [0, 60.0, 2.0], [0, 0, 1]], dtype=torch.float64)
    depth = torch.rand(2, 4, 7, dtype=torch.float64) + 0.5
    points = sm.unproject_depth(depth, matrix)
    seen = sm.project_points(points, matrix).reshape(2, 7, 4, 3)  # column by column
    u, v = torch.meshgrid(torch.arange(7.0), torch.arange(4.0), indexing="ij")
    close(seen[0], torch.stack((u, v, depth[0].T), dim=-1).numpy())
    along = points.norm(dim=-1).reshape(2, 7, 4).transpose(1, 2)  # distances from the optical centre
    close(sm.orthogonalize_perspective_depth(along, matrix), depth.numpy())


def test_cameras_look_at_their_targets():
    eyes, targets = T[:3].float(), T[3:].float()
    turn = sm.create_rotation_matrix_from_view(eyes, targets)
    torch.testing.assert_close(-turn[:, :, 2], sm.normalize(targets - eyes))
    assert (turn[:, 2, 1] > 0).all()  # the image's up points up
    torch.testing.assert_close(torch.linalg.det(turn), torch.ones(3))


def test_camera_conventions_name_the_same_axes():
    forward = {"opengl": [0, 0, -1], "ros": [0, 0, 1], "world": [1, 0, 0]}
    up = {"opengl": [0, 1, 0], "ros": [0, -1, 0], "world": [0, 0, 1]}
    for origin in forward:
        for target in forward:
            turned = Rotation.from_quat(sm.convert_camera_frame_orientation_convention(Q, origin, target).numpy())
            for axes in (forward, up):
                np.testing.assert_allclose(turned.apply(axes[target]), ROTATIONS.apply(axes[origin]), atol=1e-9)
    with pytest.raises(ValueError, match="'usd' is none of opengl, ros, world"):
        sm.convert_camera_frame_orientation_convention(Q, "usd", "ros")


def test_samples_of_triangles_and_cylinders():
    gen = torch.Generator().manual_seed(0)
    x = sm.sample_triangle(1.0, 3.0, 20_000, "cpu", gen)
    # density |x - 2| on [1, 3]: the mean of |x - 2| is 2/3
    assert float((x - 2.0).abs().mean()) == pytest.approx(2.0 / 3.0, abs=0.01)
    points = sm.sample_cylinder(0.5, (1.0, 2.0), (4, 50), "cpu", gen)
    assert points.shape == (4, 50, 3)
    torch.testing.assert_close(points[..., :2].norm(dim=-1), torch.full((4, 50), 0.5))
    assert ((points[..., 2] >= 1.0) & (points[..., 2] < 2.0)).all()
    matrix = sm.generate_random_transformation_matrix(2.0, math.pi)
    torch.testing.assert_close(matrix @ sm.pose_inv(matrix), torch.eye(4), atol=1e-6, rtol=0)
