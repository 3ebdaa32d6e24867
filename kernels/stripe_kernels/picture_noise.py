# SPDX-License-Identifier: Apache-2.0
"""Picture noise: hash and value noise for the grain of surfaces in pictures."""

import warp as wp

__all__ = ["ground_albedo", "lattice", "value_noise"]


@wp.func
def lattice(x: int, y: int, z: int):
    """Hash of a point with whole coordinates to a number in [0, 1)."""
    # The primes of M. Teschner et al., "Optimized Spatial Hashing", 2003; the shifts mix the low bits further.
    h = wp.uint32(x) * wp.uint32(73856093) ^ wp.uint32(y) * wp.uint32(19349663) ^ wp.uint32(z) * wp.uint32(83492791)
    h = (h ^ (h >> wp.uint32(13))) * wp.uint32(1274126177)
    h = h ^ (h >> wp.uint32(16))
    return float(h & wp.uint32(65535)) / 65536.0


@wp.func
def value_noise(p: wp.vec3f):
    """Smooth noise in [0, 1): lattice values, interpolated by smoothsteps (Perlin 1985)."""
    x = int(wp.floor(p[0]))
    y = int(wp.floor(p[1]))
    z = int(wp.floor(p[2]))
    fx = p[0] - float(x)
    fy = p[1] - float(y)
    fz = p[2] - float(z)
    fx = fx * fx * (3.0 - 2.0 * fx)
    fy = fy * fy * (3.0 - 2.0 * fy)
    fz = fz * fz * (3.0 - 2.0 * fz)
    low = wp.lerp(
        wp.lerp(lattice(x, y, z), lattice(x + 1, y, z), fx),
        wp.lerp(lattice(x, y + 1, z), lattice(x + 1, y + 1, z), fx),
        fy,
    )
    high = wp.lerp(
        wp.lerp(lattice(x, y, z + 1), lattice(x + 1, y, z + 1), fx),
        wp.lerp(lattice(x, y + 1, z + 1), lattice(x + 1, y + 1, z + 1), fx),
        fy,
    )
    return wp.lerp(low, high, fz)


@wp.func
def ground_albedo(base: wp.vec3f, point: wp.vec3f, footprint: float):
    """Colour of the ground: moss, litter, and grain as fine as a pixel of ``footprint`` [m] can show, linear RGB.

    Moss and litter appear on soil only, not on grey ground such as concrete.
    """
    # Saturation tells soil from grey ground: the smallest channel over the largest is near 1 for grey.
    soil = wp.clamp(20.0 * (0.53 - wp.min(base) / wp.max(wp.max(base), 1.0e-3)), 0.0, 1.0)
    patch = 0.6 * value_noise(point * 0.35) + 0.4 * value_noise(point * 1.3)
    moss = soil * wp.clamp(4.0 * (patch - 0.52), 0.0, 1.0)
    litter_tint = wp.lerp(wp.vec3f(1.0, 1.0, 1.0), wp.vec3f(1.05, 1.0, 0.95), soil)
    color = wp.cw_mul(base, wp.lerp(litter_tint, wp.vec3f(0.72, 1.12, 0.62), moss))
    grain = value_noise(point * 6.0) - 0.5
    color = color * (1.0 + 0.5 * grain)
    near = wp.clamp(1.0 - 12.0 * footprint, 0.0, 1.0)
    if near > 0.0:  # finer than a pixel, the noise would flicker
        chip = value_noise(wp.vec3f(point[0] * 22.0, point[1] * 22.0, point[2] * 5.0))
        fleck = value_noise(wp.vec3f(point[0] * 61.0, point[1] * 61.0, 3.0))
        litter = wp.clamp(6.0 * (chip - 0.58), 0.0, 1.0) * (0.4 + 0.6 * fleck)
        color = color * (1.0 + near * 0.7 * (fleck - 0.5))
        color = color + wp.cw_mul(base, wp.vec3f(1.3, 0.75, 0.35)) * (near * litter * soil)
    return color
