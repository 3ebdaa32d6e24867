# SPDX-License-Identifier: Apache-2.0
"""Functions of ``isaacsim.core.utils.torch``: values against SciPy's, with quaternions (w, x, y, z)."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.isaaclab import torch_rotations as rotations

A, B = Rotation.random(6, random_state=0), Rotation.random(6, random_state=1)
VECTORS = np.random.default_rng(2).normal(size=(6, 3))


def _wxyz(rotation: Rotation) -> torch.Tensor:
    return torch.from_numpy(rotation.as_quat(scalar_first=True))


def _same_rotation(quat: torch.Tensor, expected: Rotation) -> bool:
    return bool((Rotation.from_quat(quat.numpy(), scalar_first=True) * expected.inv()).magnitude().max() < 1e-6)


def test_products_inverses_and_rotated_vectors():
    v = torch.from_numpy(VECTORS)
    assert _same_rotation(rotations.quat_mul(_wxyz(A), _wxyz(B)), A * B)
    assert _same_rotation(rotations.quat_conjugate(_wxyz(A)), A.inv())
    np.testing.assert_allclose(rotations.quat_apply(_wxyz(A), v), A.apply(VECTORS), atol=1e-12)
    np.testing.assert_allclose(rotations.quat_rotate_inverse(_wxyz(A), v), A.inv().apply(VECTORS), atol=1e-12)


def test_transforms_combine_and_invert():
    t1, t2 = torch.from_numpy(VECTORS), torch.from_numpy(VECTORS[::-1].copy())
    quat, offset = rotations.tf_combine(_wxyz(A), t1, _wxyz(B), t2)
    assert _same_rotation(quat, A * B)
    np.testing.assert_allclose(offset, A.apply(VECTORS[::-1]) + VECTORS, atol=1e-12)
    quat, offset = rotations.tf_combine(*rotations.tf_inverse(_wxyz(A), t1), _wxyz(A), t1)
    assert _same_rotation(quat, Rotation.identity(6))
    np.testing.assert_allclose(offset, 0.0, atol=1e-12)


def test_euler_angles_are_in_one_positive_turn():
    angles = torch.from_numpy(A.as_euler("xyz"))
    assert _same_rotation(rotations.quat_from_euler_xyz(*angles.unbind(-1)), A)
    found = torch.stack(rotations.get_euler_xyz(_wxyz(A)), dim=-1)
    np.testing.assert_allclose(found, np.mod(A.as_euler("xyz"), 2 * math.pi), atol=1e-6)


def test_heading_and_velocities_of_a_torso():
    position, target, velocity = (torch.from_numpy(VECTORS * k) for k in (1.0, 3.0, 0.5))
    lin, ang, roll, _, yaw, angle = rotations.compute_rot(_wxyz(A), velocity, 2 * velocity, target, position)
    euler = np.mod(A.as_euler("xyz"), 2 * math.pi)
    np.testing.assert_allclose(lin, A.inv().apply(velocity), atol=1e-12)
    np.testing.assert_allclose(ang, A.inv().apply(2 * velocity), atol=1e-12)
    np.testing.assert_allclose(roll, euler[:, 0], atol=1e-6)
    offset = 2.0 * VECTORS
    np.testing.assert_allclose(angle, np.arctan2(offset[:, 1], offset[:, 0]) - euler[:, 2], atol=1e-6)
    assert yaw.min() >= 0.0


def test_scripts_can_call_them():
    @torch.jit.script
    def turned(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return rotations_quat_apply(q, v)

    np.testing.assert_allclose(turned(_wxyz(A), torch.from_numpy(VECTORS)), A.apply(VECTORS), atol=1e-12)


rotations_quat_apply = rotations.quat_apply


def test_joint_positions_are_scaled_to_their_limits_and_back():
    lower, upper = torch.tensor([-1.0, 0.0]), torch.tensor([3.0, 0.5])
    assert rotations.unscale(torch.tensor([3.0, 0.25]), lower, upper).tolist() == [1.0, 0.0]
    assert rotations.scale(torch.tensor([-1.0, 0.0]), lower, upper).tolist() == [-1.0, 0.25]


def test_a_default_of_the_start_is_the_identity():
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(2, 1)
    x, z = torch.tensor([[1.0, 0.0, 0.0]] * 2), torch.tensor([[0.0, 0.0, 1.0]] * 2)
    quat, up, heading, up_vec, _ = rotations.compute_heading_and_up(identity, identity, x * 7, x, z, 2)
    assert torch.equal(quat, identity)
    assert torch.equal(up_vec, z)
    assert up.tolist() == pytest.approx([1.0, 1.0])
    assert heading.tolist() == pytest.approx([1.0, 1.0])
