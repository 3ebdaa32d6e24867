# SPDX-License-Identifier: Apache-2.0
"""Warp arrays of a direct environment: what an unknown name is answered with."""

from __future__ import annotations

import pytest

from stripe_newton.envs.warp_arrays import WarpArrays


def test_an_unknown_array_is_an_error_that_names_the_known_ones():
    arrays = WarpArrays(*[None] * 9)
    arrays.mine = 3
    assert arrays.mine == 3
    with pytest.raises(AttributeError, match=r"no 'rewards'; did you mean reward\? it has actions, terminated, .*rng"):
        _ = arrays.rewards
    assert not hasattr(arrays, "forces")
