# SPDX-License-Identifier: Apache-2.0
"""Height field replacement: other heights for the height field of a built model, in place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import newton
import numpy as np
import warp as wp

from .mujoco_solver_cfg import MuJoCoSolverCfg

if TYPE_CHECKING:
    from .simulation import Simulation

__all__ = ["replace_heights"]

_BOUNDS = "shape_collision_aabb_lower", "shape_collision_aabb_upper", "shape_collision_radius"


def replace_heights(sim: Simulation, shape: int, source: newton.Heightfield) -> None:
    """Write the heights of ``source`` wherever the model and the solver keep those of a shape.

    Newton's arrays, its mesh of the field with its tree of bounds, and MuJoCo's field with the pose and bounds of its
    geoms are written; none is replaced, so that graphs that read them stay valid.

    Args:
        sim: A simulation that is built.
        shape: Index of the height field in the model; its only one, and not scaled.
        source: Heights, on a grid of the same rows, columns and extent.

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
    if not isinstance(sim.cfg.solver, MuJoCoSolverCfg):
        sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)
        return
    with wp.ScopedDevice(sim.device):
        compiled = _write_mujoco(sim.solver, shape, source)
    sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)  # moves the geoms to the height of the lowest point
    # SolverMuJoCo takes sizes of geoms from the shapes' scale, which of a height field is 1: it has just overwritten
    # what MuJoCo compiled.
    _write_rows(sim.solver.mjw_model.geom_size, compiled.geoms, compiled.size)


def _write_newton(model: newton.Model, shape: int, source: newton.Heightfield) -> None:
    """Copy what Newton makes of a height field, in a model of its own."""
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
class _CompiledField:
    """A height field as MuJoCo compiles it."""

    geoms: np.ndarray
    """Whether a geom of a world is the field, bool, shape ``(num_envs, ngeom)``."""
    size: np.ndarray
    """``geom_size``."""
    box: np.ndarray
    """``geom_aabb``: middle and half extents [m], shape ``(2, 3)``."""
    radius: float
    """``geom_rbound`` [m]."""


def _write_mujoco(solver: newton.solvers.SolverMuJoCo, shape: int, source: newton.Heightfield) -> _CompiledField:
    """Write MuJoCo's field, whose heights are shares of its size above its lowest point, which is the geom's origin."""
    geoms = solver.mjc_geom_to_newton_shape.numpy() == shape
    model, host = solver.mjw_model, solver.mj_model
    geom = int(np.flatnonzero(geoms[0])[0])
    field = int(model.geom_dataid.numpy()[0, geom])
    size = model.hfield_size.numpy()
    size[field, 2] = max(source.max_z - source.min_z, 1.0e-4)  # SolverMuJoCo's least height, of a level field
    heights, start = source.data.reshape(-1), int(model.hfield_adr.numpy()[field])
    wp.copy(model.hfield_data, wp.array(heights, dtype=float, device="cpu"), dest_offset=start, count=heights.size)
    model.hfield_size.assign(size)
    compiled = _compile(geoms, size[field])
    _write_rows(model.geom_aabb, geoms, compiled.box)
    _write_rows(model.geom_rbound, geoms, compiled.radius)
    offsets = solver._shape_hfield_offset.numpy()
    raised = source.min_z - float(offsets[shape])
    offsets[shape] = source.min_z
    solver._shape_hfield_offset.assign(offsets)  # notify_model_changed puts the geoms there
    # The host's model stays equal to the device's: exports are written from it, and MuJoCo's C implementation runs it.
    host.hfield_size[field] = size[field]
    host.hfield_data[start : start + heights.size] = heights
    host.geom_aabb[geom], host.geom_rbound[geom] = compiled.box.reshape(-1), compiled.radius
    host.geom_size[geom] = compiled.size
    host.geom_pos[geom, 2] += raised
    return compiled


def _write_rows(array: wp.array, rows: np.ndarray, value: np.ndarray | float) -> None:
    values = array.numpy()
    values[rows] = value
    array.assign(values)


def _compile(geoms: np.ndarray, size: np.ndarray) -> _CompiledField:
    """Compile a field of this size in MuJoCo; of its heights only the highest and the lowest matter."""
    spec = mujoco.MjSpec()
    spec.add_hfield(name="field", nrow=2, ncol=2, size=[float(s) for s in size], userdata=[0.0, 1.0, 0.0, 1.0])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="field")
    made = spec.compile()
    box = made.geom_aabb.reshape(-1, 2, 3)[0].copy()
    return _CompiledField(geoms, made.geom_size[0].copy(), box, float(made.geom_rbound[0]))
