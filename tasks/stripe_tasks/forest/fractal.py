# SPDX-License-Identifier: Apache-2.0
"""Fractal noise of the plane: a function of position and seed alone, so that every grid samples the same form."""

from __future__ import annotations

import numpy as np

__all__ = ["fractal_noise", "gradient_noise", "smoothstep", "warp"]

LATTICE = 256
"""Noise repeats after this many wavelengths; a power of two."""
ROWS = 64
"""Rows computed at once: their intermediate arrays fit into the processor's cache."""

_FALL = np.polynomial.Polynomial([1.0, 0.0, 0.0, -10.0, 15.0, -6.0])  # 1 - fade, the weight of a corner
_FADED, _FADED_SQUARE = ((_FALL**2 * np.polynomial.Polynomial([0.0, 1.0]) ** n).integ()(1.0) for n in (0, 2))
DEVIATION = float(np.sqrt(4.0 * _FADED * _FADED_SQUARE))
"""Standard deviation of noise with unit gradients: each of 4 corners adds the mean over the cell of
``w^2 (u^2 + v^2) / 2`` to the variance."""


def smoothstep(t: np.ndarray) -> np.ndarray:
    """Smooth step from 0 at ``t = 0`` to 1 at ``t = 1``, with slope 0 at both: ``t^2 (3 - 2 t)``."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def gradient_noise(x: np.ndarray, y: np.ndarray, wavelength: float, seed: tuple[int, ...]) -> np.ndarray:
    """Gradient noise with mean 0 and variance 1, on a lattice that is turned and shifted at random.

    Source: K. Perlin, "Improving Noise", 2002: fade ``t^3 (6 t^2 - 15 t + 10)``; unit gradients are drawn here.

    Args:
        x: x of the points [m], of a shape that broadcasts with that of ``y`` to ``(nrow, ncol)``.
        y: y of the points [m].
        wavelength: Spacing of the lattice [m].
        seed: Seed of the lattice.

    Returns:
        Noise, float32 ``(nrow, ncol)``.
    """
    rng = np.random.default_rng(seed)
    # turned and shifted, so that the lattices of octaves do not line up
    turn, shift_u, shift_v = rng.uniform(0.0, 1.0, 3) * (2.0 * np.pi, LATTICE, LATTICE)
    angles = rng.uniform(0.0, 2.0 * np.pi, LATTICE * LATTICE)
    grad_u, grad_v = ((f(angles) / DEVIATION).astype(np.float32) for f in (np.cos, np.sin))
    cos, sin = np.cos(turn) / wavelength, np.sin(turn) / wavelength
    shape = np.broadcast_shapes(x.shape, y.shape)
    x, y = (np.broadcast_to(a, shape) for a in (x, y))
    out = np.empty(shape, dtype=np.float32)
    # in strips of rows, see ROWS
    for first in range(0, shape[0], ROWS):
        rows = slice(first, first + ROWS)
        u = cos * x[rows] - sin * y[rows] + shift_u
        v = sin * x[rows] + cos * y[rows] + shift_v
        col, row = np.floor(u), np.floor(v)
        u, v = (u - col).astype(np.float32), (v - row).astype(np.float32)
        cols = [(col.astype(np.int32) + i) & (LATTICE - 1) for i in (0, 1)]
        lines = [((row.astype(np.int32) + i) & (LATTICE - 1)) * LATTICE for i in (0, 1)]
        fade_u, fade_v = (t * t * t * (t * (6 * t - 15) + 10) for t in (u, v))
        mixed = []
        for j in (0, 1):
            left, right = (grad_u[lines[j] + cols[i]] * (u - i) + grad_v[lines[j] + cols[i]] * (v - j) for i in (0, 1))
            mixed.append(left + fade_u * (right - left))
        out[rows] = mixed[0] + fade_v * (mixed[1] - mixed[0])
    return out


def fractal_noise(
    x: np.ndarray, y: np.ndarray, wavelength: float, octaves: range, hurst: float, seed: tuple[int, ...]
) -> np.ndarray:
    """Gradient noise summed over octaves; octave ``n`` has ``wavelength / 2^n`` and the deviation ``2^(-hurst n)``.

    Within its octaves the power of such noise per area of the wave-number plane falls as ``k^(-2 hurst - 2)``:
    fractional Brownian motion (B. B. Mandelbrot and J. W. Van Ness, 1968; H.-O. Peitgen and D. Saupe, "The Science of
    Fractal Images", 1988).

    Args:
        x: x of the points [m], as :func:`gradient_noise` takes it.
        y: y of the points [m].
        wavelength: Of octave 0 [m].
        octaves: Octaves to sum.
        hurst: Hurst exponent: how fast octaves fade.
        seed: Seed of the octaves, each of which has its own stream.

    Returns:
        Noise, float32 ``(nrow, ncol)``; octave 0 has variance 1.
    """
    out = np.zeros(np.broadcast_shapes(x.shape, y.shape), dtype=np.float32)
    for octave in octaves:
        noise = gradient_noise(x, y, wavelength / 2.0**octave, (*seed, octave))
        noise *= np.float32(2.0 ** (-hurst * octave))
        out += noise
    return out


def warp(
    x: np.ndarray, y: np.ndarray, wavelength: float, amount: float, seed: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Move points by smooth noise with deviation ``amount`` [m] along each axis, which hides the lattice."""
    dx, dy = (gradient_noise(x, y, wavelength, (*seed, axis)) for axis in (0, 1))
    return x + amount * dx, y + amount * dy
