# SPDX-License-Identifier: Apache-2.0
"""Arguments with which the functions of ``isaaclab.utils.math`` are compared: edge cases and random numbers."""

from __future__ import annotations

import math

import torch

from stripe_newton.isaaclab import math as ours

__all__ = ["CASES", "MATRICES", "SAMPLES", "N", "Q", "copies"]

HALF = math.sqrt(0.5)
EDGES = torch.tensor(
    [
        [1, 0, 0, 0],  # identity, both signs
        [-1, 0, 0, 0],
        [0, 1, 0, 0],  # half turns
        [0, 0, 1, 0],
        [0, 0, 0, 1],
        [0, HALF, HALF, 0],  # half turns about axes between
        [0, -HALF, HALF, 0],
        [0, HALF, 0, -HALF],
        [HALF, HALF, 0, 0],  # quarter turns
        [HALF, 0, 0, -HALF],
        [0.5, -0.5, -0.5, 0.5],
        [1, 1e-9, 0, 0],
        [-1, 0, 1e-5, 1e-5],
    ],
    dtype=torch.float64,
)


def rand(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def quats(seed: int = 0) -> torch.Tensor:
    random = rand(64, 4, seed=seed)
    return torch.cat((EDGES, random / random.norm(dim=-1, keepdim=True)))


Q, P = quats(), quats(1).flip(0)
N = len(Q)
TILTED = torch.cat((Q[:7], Q[8:]))  # without the pitch of a quarter turn, where Isaac Lab's roll and yaw are noise
V, T = rand(N, 3, seed=2), rand(N, 3, seed=3)
V[0] = 0.0
DELTA = rand(N, 6, seed=4)
DELTA[:3, 3:] = 0.0
DELTA[3, 3:] = 1e-8
ANGLES = rand(N, 3, seed=5)
LOW, HIGH = torch.tensor([-1.0, 0.0, 2.0], dtype=torch.float64), torch.tensor([1.0, 0.5, 9.0], dtype=torch.float64)
K = torch.tensor([[[50.0, 0, 3.5], [0, 60.0, 2.0], [0, 0, 1]], [[70.0, 0, 4.0], [0, 75.0, 2.5], [0, 0, 1]]]).double()
DEPTH = rand(2, 5, 8, seed=6).abs() + 0.1
MATRICES = ours.matrix_from_quat(Q)
POSES = ours.make_pose(T, MATRICES)

CASES: dict[str, list[tuple]] = {
    "apply_delta_pose": [(T, Q, DELTA)],
    "axis_angle_from_quat": [(Q,), (Q[:6].reshape(2, 3, 4),)],
    "combine_frame_transforms": [(T, Q, V, P), (T, Q, V), (T, Q, None, P), (T, Q)],
    "compute_pose_error": [(T, Q, V, P), (T, 1.5 * Q, V, P, "quat"), (T, Q, V, Q, "axis_angle")],
    "convert_camera_frame_orientation_convention": [
        (Q.float(), a, b) for a in ("opengl", "ros", "world") for b in ("opengl", "ros", "world")
    ],
    "convert_quat": [(Q,), (Q, "wxyz"), (Q.numpy(),), (Q.numpy(), "wxyz")],
    "copysign": [(-2.5, V), (0.0, -V)],
    "create_rotation_matrix_from_view": [(T.float(), V.float()), (T.float(), V.float(), "Y")],
    "default_orientation": [(3, "cpu")],
    "euler_xyz_from_quat": [(TILTED,), (TILTED, True)],
    "interpolate_poses": [(POSES[-1], POSES[-2], 4), (POSES[-1], POSES[-2], None, 0.1), (POSES[-1], POSES[-1], 1)],
    "interpolate_rotations": [(MATRICES[-1], MATRICES[-2], 5), (MATRICES[-1], MATRICES[-3], 5, False)],
    "is_identity_pose": [(T, Q), (torch.zeros(2, 3), torch.tensor([[1.0, 0, 0, 0]] * 2))],
    "make_pose": [(T, MATRICES), (T[0], MATRICES[0])],
    "matrix_from_euler": [(ANGLES, c) for c in ("XYZ", "ZYX", "ZXZ", "YXY")],
    "matrix_from_quat": [(Q,), (2.0 * Q,)],
    "normalize": [(V,), (V, 0.5)],
    "orthogonalize_perspective_depth": [
        (DEPTH, K),
        (DEPTH, K[0]),
        (DEPTH[0], K[0]),
        (DEPTH[0][..., None], K[0]),
        (DEPTH[..., None], K),
    ],
    "pose_in_A_to_pose_in_B": [(POSES, POSES.flip(0))],
    "pose_inv": [(POSES,), (POSES[0],)],
    "project_points": [
        (rand(2, 7, 3).abs() + 0.1, K),
        (rand(2, 7, 3), K[0]),
        (rand(7, 3), K[0]),
        (rand(1, 7, 3), K[0]),
    ],
    "quat_apply": [(Q, V)],
    "quat_apply_inverse": [(Q, V)],
    "quat_apply_yaw": [(Q, V)],
    "quat_box_minus": [(Q, P), (Q, Q)],
    "quat_box_plus": [(Q, V), (Q, V, 0.1)],
    "quat_conjugate": [(Q,)],
    "quat_error_magnitude": [(Q, P), (Q, -Q)],
    "quat_from_angle_axis": [(ANGLES[:, 0], V)],
    "quat_from_euler_xyz": [tuple(ANGLES.unbind(-1))],
    "quat_from_matrix": [(MATRICES,), (MATRICES[:6].reshape(2, 3, 3, 3),)],
    "quat_inv": [(3.0 * Q,), (0.0 * Q,), (Q, 4.0)],
    "quat_mul": [(Q, P)],
    "quat_rotate": [(Q, V)],
    "quat_rotate_inverse": [(Q, V)],
    "quat_slerp": [(Q[i], P[i], tau) for i in (0, 3, 20, 30, 31) for tau in (0.0, 0.3, 1.0)] + [(Q[20], Q[20], 0.5)],
    "quat_unique": [(Q,)],
    "rigid_body_twist_transform": [(V, T, ANGLES, Q)],
    "saturate": [(V, LOW, HIGH)],
    "scale_transform": [(V, LOW, HIGH)],
    "skew_symmetric_matrix": [(V,), (V[1],)],
    "subtract_frame_transforms": [(T, Q, V, P), (T, Q, V), (T, 2.0 * Q, None, P), (T, Q)],
    "transform_points": [
        (rand(7, 3), T[0], Q[0]),
        (rand(N, 7, 3), T, Q),
        (rand(N, 7, 3), T[0], Q[9]),
        (rand(7, 3), T, Q),
        (rand(7, 3), None, Q[9]),
        (rand(7, 3), T[1]),
        (rand(7, 3),),
    ],
    "transform_poses_from_frame_A_to_frame_B": [(POSES, POSES[1], POSES[2])],
    "unmake_pose": [(POSES,)],
    "unproject_depth": [
        (DEPTH, K),
        (DEPTH, K, False),
        (DEPTH[0], K[0]),
        (DEPTH[0][..., None], K[0], False),
        (DEPTH[..., None], K[0]),
    ],
    "unscale_transform": [(V, LOW, HIGH)],
    "wrap_to_pi": [(4.0 * rand(100),), (math.pi * torch.tensor([0.0, 1.0, -1.0, 2.0, -2.0]).double(),)],
    "yaw_quat": [(Q,)],
}
BOUNDS = torch.tensor([[0.1, 1.0], [1.0, 9.0]])
SAMPLES: dict[str, list[tuple]] = {
    "generate_random_rotation": [(), (0.5,)],
    "generate_random_transformation_matrix": [(2.0, 0.5)],
    "generate_random_translation": [(3.0,)],
    "interpolate_poses": [(POSES[-1], POSES[-2], 4, None, True)],
    "random_orientation": [(8, "cpu")],
    "random_yaw_orientation": [(8, "cpu")],
    "sample_cylinder": [(0.5, (1.0, 2.0), (4, 2), "cpu"), (0.5, (1.0, 2.0), 4, "cpu")],
    "sample_gaussian": [(1.0, 0.5, (20, 3), "cpu"), (torch.ones(20), rand(20).abs().float(), (20,), "cpu")],
    "sample_log_uniform": [
        (0.1, 10.0, (8, 2), "cpu"),
        (torch.tensor([0.1, 1.0]), torch.tensor([1.0, 9.0]), (8, 2), "cpu"),
    ],
    "sample_triangle": [(-1.0, 2.0, (50,), "cpu"), (0.0, 1.0, 9, "cpu")],
    "sample_uniform": [(-1.0, 2.0, (8, 2), "cpu"), (BOUNDS[0], BOUNDS[1], (8, 2), "cpu")],
}
"""Arguments of the functions that draw; equal seeds give equal numbers."""


def copies(arguments: tuple) -> list:
    """The arguments with tensors of their own."""
    return [a.clone() if isinstance(a, torch.Tensor) else a for a in arguments]
