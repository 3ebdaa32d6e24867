# SPDX-License-Identifier: Apache-2.0
"""Model structs: quantities of the model as the structs that randomising events take."""

from __future__ import annotations

from collections.abc import Iterable

import torch
import warp as wp

from stripe_newton.fusion.warp_types import Struct, StructInstance, struct_fields
from stripe_newton.scene.model_fields import MODEL_FIELDS

from .context import ManagerContext

__all__ = ["MODEL_FIELDS", "SCENE", "ModelStructs"]

SCENE = "scene"
"""Name of structs that belong to the whole scene rather than to an asset."""


class ModelStructs:
    """Structs of the model by type and asset. The array of a field is made when a term first needs it."""

    def __init__(self, context: ManagerContext):
        self._context = context
        self._made: dict[tuple[Struct, str], StructInstance] = {}

    def get(self, kind: Struct, name: str, fields: Iterable[str]) -> StructInstance:
        """A struct with at least some of its fields set. Terms can take it as an argument from then on.

        Args:
            kind: A type of :data:`MODEL_FIELDS`.
            name: Name of the asset, or :data:`SCENE`.
            fields: Names of the fields to set; names that the struct does not have are skipped.

        Raises:
            KeyError: if there is no such asset.
        """
        struct = self._made.get((kind, name))
        if struct is None:
            struct = self._made[kind, name] = kind()
            self._context.provide(struct, name)
        missing = [f for f in fields if f in struct_fields(kind) and not _is_there(getattr(struct, f))]
        for field in missing:
            setattr(struct, field, self._array(kind, name, field))
        return struct

    def default(self, kind: Struct, name: str, field: str, ids: list[int]) -> torch.Tensor:
        """Default values of a field for some bodies, joints or shapes in the first environment, shape ``(n, ...)``."""
        wanted = field if field.startswith("initial") else f"default_{field}"
        return wp.to_torch(getattr(self.get(kind, name, [wanted]), wanted))[0, ids]

    def _array(self, kind: Struct, name: str, field: str) -> wp.array:
        context = self._context
        if field == "kind":
            return wp.array([int(t) for t in context.scene.sim.template.shape_type], dtype=int, device=context.device)
        if field == "initial_joint_pos":
            positions = context.asset(name).native_data.struct.default_joint_pos
            context.arrays[f"default_joint_pos.{name}"] = positions
            return wp.clone(positions)
        return context.scene.controller.model_array(kind, field, None if name == SCENE else context.asset(name).layout)


def _is_there(array: wp.array | None) -> bool:
    return array is not None and bool(array.ptr)
