# SPDX-License-Identifier: Apache-2.0
"""Colours for shapes to which a stage gives none."""

from __future__ import annotations

from typing import Any

import newton
import numpy as np

__all__ = ["recolor_shapes"]

_GROUND_TYPES = (int(newton.GeoType.PLANE), int(newton.GeoType.HFIELD))
_PALETTE = ((0.905, 0.892, 0.865), (0.890, 0.460, 0.240), (0.245, 0.345, 0.455))
_STATIC_COLOR = (0.62, 0.60, 0.57)
_GROUND_COLOR = (0.66, 0.69, 0.72)
_LEVEL_WITHOUT_COLOR = 0.18  # linear grey that Newton's USD import gives to what has no material


def recolor_shapes(
    builder: newton.ModelBuilder, first_shape: int, first_body: int, bodies: int, copies: int, template: Any
) -> None:
    """Colours for shapes without an authored one: by a body's place in its chain."""
    ranks = _body_ranks(template)
    for i in range(builder.shape_count):
        if not _is_default(builder.shape_color[i], builder.shape_type[i]):
            continue
        body = int(builder.shape_body[i])
        if int(builder.shape_type[i]) in _GROUND_TYPES:
            color = _GROUND_COLOR
        elif body < first_body or i < first_shape:
            color = _STATIC_COLOR
        else:
            color = _PALETTE[ranks[(body - first_body) % bodies]]
        builder.shape_color[i] = color


def _body_ranks(template: newton.ModelBuilder) -> list[int]:
    """Palette index of each body: 0 for what carries others, 1 for the next to last of a chain, 2 for the last.

    Bodies welded together count as one; a body that is alone gets 1.
    """
    joints = [
        (int(k), int(p), int(c)) for k, p, c in zip(template.joint_type, template.joint_parent, template.joint_child)
    ]
    welded = int(newton.JointType.FIXED)
    group = list(range(template.body_count))
    for kind, parent, child in joints:
        if kind == welded and parent >= 0:
            old, new = group[child], group[parent]
            group = [new if g == old else g for g in group]
    height = dict.fromkeys(group, 0)
    links = [(group[p], group[c]) for k, p, c in joints if k != welded and p >= 0 and group[p] != group[c]]
    for _ in range(template.body_count):
        before = dict(height)
        for parent, child in links:
            height[parent] = min(max(height[parent], height[child] + 1), template.body_count)
        if height == before:
            break
    alone = set(group) - {g for link in links for g in link}
    return [1 if g in alone else max(2 - height[g], 0) for g in group]


def _default_colors() -> np.ndarray:
    """SRGB of what Newton gives to shapes nobody coloured, shape (n, 3)."""
    probe = newton.ModelBuilder()
    for _ in range(24):
        probe.add_shape_sphere(-1)
    probe.add_ground_plane()
    grey = newton.utils.color_linear_to_srgb((_LEVEL_WITHOUT_COLOR,) * 3)
    return np.unique(np.array([*probe.shape_color, grey]), axis=0)


_DEFAULTS: list[np.ndarray] = []


def _is_default(color: Any, kind: Any) -> bool:
    if not _DEFAULTS:
        _DEFAULTS.append(_default_colors())
    return bool(np.abs(_DEFAULTS[0] - np.asarray(color, dtype=float)).max(axis=1).min() < 2e-3)
