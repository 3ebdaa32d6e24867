# SPDX-License-Identifier: Apache-2.0
"""Replicated model: builds Newton's model from the shapes of one environment, and repeats their arrays for the others.

Newton's ``ModelBuilder.finalize`` goes through all shapes ten times, in Python. A quadruped of 75 shapes in 4096
environments has 300,000 of them, which took half of the time that its scene takes to build. What it finds for a shape
depends on the shape alone, and all environments have the same ones: here it gets those that are shared and those of the
first environment, and the arrays of the others repeat what it found.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator, Sequence

import newton
import numpy as np
import warp as wp
from newton import GeoType, Model

__all__ = ["finalize_replicated", "is_repeated", "missing_names"]

_DIFFER = ("shape_label", "shape_body", "shape_transform", "shape_world")
"""Arrays in which shapes of one kind have values of their own."""
_ARRAYS = (("shape_body", wp.int32), ("shape_transform", wp.transform), ("shape_world", wp.int32))
_SHAPE = Model.AttributeFrequency.SHAPE
_OF_BUILDER = (
    "_array_backed_attributes", "_body_variants", "_build_shape_collision_filter_packed",
    "_custom_attribute_model_finalizers", "_raw_array_access", "_shape_collision_filter_pairs", "_shape_row_attributes",
)  # fmt: skip
"""Private names of Newton's builder that are used here: Newton has no public way to make a model of repeated shapes."""
_OF_MODEL = (
    "_set_shape_collision_filter_packed", "_shape_contact_pair_count", "_shape_contact_pair_counts",
    "_shape_contact_pair_data", "bvh_build_shapes",
)  # fmt: skip
"""Likewise of its model."""


def finalize_replicated(builder: newton.ModelBuilder, shared: int, device: str | wp.Device | None) -> newton.Model:
    """Make the model of a builder, the same as ``builder.finalize(device)``.

    Args:
        builder: The builder, whose shapes may be repeated, see :func:`is_repeated`; it stays as it is.
        shared: Shapes that all environments share; they come first.
        device: Device of the model.
    """
    count, worlds = builder.shape_count, builder.world_count
    if worlds < 2 or count == shared or missing_names() or not is_repeated(builder, shared):
        return builder.finalize(device=device)
    of_one = (count - shared) // worlds
    with _first_world(builder, shared + of_one):
        model = builder.finalize(device=device)
    repeated = shared + np.tile(np.arange(of_one), worlds)
    _grow(model, builder, np.concatenate((np.arange(shared), repeated)))
    starts = [shared + of_one * world for world in range(worlds + 1)] + [count]
    builder.shape_world_start[:] = starts
    model.shape_world_start = wp.array(starts, dtype=wp.int32, device=model.device)
    options = builder.default_bvh_cfg
    model.bvh_build_shapes(model, bvh_constructor=options.shape_constructor, shape_flags=options.shape_flags)
    return model


@functools.cache
def missing_names() -> list[str]:
    """Names of Newton that are used here and that this version of it lacks; with one, it makes the model by itself."""
    owners = ((newton.ModelBuilder(), _OF_BUILDER), (newton.Model(), _OF_MODEL))
    missing = [
        f"{type(owner).__name__}.{name}" for owner, names in owners for name in names if not hasattr(owner, name)
    ]
    try:
        from newton._src.sim.shape_contact_pairs import _ShapeContactPairs  # noqa: F401
    except ImportError:
        missing.append("_ShapeContactPairs")
    return missing


def is_repeated(builder: newton.ModelBuilder, shared: int) -> bool:
    """Whether all environments of a builder have shapes of the same values, apart from poses and a solver's attributes.

    Args:
        builder: The builder.
        shared: Shapes that all environments share; they come first.
    """
    count, worlds = builder.shape_count, builder.world_count
    of_one, rest = divmod(count - shared, worlds)
    if rest or builder._body_variants or int(GeoType.HFIELD) in map(int, builder.shape_type[shared : shared + of_one]):
        return False
    world = np.concatenate((np.full(shared, -1), np.repeat(np.arange(worlds), of_one)))
    with builder._raw_array_access():
        if not np.array_equal(builder.shape_world, world):
            return False
        rows = [name for name in builder._shape_row_attributes() if name not in _DIFFER]
        if not all(_repeats(getattr(builder, name), shared, of_one, worlds) for name in rows):
            return False
    own = [
        key for key in builder._custom_attribute_model_finalizers if builder.custom_attributes[key].frequency == _SHAPE
    ]
    return not own


def _repeats(values: Sequence[object] | np.ndarray, shared: int, of_one: int, worlds: int) -> bool:
    first = values[shared : shared + of_one]
    if isinstance(values, np.ndarray):
        return bool((values[shared:].reshape(worlds, of_one, -1) == np.asarray(first).reshape(1, of_one, -1)).all())
    return bool(values[shared:] == first * worlds)  # type: ignore[operator]  # they are lists


@contextlib.contextmanager
def _first_world(builder: newton.ModelBuilder, count: int) -> Iterator[None]:
    """Let a builder have its first shapes alone, all of which may collide, for as long as this lasts."""
    arrays, pairs = dict(builder._array_backed_attributes), builder._shape_collision_filter_pairs
    names = [name for name in {*builder._shape_row_attributes(), *_DIFFER} if name in vars(builder)]
    lists = {name: getattr(builder, name) for name in names}
    for name, values in lists.items():
        setattr(builder, name, values[:count])
    for name, (values, description) in arrays.items():
        if name.startswith("shape_"):
            builder._array_backed_attributes[name] = (values[:count], description)
    builder._shape_collision_filter_pairs = []
    try:
        yield
    finally:
        builder._array_backed_attributes.update(arrays)
        builder._shape_collision_filter_pairs = pairs
        for name, values in lists.items():
            setattr(builder, name, values)


def _grow(model: newton.Model, builder: newton.ModelBuilder, rows: np.ndarray) -> None:
    """Give a model all shapes of its builder.

    Args:
        model: Model of the first shapes.
        builder: The builder of all.
        rows: Shape of the model that each shape of the builder is like, shape ``(count,)``.
    """
    from newton._src.sim.shape_contact_pairs import _ShapeContactPairs  # here, as its place is Newton's own affair

    before = model.shape_count
    model.shape_count = len(rows)
    for name, value in list(vars(model).items()):
        if name.startswith(("shape_", "_shape_")) and isinstance(value, wp.array) and len(value) == before:
            setattr(model, name, _gather(value, rows))
    for attribute in builder.custom_attributes.values():
        owner = getattr(model, attribute.namespace) if attribute.namespace else model
        if attribute.frequency == _SHAPE and hasattr(owner, attribute.name):
            # By Newton, as a solver may number what belongs to an environment.
            setattr(owner, attribute.name, attribute.build_array(len(rows), device=model.device))
    with builder._raw_array_access():
        for name, dtype in _ARRAYS:
            setattr(model, name, wp.array(getattr(builder, name), dtype=dtype, device=model.device))
        packed = builder._build_shape_collision_filter_packed()
        model._set_shape_collision_filter_packed(packed)
        pairs = _ShapeContactPairs(
            builder.shape_body, builder.shape_world, builder.shape_collision_group, builder.shape_flags,
            packed, builder.world_count,
        )  # fmt: skip
    pairs.counts.setflags(write=False)
    model._shape_contact_pair_data = pairs
    model._shape_contact_pair_counts[None] = pairs.counts
    model._shape_contact_pair_count = int(pairs.counts.sum())
    model.shape_label, model.shape_source = builder.shape_label, builder.shape_source


def _gather(values: wp.array, rows: np.ndarray) -> wp.array:
    """Rows of an array, in an array of their own."""
    return wp.array(values.numpy()[rows], dtype=values.dtype, device=values.device)
