# SPDX-License-Identifier: Apache-2.0
"""Groups of kernels: every kernel of a profile counts once, in the group of its name."""

from __future__ import annotations

import pytest

from tools.benchmarks.kernel_groups import groups_table

ROLLOUT = [(5000.0, 24, "step_worlds_1_cuda_kernel_forward"), (250.0, 24, "step_measurements_to_observations_2")]
UPDATE = [(2000.0, 80, "sm90_xmma_gemm_f32f32_tf32f32"), (500.0, 20, "elu_gradient_bf16_3"), (125.0, 7, "unheard_of")]


def test_groups_add_up():
    rows = [line.split(" | ") for line in groups_table({"a": {"rollout": ROLLOUT, "update": UPDATE}}).splitlines()[2:]]
    cells = {row[1]: (float(row[2].removesuffix(" ms")), int(row[3])) for row in rows}
    assert cells["physics"] == (5.0, 24)
    assert cells["terminations, rewards, resets, observations"] == (0.25, 24)
    assert cells["gradient through ELU, sums for biases"] == (0.5, 20)
    assert cells["matrix products"] == (2.0, 80)
    assert sum(ms for ms, _ in cells.values()) == pytest.approx(7.875, abs=0.01)
    assert sum(count for _, count in cells.values()) == 155
