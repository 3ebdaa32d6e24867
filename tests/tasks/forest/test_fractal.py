# SPDX-License-Identifier: Apache-2.0
"""Fractal noise: its spectrum; the form of ground does not depend on the resolution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from stripe_tasks.forest.fractal import fractal_noise
from stripe_tasks.forest.relief import ReliefCfg, make_relief


@pytest.mark.parametrize("hurst", [0.5, 0.8, 1.1])
def test_power_falls_as_the_formula_says(hurst):
    """Power per area of the wave-number plane goes with ``k^(-2 hurst - 2)``; the slope is met to 0.3."""
    n, cell = 512, 1.0
    axis = cell * np.arange(n)
    window = np.hanning(n)[:, None] * np.hanning(n)[None, :]
    k = np.hypot(np.fft.fftfreq(n, cell)[:, None], np.fft.fftfreq(n, cell)[None, :])
    bins = np.geomspace(1.0 / 64.0, 1.0 / 8.0, 13)  # well within the octaves, of 128 m to 4 m
    power = np.zeros(len(bins) - 1)
    for seed in range(6):
        noise = fractal_noise(axis[None, :], axis[:, None], 128.0, range(6), hurst, (seed,))
        spectrum = np.abs(np.fft.fft2(window * (noise - noise.mean()))) ** 2
        ring = np.digitize(k.ravel(), bins)
        power += [spectrum.ravel()[ring == i].mean() for i in range(1, len(bins))]
    fall = np.polyfit(np.log(np.sqrt(bins[1:] * bins[:-1])), np.log(power), 1)[0]
    assert fall == pytest.approx(-2.0 * hurst - 2.0, abs=0.3)


@pytest.mark.parametrize("seed", [0, 5])
def test_two_resolutions_have_the_same_large_forms(seed):
    coarse, fine = (make_relief(ReliefCfg(size=(96.0, 64.0), resolution=r, seed=seed)).heights for r in (0.5, 0.125))
    smooth = ndimage.gaussian_filter(coarse, 4.0), ndimage.gaussian_filter(fine, 16.0)[::4, ::4]
    assert smooth[0].shape == smooth[1].shape
    assert np.corrcoef(smooth[0].ravel(), smooth[1].ravel())[0, 1] > 0.99
    assert np.std(smooth[0] - smooth[1]) < 0.02 * np.std(smooth[0])
    other = make_relief(ReliefCfg(size=(96.0, 64.0), resolution=0.5, seed=seed + 1)).heights
    assert np.corrcoef(coarse.ravel(), other.ravel())[0, 1] < 0.9
