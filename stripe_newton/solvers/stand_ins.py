# SPDX-License-Identifier: Apache-2.0
"""Stand-ins: of many static shapes that collide alike, one that is a geom of MuJoCo's model for all of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp
from newton import ShapeFlags

from .static_meshes import FOUND_KINDS, marks_of

__all__ = ["MOST_GEOMS", "StandIns"]

_MANY = 256
"""Static shapes from which on they get stand-ins: what MuJoCo Warp lists of pairs grows with their number squared."""
MOST_GEOMS = 2048
"""Static shapes that are geoms at most; with more, Newton's collision detection finds all contacts if the fused step
cannot."""
_CONTACT = ("shape_margin", "shape_gap", "shape_collision_group", "shape_world")
"""Arrays of the model in which shapes agree that collide alike, beside those of materials and of MuJoCo."""


@dataclass(frozen=True)
class StandIns:
    """Static shapes that are no geoms, as MuJoCo Warp does not look for their contacts.

    MuJoCo Warp prepares each pair of geoms, also of two that cannot touch, and every world has the poses of all geoms:
    ten thousand static ones take minutes and gigabytes. Pairs, friction and stiffness of the shapes here are those of
    their stand-ins.
    """

    hidden: np.ndarray
    """Shapes that are no geoms, shape ``(count,)``."""
    stand_in: np.ndarray
    """Shapes that stand for them, ``(count,)``."""
    by_triangles: bool
    """Whether the fused step has routines for all that moves with their triangles: it is no cylinder and no mesh."""

    @classmethod
    def of(cls, model: newton.Model) -> StandIns | None:
        """Choose stand-ins among the static shapes that are marked for their triangles.

        Args:
            model: The model.

        Returns:
            None where there are few, or MuJoCo's model names pairs of geoms.
        """
        flags, bodies, worlds = (a.numpy() for a in (model.shape_flags, model.shape_body, model.shape_world))
        collides = (flags & ShapeFlags.COLLIDE_SHAPES) != 0
        pairs = getattr(getattr(model, "mujoco", None), "pair_geom1", None)  # of which each names two geoms
        if pairs is not None and len(pairs):
            return None
        shared = (worlds < 0) | (model.world_count == 1)  # others are at another place in each world
        shapes = np.flatnonzero(collides & (bodies < 0) & shared & (marks_of(model) > 0))
        if len(shapes) < _MANY:
            return None
        moving = np.flatnonzero(collides & (bodies >= 0) & (worlds <= 0))  # all worlds are alike
        keys = np.concatenate([_columns(model, shapes), _filters(model, shapes, moving)], axis=1)
        _, first, kind = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        stand_in = shapes[first][kind.reshape(-1)]
        hidden = stand_in != shapes
        kinds = model.shape_type.numpy()[collides & (bodies >= 0)]
        return cls(shapes[hidden], stand_in[hidden], bool(np.isin(kinds, FOUND_KINDS).all()))

    @property
    def many(self) -> bool:
        """Whether they are too many to be geoms."""
        return len(self.hidden) > MOST_GEOMS

    @contextmanager
    def hide(self, model: newton.Model) -> Iterator[None]:
        """Let the shapes be none that collide within a ``with`` block, in which MuJoCo's model is made."""
        kept = model.shape_flags.numpy().copy()  # on the CPU it is a view
        flags = kept.copy()
        flags[self.hidden] &= ~int(ShapeFlags.COLLIDE_SHAPES)
        model.shape_flags.assign(flags)
        try:
            yield
        finally:
            model.shape_flags.assign(kept)

    def map_shapes(self, geom_of_shape: wp.array) -> None:
        """Map hidden shapes to the geoms that represent them in contacts of Newton's collision detection.

        Args:
            geom_of_shape: Geom of each shape, -1 for none, shape ``(shape_count,)``; overwritten.
        """
        geoms = geom_of_shape.numpy()
        geoms[self.hidden] = geoms[self.stand_in]
        geom_of_shape.assign(geoms)

    def mismatched(self, model: newton.Model) -> np.ndarray:
        """Hidden shapes whose collision settings are no longer those of the geoms that represent them."""
        differ = (_columns(model, self.hidden) != _columns(model, self.stand_in)).any(axis=1)
        return self.hidden[differ]

    def geoms(self, shape_of_geom: np.ndarray) -> np.ndarray:
        """The geom that represents each hidden shape, shape ``(count,)``.

        Args:
            shape_of_geom: Shape of each geom, -1 for none, shape ``(ngeom,)``.
        """
        geom_of = {int(shape): geom for geom, shape in enumerate(shape_of_geom) if shape >= 0}
        return np.array([geom_of[int(shape)] for shape in self.stand_in], dtype=int)


def _columns(model: newton.Model, shapes: np.ndarray) -> np.ndarray:
    """Numbers that those of shapes have in common that collide alike, shape ``(shapes, columns)``."""
    names = [*_CONTACT, *(name for name in vars(model) if name.startswith("shape_material_"))]
    arrays = [getattr(model, name) for name in names]
    frequencies = model.attribute_frequency
    for name, frequency in frequencies.items():
        owner, _, leaf = name.rpartition(":")
        if owner and frequency == newton.Model.AttributeFrequency.SHAPE:
            arrays.append(getattr(getattr(model, owner), leaf))
    numbers = [a.numpy()[shapes].reshape(len(shapes), -1).astype(float) for a in arrays if a is not None]
    return np.concatenate(numbers, axis=1)


def _filters(model: newton.Model, shapes: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Which of the shapes that move each one does not touch, as bits, shape ``(shapes, columns)``."""
    pairs = np.stack(np.meshgrid(shapes, moving, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.packbits(model.shape_collision_filter_mask(pairs).reshape(len(shapes), -1), axis=1).astype(float)
