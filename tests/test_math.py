# SPDX-License-Identifier: Apache-2.0
"""stripe_newton.math against scipy's rotations, in float64, on random input and the known hard cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton import math as sm

SHAPES = [(), (1,), (7,), (5, 3)]
HALF = math.sqrt(0.5)
SPECIAL = torch.tensor(
    [
        [0, 0, 0, 1],  # identity
        [0, 0, 0, -1],  # identity, the other sign
        [1, 0, 0, 0],  # half turns
        [0, 1, 0, 0],
        [0, 0, 1, 0],
        [0, HALF, 0, HALF],  # pitch of a quarter turn: gimbal lock
        [0, -HALF, 0, HALF],
        [0.5, 0.5, 0.5, 0.5],
        [0.5, 0.5, -0.5, 0.5],  # gimbal lock with roll and yaw
        [-0.5, 0.5, 0.5, 0.5],
        [1e-9, 0, 0, 1],
        [0, 1e-5, -1e-5, -1],
        [1, 1e-9, 0, 1e-9],
    ],
    dtype=torch.float64,
)


@pytest.fixture
def gen() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def quats(shape, gen) -> torch.Tensor:
    return sm.normalize(torch.randn((*shape, 4), generator=gen, dtype=torch.float64))


def vecs(shape, gen) -> torch.Tensor:
    return torch.randn((*shape, 3), generator=gen, dtype=torch.float64)


def many(gen) -> torch.Tensor:
    return torch.cat((sm.normalize(SPECIAL), quats((200,), gen)))


def rotation(q: torch.Tensor) -> Rotation:
    return Rotation.from_quat(q.reshape(-1, 4).numpy())


def same_rotation(q: torch.Tensor, expected: np.ndarray, atol: float = 1e-12) -> None:
    expected = torch.from_numpy(expected).reshape(q.shape)
    dot = (q * expected).sum(-1, keepdim=True)
    torch.testing.assert_close(q, torch.where(dot < 0, -expected, expected), atol=atol, rtol=0)


@pytest.mark.parametrize("shape", SHAPES)
def test_products_and_rotations(shape, gen):
    q, p, v = quats(shape, gen), quats(shape, gen), vecs(shape, gen)
    same_rotation(sm.quat_mul(q, p), (rotation(q) * rotation(p)).as_quat())
    same_rotation(sm.quat_inv(3.0 * q) * 3.0, rotation(q).inv().as_quat())
    same_rotation(sm.quat_conjugate(q), rotation(q).inv().as_quat())
    flat = v.reshape(-1, 3).numpy()
    for function, expected in (
        (sm.quat_apply, rotation(q).apply(flat)),
        (sm.quat_apply_inverse, rotation(q).inv().apply(flat)),
    ):
        out = function(q, v)
        assert out.shape == (*shape, 3)
        np.testing.assert_allclose(out.reshape(-1, 3).numpy(), expected, atol=1e-12)


def test_quaternions_are_xyzw():
    quarter_turn_about_z = torch.tensor([0.0, 0.0, HALF, HALF])
    torch.testing.assert_close(
        sm.quat_apply(quarter_turn_about_z, torch.tensor([1.0, 0.0, 0.0])), torch.tensor([0.0, 1.0, 0.0])
    )


def test_leading_dimensions_broadcast(gen):
    q, v = quats((4, 1), gen), vecs((3,), gen)
    out = sm.quat_apply(q, v)
    assert out.shape == (4, 3, 3)
    torch.testing.assert_close(out[2, 1], sm.quat_apply(q[2, 0], v[1]))
    assert sm.quat_apply(quats((), gen), vecs((6,), gen)).shape == (6, 3)
    assert sm.quat_mul(quats((), gen), quats((6,), gen)).shape == (6, 4)


def test_matrices_round_trip(gen):
    q = many(gen)
    matrix = sm.matrix_from_quat(q)
    np.testing.assert_allclose(matrix.numpy(), rotation(q).as_matrix(), atol=1e-12)
    back = sm.quat_from_matrix(matrix)
    assert (back[:, 3] >= 0).all()
    same_rotation(back, q.numpy())
    torch.testing.assert_close(sm.matrix_from_quat(2.5 * q), matrix, atol=1e-12, rtol=0)
    assert sm.matrix_from_quat(quats((5, 3), gen)).shape == (5, 3, 3, 3)
    assert sm.quat_from_matrix(sm.matrix_from_quat(quats((5, 3), gen))).shape == (5, 3, 4)


def test_euler_angles(gen):
    roll, pitch, yaw = (torch.rand(500, generator=gen, dtype=torch.float64) * 8 - 4 for _ in range(3))
    q = sm.quat_from_euler_xyz(roll, pitch, yaw)
    same_rotation(q, Rotation.from_euler("xyz", torch.stack((roll, pitch, yaw), -1).numpy()).as_quat())
    angles = sm.euler_xyz_from_quat(q)
    np.testing.assert_allclose(torch.stack(angles, -1).numpy(), rotation(q).as_euler("xyz"), atol=1e-7)


def test_euler_angles_give_the_rotation_back_even_in_gimbal_lock(gen):
    for q in (many(gen), -many(gen)):
        roll, pitch, yaw = sm.euler_xyz_from_quat(q)
        assert (pitch.abs() <= math.pi / 2 + 1e-12).all()
        assert (roll.abs() <= math.pi).all()
        assert (yaw.abs() <= math.pi).all()
        same_rotation(sm.quat_from_euler_xyz(roll, pitch, yaw), q.numpy(), atol=1e-9)


def test_euler_angles_wrapped_to_two_pi(gen):
    q = many(gen)
    for wrapped, angle in zip(sm.euler_xyz_from_quat(q, wrap_to_2pi=True), sm.euler_xyz_from_quat(q)):
        assert (wrapped >= 0).all()
        assert (wrapped < 2 * math.pi + 1e-12).all()
        torch.testing.assert_close(torch.cos(wrapped), torch.cos(angle))
        torch.testing.assert_close(torch.sin(wrapped), torch.sin(angle), atol=1e-12, rtol=0)


def test_axis_angle(gen):
    q = many(gen)
    vector = sm.axis_angle_from_quat(q)
    assert torch.isfinite(vector).all()
    assert (vector.norm(dim=-1) <= math.pi + 1e-12).all()
    same_rotation(torch.from_numpy(Rotation.from_rotvec(vector.numpy()).as_quat()), q.numpy(), atol=1e-9)
    same_rotation(sm.quat_from_angle_axis(vector.norm(dim=-1), vector), q.numpy(), atol=1e-9)
    torch.testing.assert_close(
        sm.axis_angle_from_quat(torch.tensor([1e-8, 0, 0, 1.0], dtype=torch.float64)),
        torch.tensor([2e-8, 0, 0], dtype=torch.float64),
    )


def test_angle_axis_takes_any_length_and_one_axis_for_many_angles():
    angle = torch.tensor([0.0, math.pi / 2, math.pi])
    q = sm.quat_from_angle_axis(angle, torch.tensor([0.0, 0.0, 5.0]))
    expected = torch.tensor([[0, 0, 0, 1], [0, 0, HALF, HALF], [0, 0, 1, 0]])
    torch.testing.assert_close(q, expected, atol=1e-6, rtol=0)
    identity = sm.quat_from_angle_axis(torch.tensor(1.0), torch.zeros(3))
    torch.testing.assert_close(identity, torch.tensor([0.0, 0.0, 0.0, 1.0]))


def test_error_magnitude(gen):
    q, p = many(gen), many(gen).flip(0)
    expected = (rotation(q) * rotation(p).inv()).magnitude()
    np.testing.assert_allclose(sm.quat_error_magnitude(q, p).numpy(), expected, atol=1e-7)
    torch.testing.assert_close(sm.quat_error_magnitude(q, -q), torch.zeros(len(q), dtype=q.dtype), atol=1e-7, rtol=0)


def test_yaw(gen):
    q = quats((100,), gen)
    yaw = sm.yaw_quat(q)
    angle = rotation(q).as_euler("xyz")[:, 2:]
    same_rotation(yaw, Rotation.from_euler("z", angle).as_quat(), atol=1e-9)
    v = vecs((100,), gen)
    torch.testing.assert_close(sm.quat_apply_yaw(q, v), sm.quat_apply(yaw, v))
    torch.testing.assert_close(sm.quat_apply_yaw(q, v)[:, 2], v[:, 2])


def test_unique(gen):
    q = quats((50,), gen)
    assert (sm.quat_unique(q)[:, 3] >= 0).all()
    torch.testing.assert_close(sm.quat_unique(q), sm.quat_unique(-q))


def test_poses_combine_and_subtract(gen):
    t1, t2, q1, q2 = vecs((9,), gen), vecs((9,), gen), quats((9,), gen), quats((9,), gen)
    t, q = sm.combine_frame_transforms(t1, q1, t2, q2)
    np.testing.assert_allclose(t.numpy(), t1.numpy() + rotation(q1).apply(t2.numpy()), atol=1e-12)
    back_t, back_q = sm.subtract_frame_transforms(t1, q1, t, q)
    torch.testing.assert_close(back_t, t2)
    same_rotation(back_q, q2.numpy())
    zero, identity = torch.zeros_like(t1), torch.tensor([0, 0, 0, 1.0], dtype=t1.dtype).expand(9, 4)
    for function in (sm.combine_frame_transforms, sm.subtract_frame_transforms):
        for short, full in zip(function(t1, q1), function(t1, q1, zero, identity)):
            torch.testing.assert_close(short, full)
    torch.testing.assert_close(sm.combine_frame_transforms(t1, q1, q12=q2)[0], t1)


def test_normalize():
    v = sm.normalize(torch.tensor([[3.0, 4.0], [0.0, 0.0]]))
    torch.testing.assert_close(v, torch.tensor([[0.6, 0.8], [0.0, 0.0]]))


def test_wrap_to_pi():
    angles = torch.tensor([0.0, math.pi, -math.pi, 3 * math.pi / 2, -3 * math.pi / 2, 7.0], dtype=torch.float64)
    expected = torch.tensor([0, math.pi, math.pi, -math.pi / 2, math.pi / 2, 7 - 2 * math.pi], dtype=torch.float64)
    torch.testing.assert_close(sm.wrap_to_pi(angles), expected)
    inside = torch.linspace(-3.14, 3.14, 999)
    assert torch.equal(sm.wrap_to_pi(inside), inside)


def test_scale_unscale_saturate():
    lower, upper = torch.tensor([-1.0, 0.0]), torch.tensor([3.0, 10.0])
    x = torch.tensor([[-1.0, 0.0], [1.0, 5.0], [3.0, 10.0], [5.0, 20.0]])
    scaled = torch.tensor([[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0], [2.0, 3.0]])
    torch.testing.assert_close(sm.scale_transform(x, lower, upper), scaled)
    torch.testing.assert_close(sm.unscale_transform(scaled, lower, upper), x)
    torch.testing.assert_close(sm.saturate(x, lower, upper)[3], upper)
    torch.testing.assert_close(sm.saturate(x - 9, lower, upper)[0], lower)


def test_heading_and_up():
    identity = torch.tensor([[0.0, 0.0, 0.0, 1.0]])
    left = torch.tensor([[0.0, 0.0, HALF, HALF]])
    upside_down = torch.tensor([[1.0, 0.0, 0.0, 0.0]])
    x, z = torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([[0.0, 0.0, 1.0]])
    target = torch.tensor([[1000.0, 0.0, 0.0]])
    for torso, up, heading in ((identity, 1.0, 1.0), (left, 1.0, 0.0), (upside_down, -1.0, 1.0)):
        quat, up_proj, heading_proj, up_vec, heading_vec = sm.compute_heading_and_up(torso, identity, target, x, z, 2)
        torch.testing.assert_close(quat, torso)
        torch.testing.assert_close(up_proj, torch.tensor([up]), atol=1e-6, rtol=0)
        torch.testing.assert_close(heading_proj, torch.tensor([heading]), atol=1e-6, rtol=0)
        torch.testing.assert_close(up_vec, sm.quat_apply(torso, z))
        torch.testing.assert_close(heading_vec, sm.quat_apply(torso, x))


def test_rot():
    left = torch.tensor([[0.0, 0.0, HALF, HALF]])
    forward = torch.tensor([[0.0, 2.0, 0.0]])
    here, target = torch.tensor([[1.0, 1.0, 0.5]]), torch.tensor([[-9.0, 1.0, 0.5]])
    vel, ang, roll, pitch, yaw, angle = sm.compute_rot(left, forward, torch.tensor([[0.0, 0.0, 3.0]]), target, here)
    torch.testing.assert_close(vel, torch.tensor([[2.0, 0.0, 0.0]]), atol=1e-6, rtol=0)
    torch.testing.assert_close(ang, torch.tensor([[0.0, 0.0, 3.0]]))
    expected = torch.tensor([0.0, 0.0, math.pi / 2, math.pi / 2])
    torch.testing.assert_close(torch.cat((roll, pitch, yaw, angle)), expected, atol=1e-6, rtol=0)


NOT_OF_TENSORS_ALONE = {
    "convert_camera_frame_orientation_convention",
    "create_rotation_matrix_from_view",
    "default_orientation",
    "interpolate_poses",
    "interpolate_rotations",
    "make_pose",
    "matrix_from_euler",
    "pose_inv",
    "quat_slerp",
    "transform_poses_from_frame_A_to_frame_B",
}


@pytest.mark.parametrize(
    "name",
    [
        name
        for name in sm.__all__
        if name not in NOT_OF_TENSORS_ALONE and not name.startswith(("sample_", "random_", "generate_"))
    ],
    ids=lambda name: name,
)
def test_functions_of_tensors_can_be_scripted(name):
    torch.jit.script(getattr(sm, name))


def test_samples_stay_in_bounds_and_repeat(gen):
    lower, upper = torch.tensor([-1.0, 10.0]), torch.tensor([1.0, 20.0])
    x = sm.sample_uniform(lower, upper, (20_000, 2), "cpu", gen)
    assert ((x >= lower) & (x <= upper)).all()
    # the standard error of the mean is width / sqrt(12 n); five of them
    error = 5 * (upper - lower) / math.sqrt(12 * 20_000)
    assert ((x.mean(0) - 0.5 * (lower + upper)).abs() < error).all()
    again = sm.sample_uniform(lower, upper, (20_000, 2), "cpu", torch.Generator().manual_seed(0))
    assert torch.equal(x, again)
    assert sm.sample_uniform(0.0, 1.0, 3, "cpu").shape == (3,)
    assert sm.sample_uniform(2.0, 2.0, [2, 3], "cpu").eq(2.0).all()


def test_log_uniform_samples(gen):
    x = sm.sample_log_uniform(0.01, 100.0, (20_000,), "cpu", gen)
    assert x.min() >= 0.01 * (1 - 1e-5)
    assert x.max() <= 100.0 * (1 + 1e-5)
    assert abs((x < 1.0).float().mean().item() - 0.5) < 5 * 0.5 / math.sqrt(20_000)


def test_gaussian_samples(gen):
    x = sm.sample_gaussian(torch.tensor([1.0, -2.0]), torch.tensor([0.5, 3.0]), (20_000, 2), "cpu", gen)
    torch.testing.assert_close(x.mean(0), torch.tensor([1.0, -2.0]), atol=5 * 3.0 / math.sqrt(20_000), rtol=0)
    torch.testing.assert_close(x.std(0), torch.tensor([0.5, 3.0]), atol=0, rtol=5 / math.sqrt(2 * 20_000))


def test_random_orientations(gen):
    q = sm.random_orientation(20_000, "cpu", gen)
    torch.testing.assert_close(q.norm(dim=-1), torch.ones(20_000))
    # each axis of a uniformly random frame is uniform on the sphere: mean 0, variance 1/3 of each component
    axis = sm.quat_apply(q, torch.tensor([0.0, 0.0, 1.0]))
    assert (axis.mean(0).abs() < 5 / math.sqrt(3 * 20_000)).all()
    torch.testing.assert_close(axis.square().mean(0), torch.full((3,), 1 / 3), atol=0.012, rtol=0)
    yaw = sm.random_yaw_orientation(20_000, "cpu", gen)
    assert (yaw[:, :2] == 0).all()
    assert abs(sm.euler_xyz_from_quat(yaw)[2].mean().item()) < 5 * math.pi / math.sqrt(3 * 20_000)


def test_names_of_isaac_lab():
    q, v = torch.tensor(Rotation.random(5, random_state=0).as_quat(), dtype=torch.float32), torch.randn(5, 3)
    turned = Rotation.from_quat(q.numpy()).apply(v.numpy())
    assert np.allclose(sm.quat_rotate(q, v).numpy(), turned, atol=1e-5)
    assert np.allclose(
        sm.quat_rotate_inverse(q, torch.tensor(turned, dtype=torch.float32)).numpy(), v.numpy(), atol=1e-5
    )
    w_first = Rotation.from_quat(q.numpy()).as_quat(scalar_first=True)
    assert np.allclose(sm.convert_quat(q, "wxyz").numpy(), w_first, atol=1e-6)
    assert torch.equal(sm.convert_quat(sm.convert_quat(q, "wxyz"), "xyzw"), q)
    with pytest.raises(ValueError, match="neither"):
        sm.convert_quat(q, "xwyz")
    assert np.array_equal(sm.copysign(-2.0, v).numpy(), np.copysign(np.full_like(v.numpy(), 2.0), v.numpy()))
