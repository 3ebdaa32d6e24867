# SPDX-License-Identifier: Apache-2.0
"""Recolouring: colours for shapes whose stage gives them none."""

from __future__ import annotations

from collections.abc import Sequence

import newton
import numpy as np

__all__ = ["recolor_model", "recolor_shapes"]

_GROUND_TYPES = (int(newton.GeoType.PLANE), int(newton.GeoType.HFIELD))
_PALETTE = ((0.905, 0.892, 0.865), (0.890, 0.460, 0.240), (0.245, 0.345, 0.455))
_STATIC_COLOR = (0.62, 0.60, 0.57)
_GROUND_COLOR = (0.66, 0.69, 0.72)
_LEVEL_WITHOUT_COLOR = 0.18
"""Linear grey that Newton's USD importer gives to shapes without a material."""


def recolor_shapes(
    builder: newton.ModelBuilder, first_shape: int, first_body: int, template: newton.ModelBuilder
) -> None:
    """Colour shapes without an authored colour by their body's place in its chain.

    Args:
        builder: Copies of ``template`` after the static scene.
        first_shape: First shape of the copies.
        first_body: First body of the copies.
        template: Builder of one copy.
    """
    ranks, bodies = _body_ranks(template), template.body_count
    for i in range(builder.shape_count):
        if not _is_default(builder.shape_color[i]):
            continue
        # Ground, what stands still, then robots by body.
        body = int(builder.shape_body[i])
        if int(builder.shape_type[i]) in _GROUND_TYPES:
            color = _GROUND_COLOR
        elif body < first_body or i < first_shape:
            color = _STATIC_COLOR
        else:
            color = _PALETTE[ranks[(body - first_body) % bodies]]
        builder.shape_color[i] = color


def recolor_model(model: newton.Model, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
    """Colour shapes of a simulation's model as pictures of it do, see :func:`recolor_shapes`.

    Args:
        model: The static scene's shapes, then those of the template for each environment.
        template: Builder of one environment.
        static: Builder of what all environments share.
    """
    count = len(colors := model.shape_color.numpy()) if model.shape_count else 0
    if not count:
        return
    # Environments differ in few colours: each is looked at once.
    kinds, which = np.unique(colors, axis=0, return_inverse=True)
    plain = np.array([_is_default(color) for color in kinds])[which.reshape(-1)]
    if not plain.any():
        return
    one = newton.ModelBuilder()
    one.add_builder(static)
    first_body = one.body_count
    one.add_builder(template)
    recolor_shapes(one, static.shape_count, first_body, template)
    index = np.arange(count)
    index[static.shape_count :] = static.shape_count + (index[static.shape_count :] - static.shape_count) % max(
        template.shape_count, 1
    )
    made = np.array(one.shape_color, dtype=np.float32).reshape(-1, 3)
    model.shape_color.assign(np.where(plain[:, None], made[index], colors).astype(np.float32))


def _body_ranks(template: newton.ModelBuilder) -> list[int]:
    """Palette index of each body: 0 for bodies that carry others, 1 for the next to last of a chain, 2 for the last.

    Bodies welded together count as one. A body that no joint connects to others gets 1.
    """
    group = _welded_groups(template)
    fixed = int(newton.JointType.FIXED)
    links = [
        (group[p], group[c])
        for kind, p, c in zip(template.joint_type, template.joint_parent, template.joint_child)
        if int(kind) != fixed and p >= 0 and group[p] != group[c]
    ]
    height = _heights_above_leaves(group, links)
    connected = {g for link in links for g in link}
    return [max(2 - height[g], 0) if g in connected else 1 for g in group]


def _welded_groups(template: newton.ModelBuilder) -> list[int]:
    """For each body, a number that it shares with the bodies welded to it."""
    group = list(range(template.body_count))
    for kind, parent, child in zip(template.joint_type, template.joint_parent, template.joint_child):
        if int(kind) == int(newton.JointType.FIXED) and parent >= 0:
            # The child may have a group of its own already, as joints come in any order: all of it joins.
            old, new = group[child], group[parent]
            group = [new if g == old else g for g in group]
    return group


def _heights_above_leaves(groups: Sequence[int], links: Sequence[tuple[int, int]]) -> dict[int, int]:
    """Number of links from each group to the farthest end of a chain that it carries."""
    height = dict.fromkeys(groups, 0)
    # Closed loops have no end: the number of rounds and the height are bounded by the number of bodies.
    for _ in groups:
        before = dict(height)
        for parent, child in links:
            height[parent] = min(max(height[parent], height[child] + 1), len(groups))
        if height == before:
            break
    return height


def _default_colors() -> np.ndarray:
    """Colours in sRGB that Newton gives to shapes without a colour, shape (n, 3)."""
    probe = newton.ModelBuilder()
    for _ in range(24):  # Newton gives out the colours of a palette in turn
        probe.add_shape_sphere(-1)
    probe.add_ground_plane()
    grey = newton.utils.color_linear_to_srgb((_LEVEL_WITHOUT_COLOR,) * 3)
    return np.unique(np.array([*probe.shape_color, grey]), axis=0)


_DEFAULTS: list[np.ndarray] = []
"""Colours that Newton gives to shapes, computed at the first use: importing this module makes no builder."""


def _is_default(color: Sequence[float]) -> bool:
    """Whether a colour is one that Newton gave, up to the rounding of its conversion to sRGB."""
    if not _DEFAULTS:
        _DEFAULTS.append(_default_colors())
    return bool(np.abs(_DEFAULTS[0] - np.asarray(color, dtype=float)).max(axis=1).min() < 2e-3)
