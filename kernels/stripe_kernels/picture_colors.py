# SPDX-License-Identifier: Apache-2.0
"""Picture colours: linear RGB to sRGB bytes and back."""

import warp as wp

__all__ = ["encode", "encode_channel", "pack_color", "texture_color", "to_linear"]


@wp.func
def to_linear(c: float):
    """Linear value of an sRGB value, both 0 to 1, by a polynomial (error below 0.002)."""
    return c * (c * (c * 0.305306 + 0.682171) + 0.012523)


@wp.func
def texture_color(packed: wp.uint32):
    """Linear RGB of a packed sRGB colour, red in its lowest byte."""
    return wp.vec3f(
        to_linear(float(packed & wp.uint32(255)) / 255.0),
        to_linear(float((packed >> wp.uint32(8)) & wp.uint32(255)) / 255.0),
        to_linear(float((packed >> wp.uint32(16)) & wp.uint32(255)) / 255.0),
    )


@wp.func
def encode_channel(c: float):
    """Encode a linear value, 0 to 1, as an sRGB byte, by square roots (error below 1/255)."""
    s1 = wp.sqrt(c)
    s2 = wp.sqrt(s1)
    s3 = wp.sqrt(s2)
    x = 0.662002687 * s1 + 0.684122060 * s2 - 0.323583601 * s3 - 0.0225411470 * c
    return wp.uint8(wp.clamp(x, 0.0, 1.0) * 255.0 + 0.5)


@wp.func
def pack_color(color: wp.vec3f):
    """Linear colour as packed sRGB bytes, red in the lowest one and 255 in the highest."""
    red = wp.uint32(encode_channel(color[0]))
    green = wp.uint32(encode_channel(color[1]))
    blue = wp.uint32(encode_channel(color[2]))
    opaque = wp.uint32(255) << wp.uint32(24)
    return opaque | (blue << wp.uint32(16)) | (green << wp.uint32(8)) | red


@wp.func
def encode(color: wp.vec3f, pixel: int, picture: wp.array[wp.uint8]):
    """Write a linear colour as three sRGB bytes."""
    picture[3 * pixel] = encode_channel(color[0])
    picture[3 * pixel + 1] = encode_channel(color[1])
    picture[3 * pixel + 2] = encode_channel(color[2])
