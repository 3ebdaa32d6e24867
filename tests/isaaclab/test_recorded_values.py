# SPDX-License-Identifier: Apache-2.0
"""Math and terms of the Isaac Lab dialect, against recorded values of Isaac Lab 2.3.2's own functions.

``python -m tests.helpers.isaaclab_record`` wrote the values.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from stripe_newton.isaaclab import math as ours
from tests.helpers.isaaclab_math_cases import CASES, SAMPLES, copies
from tests.helpers.isaaclab_record import MATH, RECORDED_TERMS, SEED, TERM_VALUES, prepare, sampled
from tests.helpers.isaaclab_terms import Bench
from tests.helpers.isaaclab_walker import walker_task

FUNCTIONS = {**CASES, **SAMPLES}
VALUES = json.loads(MATH.read_text())


def same(found: object, expected: object, atol: float) -> None:
    if isinstance(expected, list):
        assert isinstance(found, list)
        for one, other in zip(found, expected, strict=True):
            same(one, other, atol)
    else:
        assert found == pytest.approx(expected, abs=atol, rel=atol, nan_ok=True)


def test_all_functions_are_recorded():
    assert set(VALUES) == set(FUNCTIONS)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_returns_what_isaac_labs_does(name):
    cases = [*CASES.get(name, ()), *SAMPLES.get(name, ())]
    for arguments, expected in zip(cases, VALUES[name], strict=True):
        torch.manual_seed(SEED)
        found = sampled(getattr(ours, name)(*copies(arguments)))
        if name == "convert_camera_frame_orientation_convention":  # equal components: rounding gives the sign
            signs = np.sign(np.sum(np.array(found) * np.array(expected), axis=-1, keepdims=True))
            found = (np.array(found) * signs).tolist()
        same(found, expected, 1e-5)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with walker_task(tmp_path_factory.mktemp("walker")) as task:
        made = Bench(task)
        prepare(made)
        yield made
        made.env.close()


def test_terms_have_the_values_of_isaac_labs_in_the_same_state(bench):
    values = json.loads(TERM_VALUES.read_text())
    assert set(values) == set(RECORDED_TERMS)
    for term, expected in values.items():
        found = bench.value_of(term).numpy()
        scale = np.abs(np.array(expected, float)).max()
        np.testing.assert_allclose(
            found.reshape(np.shape(expected)), expected, rtol=1e-4, atol=max(1e-4 * scale, 1e-5), err_msg=term
        )
