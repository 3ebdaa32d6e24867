# SPDX-License-Identifier: Apache-2.0
"""Counters in episodes of years: delays by rings, with counts beyond which 32 bits would overflow."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from stripe_kernels.sensors import corruption, picture_delay

LAST = 2**31 - 1


@pytest.mark.parametrize("start", [0, LAST - LAST % 3 - 3, LAST - 2])
def test_pictures_come_late_by_the_same_number_after_two_billion(start):
    depth, steps = 3, 40
    due = wp.full(1, value=True, dtype=wp.bool, device="cpu")
    count, lag = wp.array([start], dtype=int, device="cpu"), wp.array([2], dtype=int, device="cpu")
    ring, out = wp.zeros((1, depth, 1), dtype=int, device="cpu"), wp.zeros((1, 1), dtype=int, device="cpu")
    late = []
    for step in range(steps):
        taken = wp.array([[100 + step]], dtype=int, device="cpu")
        wp.launch(
            picture_delay.delay_words, dim=(1, 1), inputs=[due, count, lag, taken], outputs=[ring, out], device="cpu"
        )
        wp.launch(picture_delay.count_pictures, dim=1, inputs=[due, depth], outputs=[count], device="cpu")
        late.append(int(out.numpy()[0, 0]))
    assert late[2:] == [100 + step - 2 for step in range(2, steps)]
    assert start or count.numpy()[0] < 2 * depth + 2


@pytest.mark.parametrize("start", [0, LAST - 2])
def test_measurements_come_late_by_the_same_number_after_two_billion(start):
    delay, steps = 2, 40
    due = wp.full(1, value=True, dtype=wp.bool, device="cpu")
    count = wp.array([start], dtype=int, device="cpu")
    rng, first = (wp.zeros(1, dtype=wp.uint32, device="cpu") for _ in range(2))
    noise = corruption.Noise()
    noise.kind = wp.zeros(1, dtype=int, device="cpu")
    noise.operation = wp.zeros(1, dtype=int, device="cpu")
    noise.a, noise.b = (wp.zeros(1, dtype=float, device="cpu") for _ in range(2))
    bias = wp.zeros((1, 1), dtype=float, device="cpu")
    ring, out = wp.zeros((1, delay + 1, 1), dtype=float, device="cpu"), wp.zeros((1, 1), dtype=float, device="cpu")
    late = []
    for step in range(steps):
        raw = wp.array([[100.0 + step]], dtype=float, device="cpu")
        counters = [rng, first, count]
        wp.launch(corruption.begin_corruption, dim=1, inputs=[due, 2, delay + 1], outputs=counters, device="cpu")
        inputs = [due, noise, bias, first, count, raw]
        wp.launch(corruption.corrupt, dim=(1, 1), inputs=inputs, outputs=[ring, out], device="cpu")
        late.append(float(out.numpy()[0, 0]))
    assert late[delay:] == [100.0 + step - delay for step in range(delay, steps)]
    # The first measurement of an episode stands for those before it, and no later one does.
    assert start or late[0] == 100.0
    assert np.all(np.diff(late[delay:]) == 1.0)
