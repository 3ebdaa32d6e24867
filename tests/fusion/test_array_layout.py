# SPDX-License-Identifier: Apache-2.0
"""Array layouts in generated kernels: rows of larger arrays, tables, any number of environments, replaced arrays."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from stripe_newton.fusion import Scope, Section, code, fuse
from stripe_newton.fusion.fused_kernel import FusedKernel


@wp.struct
class Limbs:
    pos: wp.array2d[float]
    load: wp.array3d[wp.vec3]


@wp.func
def weighted_sum(env: int, limbs: Limbs, ids: wp.array[int]) -> float:
    total = wp.float32(0.0)
    for i in range(ids.shape[0]):
        total += limbs.pos[env, ids[i]] * float(i + 1)
    for k in range(limbs.load.shape[1]):
        for body in range(limbs.load.shape[2]):
            total += limbs.load[env, k, body][1]
    return total


def kernel_of(num_envs: int) -> tuple[FusedKernel, Limbs, np.ndarray, wp.array, wp.array]:
    """A kernel that reads five columns of rows of nine numbers, its struct, those numbers, the loads and the output."""
    numbers = np.random.default_rng(num_envs).integers(-8, 8, (num_envs, 9)).astype(np.float32)
    rows = wp.array(numbers, dtype=float, device="cpu")
    load = wp.array(np.arange(num_envs * 2 * 3 * 3).reshape(num_envs, 2, 3, 3) % 7, dtype=wp.vec3, device="cpu")
    limbs = Limbs()
    limbs.pos, limbs.load = rows[:, 3:8], load
    scope, out = Scope(), wp.zeros(num_envs, dtype=float, device="cpu")
    ids = scope.name("ids", wp.array([4, 0, 2], dtype=int, device="cpu"))
    call = scope.call(weighted_sum, "env", scope.name("limbs", limbs), ids)
    section = Section("sums", [code("{}[env] = {}", scope.name("out_", out), call)])
    return fuse("layout", [section], scope, num_envs, "cpu"), limbs, numbers, load, out


def test_rows_of_a_larger_array_and_tables_are_read_where_they_are():
    kernel, _, numbers, load, out = kernel_of(40)
    kernel.launch()
    expected = numbers[:, [7, 3, 5]] @ [1.0, 2.0, 3.0] + load.numpy()[..., 1].sum((1, 2))
    np.testing.assert_array_equal(out.numpy(), expected.astype(np.float32))
    assert "limbs.pos.strides[0] = 36;" in kernel.source


def test_the_source_code_is_the_same_for_any_number_of_environments():
    assert kernel_of(160)[0].source == kernel_of(192)[0].source


def test_an_array_replaced_by_one_of_another_shape_is_an_error():
    kernel, limbs, *_ = kernel_of(40)
    limbs.pos = wp.zeros((40, 6), dtype=float, device="cpu")
    with pytest.raises(RuntimeError, match="'layout': an array was replaced by one of another shape"):
        kernel.launch()
