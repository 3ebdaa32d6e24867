# SPDX-License-Identifier: Apache-2.0
"""Other heights for the height field of a built model, in place: graphs that read them go on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import newton
import numpy as np
import warp as wp

if TYPE_CHECKING:
    from .simulation import Simulation

__all__ = ["replace_heights"]

_BOUNDS = "shape_collision_aabb_lower", "shape_collision_aabb_upper", "shape_collision_radius"


def replace_heights(sim: Simulation, shape: int, source: newton.Heightfield) -> None:
    """Write the heights of ``source`` wherever the model and the solver keep those of a shape.

    Newton's arrays, its mesh of the field with its tree of bounds, and MuJoCo's field with the pose and bounds of its
    geoms are written; none is replaced.

    Args:
        sim: A simulation that is built.
        shape: Index of the height field in the model; its only one, and not scaled.
        source: Heights, on a grid of as many rows and columns and of the same extent.

    Raises:
        ValueError: for another grid, or a model with several height fields.
    """
    model = sim.model
    old = model.shape_source[shape]
    for name in ("nrow", "ncol", "hx", "hy"):
        if not np.isclose(getattr(source, name), getattr(old, name), rtol=1.0e-5):
            raise ValueError(
                f"'{model.shape_label[shape]}': {name} of the new height field is {getattr(source, name)}, must be "
                f"{getattr(old, name)} as in the one that is there"
            )
    if model.heightfield_count != 1:
        raise ValueError(f"the model has {model.heightfield_count} height fields: only one alone can be replaced")
    with wp.ScopedDevice(sim.device):
        _write_newton(model, shape, source)
    if getattr(sim.solver, "mjw_model", None) is None:
        sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)
        return
    with wp.ScopedDevice(sim.device):
        made = _write_mujoco(sim.solver, shape, source)
    sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)  # the geoms go to the height of the lowest point
    _write_rows(sim.solver.mjw_model.geom_size, made.there, made.size)  # which notify takes from the shape's scale


def _write_newton(model: newton.Model, shape: int, source: newton.Heightfield) -> None:
    """Copy what Newton makes of a field, in a model of its own."""
    builder = newton.ModelBuilder()
    builder.add_shape_heightfield(heightfield=source)
    made = builder.finalize(device=model.device)
    for name in _BOUNDS:
        wp.copy(getattr(model, name), getattr(made, name), dest_offset=shape, count=1)
    wp.copy(model.heightfield_data, made.heightfield_data)
    wp.copy(model.heightfield_elevations, made.heightfield_elevations)
    for mesh, other in zip(model.heightfield_meshes, made.heightfield_meshes, strict=True):
        wp.copy(mesh.points, other.points)
        mesh.refit()
    model.shape_source[shape] = source


@dataclass
class _Made:
    """What MuJoCo compiles of a field: ``there`` are its geoms, ``box`` their middle and half extents [m]."""

    there: np.ndarray
    size: np.ndarray
    box: np.ndarray
    radius: float


def _write_mujoco(solver: Any, shape: int, source: newton.Heightfield) -> _Made:
    """Write MuJoCo's field, whose heights are shares of its size above its lowest point, which is the geom's origin."""
    there = solver.mjc_geom_to_newton_shape.numpy() == shape
    model, host = solver.mjw_model, solver.mj_model
    geom = int(np.flatnonzero(there[0])[0])
    field = int(model.geom_dataid.numpy()[0, geom])
    size = model.hfield_size.numpy()
    size[field, 2] = max(source.max_z - source.min_z, 1.0e-4)  # as SolverMuJoCo has it
    heights, start = source.data.reshape(-1), int(model.hfield_adr.numpy()[field])
    wp.copy(model.hfield_data, wp.array(heights, dtype=float, device="cpu"), dest_offset=start, count=heights.size)
    model.hfield_size.assign(size)
    made = _compile(there, size[field])
    _write_rows(model.geom_aabb, there, made.box)
    _write_rows(model.geom_rbound, there, made.radius)
    offsets = solver._shape_hfield_offset.numpy()
    raised = source.min_z - float(offsets[shape])
    offsets[shape] = source.min_z
    solver._shape_hfield_offset.assign(offsets)  # notify_model_changed puts the geoms there
    host.hfield_size[field] = size[field]
    host.hfield_data[start : start + heights.size] = heights
    host.geom_aabb[geom], host.geom_rbound[geom], host.geom_size[geom] = made.box.reshape(-1), made.radius, made.size
    host.geom_pos[geom, 2] += raised
    return made


def _write_rows(array: wp.array, rows: np.ndarray, value: np.ndarray | float) -> None:
    values = array.numpy()
    values[rows] = value
    array.assign(values)


def _compile(there: np.ndarray, size: np.ndarray) -> _Made:
    import mujoco

    spec = mujoco.MjSpec()
    spec.add_hfield(name="field", nrow=2, ncol=2, size=[float(s) for s in size], userdata=[0.0, 1.0, 0.0, 1.0])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="field")
    made = spec.compile()
    box = made.geom_aabb.reshape(-1, 2, 3)[0].copy()
    return _Made(there, made.geom_size[0].copy(), box, float(made.geom_rbound[0]))
