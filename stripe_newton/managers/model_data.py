# SPDX-License-Identifier: Apache-2.0
"""Model structs: quantities of the model as the structs that randomising events take."""

from __future__ import annotations

from collections.abc import Iterable

import torch
import warp as wp

from stripe_kernels.model_data import BodyModelData, JointModelData, SceneModelData, ShapeModelData
from stripe_newton.fusion.warp_types import Struct, StructInstance, dtype_of, struct_fields

from .context import ManagerContext

__all__ = ["MODEL_FIELDS", "SCENE", "ModelStructs"]

SCENE = "scene"
"""Name of structs that belong to the whole scene rather than to an asset."""

MODEL_FIELDS: dict[Struct, dict[str, str]] = {
    BodyModelData: {
        "mass": "body_mass",
        "inv_mass": "body_inv_mass",
        "inertia": "body_inertia",
        "inv_inertia": "body_inv_inertia",
        "com": "body_com",
    },
    JointModelData: {
        "stiffness": "joint_target_ke",
        "damping": "joint_target_kd",
        "effort_limit": "joint_effort_limit",
        "friction": "joint_friction",
        "armature": "joint_armature",
        "passive_stiffness": "joint_stiffness",
        "passive_damping": "joint_damping",
        "lower": "joint_limit_lower",
        "upper": "joint_limit_upper",
    },
    ShapeModelData: {
        "friction": "shape_material_mu",
        "torsional_friction": "shape_material_mu_torsional",
        "rolling_friction": "shape_material_mu_rolling",
        "restitution": "shape_material_restitution",
        "margin": "shape_margin",
        "gap": "shape_gap",
        "pose": "shape_transform",
        "size": "shape_scale",
        "radius": "shape_collision_radius",
        "color": "shape_color",
    },
    SceneModelData: {"gravity": "gravity"},
}
"""Arrays of ``newton.Model`` behind the fields of each struct."""


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
        dtype = dtype_of(kind, field)
        if field == "kind":
            return wp.array([int(t) for t in context.scene.sim.template.shape_type], dtype=int, device=context.device)
        if field == "initial_joint_pos":
            positions = context.asset(name).data.struct.default_joint_pos
            context.arrays[f"default_joint_pos.{name}"] = positions
            return wp.clone(positions)
        is_default = field.startswith("default_")
        source = MODEL_FIELDS[kind][field.removeprefix("default_")]
        values = context.scene.controller.field(source)[is_default]
        if kind in (BodyModelData, JointModelData):
            layout = context.asset(name).layout
            rows = layout.body_slice if kind is BodyModelData else _slice(layout.dofs)
            if not isinstance(rows, slice):
                raise ValueError(f"the bodies of '{name}' do not lie together in the model, events cannot change them")
            values = values[:, rows]
        return wp.from_torch(values, dtype=dtype)


def _is_there(array: wp.array | None) -> bool:
    return array is not None and bool(array.ptr)


def _slice(rows: range) -> slice:
    return slice(rows.start, rows.stop)
