# SPDX-License-Identifier: Apache-2.0
"""Fused kernel: readable files of generated source, shared by equal kernels."""

from __future__ import annotations

from pathlib import Path

import pytest
import warp as wp

from stripe_newton.managers import RewardManager, RewardTermCfg
from tests.helpers.manager_world import manager_context, plan
from tests.helpers.term_kernels import import_source


def kernel_of(func, weight: float = 1.0):
    context = manager_context(robot="cartpole")
    manager = RewardManager({"own": RewardTermCfg(func, weight=weight)}, context, scale_by_dt=False)
    work = plan(context, manager.compute_items())
    work.run()
    (kernel,) = (k for k in work.kernels if "own" in k.terms)
    return kernel, wp.to_torch(context.reward).tolist()


def written_term(folder: Path, name: str, body: str):
    source = f"import warp as wp\n\n\n@wp.func\ndef own_term(env: int) -> float:\n    return {body}\n"
    return import_source(name, source, folder).own_term


def test_source_is_a_readable_file(tmp_path):
    kernel, _ = kernel_of(written_term(tmp_path, "terms_readable", "float(env)"))
    assert kernel.path.read_text() == kernel.source
    assert "own_term(env)" in kernel.source
    assert "# own" in kernel.source
    assert max(map(len, kernel.source.splitlines())) < 200
    compile(kernel.source, str(kernel.path), "exec")


def test_equal_kernels_share_a_file_and_changed_terms_do_not(tmp_path):
    term = written_term(tmp_path, "terms_before", "2.0 * float(env)")
    first, rewards = kernel_of(term)
    again, _ = kernel_of(term, weight=3.0)
    changed, others = kernel_of(written_term(tmp_path, "terms_after", "3.0 * float(env)"))
    assert first.path == again.path
    assert first.path != changed.path
    assert rewards == [0.0, 2.0, 4.0, 6.0]
    assert others == [0.0, 3.0, 6.0, 9.0]


@pytest.fixture
def helper_terms(tmp_path):
    """A term that calls a helper, twice: the term alike, the helper not."""

    def make(name: str, factor: str):
        source = (
            "import warp as wp\n\n\n@wp.func\ndef helper(x: float) -> float:\n"
            f"    return {factor} * x\n\n\n@wp.func\ndef own_term(env: int) -> float:\n    return helper(float(env))\n"
        )
        return import_source(name, source, tmp_path).own_term

    return make


def test_a_change_in_what_a_term_calls_counts(helper_terms):
    _, rewards = kernel_of(helper_terms("terms_helper_a", "2.0"))
    _, others = kernel_of(helper_terms("terms_helper_b", "5.0"))
    assert rewards == [0.0, 2.0, 4.0, 6.0]
    assert others == [0.0, 5.0, 10.0, 15.0]
