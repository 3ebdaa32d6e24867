# SPDX-License-Identifier: Apache-2.0
"""Body choice: a rigid body that is another asset in each environment, within one model of equal worlds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import newton
import numpy as np
from newton import GeoType, ShapeFlags

__all__ = ["BodyChoice", "why_no_choice"]

_CONTACTS = int(ShapeFlags.COLLIDE_SHAPES)
_ROLES = _CONTACTS | int(ShapeFlags.SITE)
_OF_THE_ROW = frozenset({"shape_label", "shape_body", "shape_world", "shape_world_start", "shape_collision_group"})
"""Lists of shapes that say where a row belongs, not what it is."""
_OF_BODIES = "body_mass", "body_inertia", "body_inv_mass", "body_inv_inertia", "body_com"
_KINDS = "mujoco:condim", "mujoco:geom_priority"
"""Attributes of shapes that MuJoCo Warp has once for all worlds."""
_ENDLESS = GeoType.PLANE, GeoType.HFIELD


class BodyChoice:
    """A rigid body that is another asset in each environment.

    MuJoCo Warp has one tree of bodies and one list of geoms, with their types, for all worlds; sizes, meshes, places,
    masses and materials it has for each. So the body gets as many shapes of each type as any asset has. In an
    environment its asset fills them; those that are left over are absent there, see :class:`.AbsentShapes`.

    Attributes:
        choice: Which asset each environment holds, shape ``(num_envs,)``.
    """

    def __init__(
        self, template: newton.ModelBuilder, body: int, assets: Sequence[newton.ModelBuilder], choice: np.ndarray
    ):
        """Add the shapes to the body of one environment that other assets have and it lacks.

        Args:
            template: Builder of one environment, in which the body is the asset of the first one.
            body: The body's row.
            assets: A builder of each asset, with its one body.
            choice: Which asset each environment holds, shape ``(num_envs,)``.
        """
        self.choice, self._body, self._assets = choice, body, assets
        rows: dict[tuple[int, ...], list[int]] = defaultdict(list)
        for shape in template.body_shapes[body]:
            rows[_kind(template, shape)].append(shape)
        self._filled = [self._fill(template, asset, rows) for asset in assets]
        self._rows = [row for group in rows.values() for row in group]

    def _fill(
        self, template: newton.ModelBuilder, asset: newton.ModelBuilder, rows: dict[tuple[int, ...], list[int]]
    ) -> dict[int, int]:
        """Shape of an asset by the row that it fills; rows that are missing are added."""
        filled, taken = {}, defaultdict[tuple[int, ...], int](int)
        for shape in range(asset.shape_count):
            kind = _kind(asset, shape)
            group, place = rows[kind], taken[kind]
            if place == len(group):
                group.append(_add_shape(template, self._body, asset, shape))
            filled[group[place]] = shape
            taken[kind] += 1
        return filled

    def write(self, builder: newton.ModelBuilder, env: int, first_shape: int, first_body: int) -> None:
        """Write the asset of an environment onto a copy of the template.

        Args:
            builder: Builder that holds the copy.
            env: The environment.
            first_shape: First shape of the copy.
            first_body: First body of the copy.
        """
        asset, filled = self._assets[self.choice[env]], self._filled[self.choice[env]]
        for row, shape in filled.items():
            _copy_shape(builder, first_shape + row, asset, shape)
        body = first_body + self._body
        for name in _OF_BODIES:
            getattr(builder, name)[body] = getattr(asset, name)[0]
        _copy_attributes(builder, body, asset, 0, newton.Model.AttributeFrequency.BODY)

    def absent(self, env: int) -> Iterator[int]:
        """Shapes of the template that the asset of an environment does not fill."""
        filled = self._filled[self.choice[env]]
        return (row for row in self._rows if row not in filled)


def why_no_choice(asset: newton.ModelBuilder) -> str:
    """Reason why an asset cannot be one of several in a place; empty if it can."""
    if asset.body_count != 1:
        return f"makes {asset.body_count} bodies, must make one rigid body"
    if asset.joint_count > 1 or any(kind != newton.JointType.FREE for kind in asset.joint_type):
        return "is held by a joint, must be free"
    for shape in range(asset.shape_count):
        if asset.shape_body[shape] != 0:
            return f"has the static shape '{asset.shape_label[shape]}', all must belong to its body"
        if asset.shape_type[shape] in _ENDLESS:
            return f"has '{asset.shape_label[shape]}', a {GeoType(asset.shape_type[shape]).name.lower()}"
    return ""


def _kind(builder: newton.ModelBuilder, shape: int) -> tuple[int, ...]:
    """Key of a row of shapes: type, role, and the attributes of which MuJoCo Warp has one for all worlds."""
    own = []
    for key in _KINDS:
        attribute = builder.custom_attributes.get(key)
        values = attribute.values if attribute is not None else None
        own.append(int((values or {}).get(shape, attribute.default if attribute is not None else 0)))
    flags = int(builder.shape_flags[shape])
    return int(builder.shape_type[shape]), flags & _ROLES, int(builder.shape_collision_group[shape]), *own


def _add_shape(template: newton.ModelBuilder, body: int, asset: newton.ModelBuilder, shape: int) -> int:
    """Add a copy of an asset's shape to a body; its mass stays."""
    flags = int(asset.shape_flags[shape])
    cfg = newton.ModelBuilder.ShapeConfig(
        density=0.0,
        has_shape_collision=bool(flags & _CONTACTS),
        collision_group=int(asset.shape_collision_group[shape]),
    )
    row = template.add_shape(
        body=body,
        type=asset.shape_type[shape],
        xform=asset.shape_transform[shape],
        scale=asset.shape_scale[shape],
        src=asset.shape_source[shape],
        cfg=cfg,
        label=f"{template.body_label[body]}/other_{template.shape_count}",
    )
    _copy_shape(template, row, asset, shape)
    return row


def _copy_shape(builder: newton.ModelBuilder, row: int, asset: newton.ModelBuilder, shape: int) -> None:
    """Write all that a shape is, but not where it belongs, onto a row."""
    for name, values in vars(asset).items():
        if name.startswith("shape_") and isinstance(values, list) and name not in _OF_THE_ROW:
            getattr(builder, name)[row] = values[shape]
    _copy_attributes(builder, row, asset, shape, newton.Model.AttributeFrequency.SHAPE)


def _copy_attributes(
    builder: newton.ModelBuilder,
    row: int,
    asset: newton.ModelBuilder,
    source: int,
    frequency: newton.Model.AttributeFrequency,
) -> None:
    """Write the custom attributes of a row of an asset onto a row of a builder."""
    for key, attribute in builder.custom_attributes.items():
        if attribute.frequency != frequency or not isinstance(attribute.values, dict | None):
            continue
        given = asset.custom_attributes[key].values if key in asset.custom_attributes else None
        if attribute.values is None:
            attribute.values = {}
        if given and source in given:
            attribute.values[row] = given[source]
        else:
            attribute.values.pop(row, None)
