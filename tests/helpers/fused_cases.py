# SPDX-License-Identifier: Apache-2.0
"""Functions of torch on the rows of tensors, each to be run as it is and fused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch

import stripe_newton.math as m

N = 37


def _numbers(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator).to(dtype)


X, Y, Q = _numbers(N, 3), _numbers(N, 3, seed=1), _numbers(N, 13, seed=2)
S, C = _numbers(N, seed=3), _numbers(3, seed=4)
B = Q > 0.2
K, J = (10.0 * Q).long(), (5.0 * Q).to(torch.int32)
ODD = torch.tensor([0.0, -0.0, math.inf, -math.inf, math.nan, 1e-42, -3.0]).repeat(N, 1)
CUBE = _numbers(N, 4, 3, seed=5)


def in_place() -> tuple[torch.Tensor, ...]:
    x, y = X.clone(), Y.clone()
    x += y
    x[:, 1] *= 3.0
    x[:, 2] = 0.5
    y.copy_(x)
    y[..., :2].clamp_(-0.5, 0.5)
    x[B[:, :3]] = 0.0
    x.masked_fill_(y > 0.3, -1.0)
    return x, y


def aliases() -> tuple[torch.Tensor, ...]:
    x = Q.clone()
    first, second = x[:, :6], x[:, 3:9]
    first.add_(second)  # each element is read before or after it is written, as in torch
    turned = x.view(N, 13).unsqueeze(1).transpose(1, 2)
    turned[:, 4] = 7.0
    return x, first.clone() + second


def pose() -> torch.Tensor:
    """A tensor that is written in parts, as pose matrices are."""
    pose = torch.zeros(N, 4, 4)
    pose[..., :3, 3] = X
    pose[:, 3, 3] = 1.0
    pose[:, :3, :3] = CUBE[:, :3]
    return pose


def several_bodies() -> torch.Tensor:
    """Rows of a batch of bodies, which are several for each environment."""
    flat = CUBE.reshape(-1, 3)
    return (flat * 2.0 + C).cross(flat, dim=-1).view(N, 4, 3).sum(dim=1)


def swapped() -> tuple[torch.Tensor, ...]:
    one, two = X.clone(), Y.clone()
    kept = one.clone()
    one.copy_(two)
    two.copy_(kept)
    return one, two


def shared_by_all() -> torch.Tensor:
    """Tensors that all rows share, made and read in one chain."""
    scale = torch.full((3,), 0.5) * C
    scale[1] = 4.0
    return X * scale + torch.ones(()) * scale.sum()


COLUMNS, BACK = torch.tensor([2, 0, 5]), torch.tensor([-1, 3])
PICK = (_numbers(N, seed=8).abs() * 5.0).long() % 13


def selected() -> tuple[torch.Tensor, ...]:
    return (
        Q[:, COLUMNS],
        Q[:, BACK] * 2.0,
        CUBE[:, COLUMNS[:2], :],
        Q[torch.arange(N), PICK],
        Q.index_select(1, COLUMNS),
    )


def written_by_indices() -> tuple[torch.Tensor, ...]:
    x, y = Q.clone(), torch.empty_like(Q).copy_(Q)
    y[:, COLUMNS] = X
    return x, y


EXACT: dict[str, Callable[[], Any]] = {
    "add": lambda: (X + Y, X + 0.1, 2 + K, X + K[:, :3], B + B, Q + B, X + C, S[:, None] + C),
    "sub": lambda: (X - Y, 1.0 - X, K - J, 3 - K, S - S[:, None].squeeze(-1)),
    "alpha": lambda: (torch.add(X, Y, alpha=0.3), torch.sub(X, Y, alpha=2.5), torch.add(K, K, alpha=3)),
    "mul": lambda: (X * Y, X * 0.1, K * 0.1, B * 0.1, B * B, K * J, 3 * J, X.double() * Y),
    "div": lambda: (X / Y, X / 0.3, 1.0 / X, K / J.float(), K / 4, X / S[:, None]),
    "unary": lambda: (-Q, Q.abs(), Q.sign(), K.sign(), K.abs(), -K, Q.square(), Q.reciprocal(), ~B, ~K),
    "rounding": lambda: (Q.floor(), Q.ceil(), Q.trunc(), Q.round(), (4 * Q).frac(), K.floor()),
    "pow": lambda: (Q**2, Q**3, Q**-1, Q**-2, Q**0, Q**1, K**2),
    "compare": lambda: (X > Y, X >= 0.3, K == J, K != 2, X < C, K <= 2.5, ODD == ODD, B[:, :1] == B),
    "logical": lambda: (B & ~B, B | (Q < 0), B ^ (Q < 0), torch.logical_and(Q, B), torch.logical_or(K, J), K & 3),
    "not": lambda: (torch.logical_not(Q), torch.logical_xor(B, Q > 1), K | 4, K ^ J),
    "where": lambda: (torch.where(B, Q, -Q), torch.where(B, 1.0, Q), torch.where(S[:, None] > 0, X, C)),
    "clamp": lambda: (Q.clamp(-0.5, 0.5), Q.clamp(min=0.1), ODD.clamp(max=1.0), K.clamp(-2, 2), X.clamp(Y, Y + 1.0)),
    "extremes": lambda: (
        torch.maximum(X, Y),
        torch.minimum(X, Y),
        torch.maximum(ODD, ODD.flip(1)),
        K.maximum(K - 2 * J),
    ),
    "remainder": lambda: (Q.remainder(0.7), torch.remainder(X, Y), Q % -0.7, torch.fmod(X, Y), K % 3, K.remainder(-4)),
    "odd": lambda: (ODD.isnan(), ODD.isinf(), ODD.isfinite(), ODD.abs(), torch.nan_to_num(ODD), ODD + 1.0, ODD * 0.0),
    "copysign": lambda: (torch.copysign(X, Y), torch.relu(ODD)),
    "casts": lambda: (
        Q.long(),
        Q.int(),
        Q.bool(),
        B.float(),
        K.float(),
        Q.double(),
        J.long(),
        Q.to(torch.uint8).float(),
    ),
    "copies": lambda: (Q.clone(), Q[:, 3:7].contiguous(), Q[:, ::2].clone(), CUBE.transpose(1, 2).clone()),
    "made": lambda: (
        torch.zeros(N, 2),
        torch.ones_like(X),
        torch.full((N,), 3.5),
        X.new_zeros(N, 1),
        torch.full_like(X, math.inf),
    ),
    "cat": lambda: (
        torch.cat((X, Q[:, 2:4], S[:, None]), dim=-1),
        torch.cat((X, K[:, :2]), -1),
        torch.stack((X, Y), 1),
    ),
    "moved": lambda: (
        X.repeat(1, 2),
        Q.flip(1),
        Q.roll(2, 1),
        torch.stack((S, S * 2.0), -1),
        S[:, None].expand(N, 3) + X,
    ),
    "sum": lambda: (
        X.sum(-1),
        Q[:, :8].sum(-1),
        B.sum(-1),
        K.sum(1),
        CUBE.sum(-1),
        CUBE.sum(1),
        X.sum(-1, keepdim=True),
    ),
    "mean": lambda: (X.mean(-1), Q[:, :4].mean(-1, keepdim=True), X.prod(-1), X.norm(dim=-1), CUBE.norm(dim=2)),
    "any": lambda: (
        B.any(-1),
        B.all(1),
        Q.amax(-1),
        ODD.amin(1, keepdim=True),
        (Q > 1).any(1, keepdim=True),
        K.amax(1),
    ),
    "count": lambda: (torch.count_nonzero(Q > 0, dim=1), CUBE.amax((1, 2)), K.prod(1)),
    "cross": lambda: (torch.linalg.cross(X, Y), torch.cross(CUBE[:, :, :3], CUBE + 1.0, dim=-1)),
    "selected": selected,
    "written_by_indices": written_by_indices,
    "in_place": in_place,
    "aliases": aliases,
    "pose": pose,
    "several_bodies": several_bodies,
    "swapped": swapped,
    "shared_by_all": shared_by_all,
    "out": lambda: (torch.logical_or(B, B, out=torch.empty_like(B)), torch.mul(X, Y, out=torch.empty(N, 3))),
    "float64": lambda: (X.double() + 0.1, X.double() / 3.0, X.double().abs() > 0.1),
}
"""Functions whose results must be torch's, bit for bit."""

P = Q.abs() + 1e-3
QUAT, TURN = (torch.nn.functional.normalize(_numbers(N, 4, seed=s), dim=-1) for s in (6, 7))


@torch.jit.script
def scripted(x: torch.Tensor, y: torch.Tensor, scale: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Rewards in the way of Isaac Gym's tasks."""
    distance = torch.norm(x - y, p=2, dim=-1)
    reward = 1.0 / (1.0 + distance * distance)
    reward = torch.where(distance < 0.5, reward + scale, reward * scale)
    return torch.clamp(reward, 0.0, 2.0), torch.where(distance > 2.0, torch.ones_like(reward), torch.zeros_like(reward))


def frames() -> tuple[torch.Tensor, ...]:
    position, turn = m.subtract_frame_transforms(X, QUAT, Y, TURN)
    return position, turn, *m.combine_frame_transforms(X, QUAT, Y, TURN), m.axis_angle_from_quat(turn)


CLOSE: dict[str, Callable[[], Any]] = {
    "trigonometric": lambda: (Q.sin(), Q.cos(), Q.tan(), Q.clamp(-1, 1).asin(), Q.clamp(-1, 1).acos(), Q.atan()),
    "exponential": lambda: (Q.exp(), P.log(), Q.tanh(), Q.sigmoid(), Q.sinh(), Q.cosh()),
    "power": lambda: (P**1.7, P.rsqrt(), P**-0.5, torch.atan2(X, Y), P.sqrt(), P**0.5),
    "scripted": lambda: scripted(X, Y, 0.3),
    "frames": frames,
    "rotations": lambda: (m.quat_mul(QUAT, TURN), m.quat_apply(QUAT, X), m.yaw_quat(QUAT), m.matrix_from_quat(QUAT)),
    "angles": lambda: (*m.euler_xyz_from_quat(QUAT), m.quat_from_euler_xyz(S, S + 1.0, -S), m.wrap_to_pi(9.0 * S)),
    "torso": lambda: m.compute_rot(QUAT, X, Y, X + 2.0, Y),
    "lerp": lambda: (
        torch.lerp(X, Y, 0.3),
        torch.lerp(X, Y, 0.8),
        torch.addcmul(X, Y, Y, value=0.5),
        X.addcdiv(Y, P[:, :3]),
    ),
}
"""Functions whose results on the CPU, where torch has vectors of its own, may differ in the last digits."""


def leaves(value: Any) -> list[torch.Tensor]:
    """The tensors of a result."""
    return list(value) if isinstance(value, tuple) else [value]
