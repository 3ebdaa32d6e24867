# SPDX-License-Identifier: Apache-2.0
"""Random streams of terms: equal to a reference whatever the launches are, with the stated distributions."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from tests.helpers import term_kernels as tk
from tests.helpers.term_reference_random import Stream

SEED = 42

RANDOM = """import warp as wp
from stripe_kernels.mdp import random


@wp.kernel(enable_backward=False)
def seed(value: int, rng: wp.array[wp.uint32]):
    env = wp.tid()
    rng[env] = random.seed_stream(value, env)


@wp.kernel(enable_backward=False)
def uniform(rng: wp.array[wp.uint32], out: wp.array2d[float]):
    env = wp.tid()
    for i in range(out.shape[1]):
        out[env, i] = random.uniform(env, rng)


@wp.kernel(enable_backward=False)
def gaussian(rng: wp.array[wp.uint32], out: wp.array2d[float]):
    env = wp.tid()
    for i in range(out.shape[1]):
        out[env, i] = random.gaussian(env, rng, 1.0, 2.0)


@wp.kernel(enable_backward=False)
def bernoulli(rng: wp.array[wp.uint32], out: wp.array2d[float]):
    env = wp.tid()
    for i in range(out.shape[1]):
        chance = float(i) / float(out.shape[1] - 1)
        if random.bernoulli(env, rng, chance):
            out[env, i] = 1.0


@wp.kernel(enable_backward=False)
def quats(rng: wp.array[wp.uint32], out: wp.array2d[float]):
    env = wp.tid()
    for i in range(out.shape[1] // 4):
        q = random.random_quat(env, rng)
        for k in range(4):
            out[env, 4 * i + k] = q[k]
"""


@cache
def random_kernels() -> Any:
    return tk.import_source("term_kernels_random", RANDOM, Path(mkdtemp()))


def draws(name: str, num_envs: int, count: int, device: str, seed: int = SEED, launches: int = 1) -> np.ndarray:
    rng = wp.zeros(num_envs, dtype=wp.uint32, device=device)
    wp.launch(random_kernels().seed, dim=num_envs, inputs=[seed, rng], device=device)
    parts = []
    for _ in range(launches):
        out = wp.zeros((num_envs, count // launches), dtype=float, device=device)
        wp.launch(getattr(random_kernels(), name), dim=num_envs, inputs=[rng, out], device=device)
        parts.append(out.numpy())
    return np.concatenate(parts, axis=1)


def test_uniform_draws_are_those_of_the_reference(device):
    stream = Stream(SEED, 16)
    expected = np.stack([stream.uniform() for _ in range(32)], axis=1)
    np.testing.assert_array_equal(draws("uniform", 16, 32, device), expected)


@pytest.mark.parametrize("name", ["uniform", "gaussian", "quats"])
def test_draws_do_not_depend_on_the_number_of_environments(name, device):
    np.testing.assert_array_equal(draws(name, 8, 32, device), draws(name, 64, 32, device)[:8])


@pytest.mark.parametrize("name", ["uniform", "gaussian", "quats"])
def test_draws_do_not_depend_on_the_launches(name, device):
    np.testing.assert_array_equal(draws(name, 8, 32, device), draws(name, 8, 32, device, launches=4))


def test_seeds_differ(device):
    first, second = (draws("uniform", 64, 64, device, seed=s) for s in (0, 1))
    assert np.mean(first == second) < 0.01


def test_streams_that_meet_do_not_go_on_in_step(device):
    rng = wp.full(2, wp.uint32(1234), dtype=wp.uint32, device=device)
    out = wp.zeros((2, 64), dtype=float, device=device)
    wp.launch(random_kernels().uniform, dim=2, inputs=[rng, out], device=device)
    first, second = out.numpy()
    assert not np.isin(first, second).any()


def within(sample: float, expected: float, std_error: float, what: str) -> None:
    """Five standard errors: a chance of one in two million that a right generator fails, and the seed is fixed."""
    assert abs(sample - expected) < 5.0 * std_error, f"{what}: {sample}, not {expected} +- {5.0 * std_error}"


def test_uniform_statistics(device):
    x = draws("uniform", 4096, 256, device).astype(float)
    n = x.size
    assert x.min() >= 0.0
    assert x.max() < 1.0
    for k in range(1, 5):
        variance = 1.0 / (2 * k + 1) - 1.0 / (k + 1) ** 2
        within((x**k).mean(), 1.0 / (k + 1), math.sqrt(variance / n), f"moment {k}")
    bins = np.bincount((x * 256).astype(int).ravel(), minlength=256)
    chi2 = ((bins - n / 256) ** 2 / (n / 256)).sum()
    within(chi2, 255.0, math.sqrt(2.0 * 255.0), "chi-square of 256 bins")
    centred = x - 0.5
    for rows, columns in ((0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (1, -1)):  # neighbours in time and of environments
        a = centred[: 4096 - rows, max(0, -columns) : 256 - max(0, columns)]
        b = centred[rows:, max(0, columns) : 256 + min(0, columns)]
        within((a * b).mean() * 12.0, 0.0, 1.0 / math.sqrt(a.size), f"correlation at a distance of {rows}, {columns}")
    within(x.mean(axis=1).std() * math.sqrt(12 * 256), 1.0, 1.0 / math.sqrt(2 * 4096), "spread of streams' means")


def test_gaussian_statistics(device):
    x = (draws("gaussian", 4096, 128, device).astype(float) - 1.0) / 2.0
    n = x.size
    for k, moment, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):
        within((x**k).mean(), moment, math.sqrt(variance / n), f"moment {k}")
    for bound, share in ((1.0, 0.682689), (2.0, 0.954500), (3.0, 0.997300)):
        within((np.abs(x) < bound).mean(), share, math.sqrt(share * (1.0 - share) / n), f"within {bound} std")
    assert np.abs(x).max() < 5.8


def test_bernoulli_statistics(device):
    x = draws("bernoulli", 4096, 11, device)
    assert (x[:, 0] == 0.0).all(), "chance 0"
    assert (x[:, -1] == 1.0).all(), "chance 1"
    for i in range(1, 10):
        within(x[:, i].mean(), i / 10, math.sqrt(i / 10 * (1 - i / 10) / 4096), f"chance {i / 10}")


def test_random_orientations_are_uniform(device):
    q = draws("quats", 4096, 64, device).reshape(-1, 4).astype(float)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-6)
    n = len(q)
    for k in range(4):  # of a uniform point on the sphere in four dimensions
        within((q[:, k] ** 2).mean(), 0.25, math.sqrt((1 / 8 - 1 / 16) / n), f"square of component {k}")
    cosines = Rotation.from_quat(q).apply([1.0, 0.0, 0.0])
    for k in range(3):  # a rotated axis is uniform on the sphere: each component is uniform in [-1, 1]
        within(cosines[:, k].mean(), 0.0, math.sqrt(1 / 3 / n), f"component {k} of a rotated axis")
        within((cosines[:, k] ** 2).mean(), 1 / 3, math.sqrt((1 / 5 - 1 / 9) / n), f"its square {k}")
