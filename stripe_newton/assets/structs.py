# SPDX-License-Identifier: Apache-2.0
"""An asset's state as the Warp struct that terms read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
import warp as wp

import stripe_kernels.data as kernels

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

    from .layout import Layout

__all__ = ["make_struct"]

_MODEL = {
    "joint_stiffness": "joint_target_ke",
    "joint_damping": "joint_target_kd",
    "joint_pos_lower": "joint_limit_lower",
    "joint_pos_upper": "joint_limit_upper",
    "joint_vel_limit": "joint_velocity_limit",
    "joint_effort_limit": "joint_effort_limit",
}


def make_struct(sim: Simulation, layout: Layout, data: Any, soft: float) -> tuple[Any, dict[str, str]]:
    """The struct, whose arrays are views of the simulation's, and why some of its fields are not there.

    Returns:
        The ``ArticulationData`` struct, and for each field that may not be read the reason and the remedy.
    """
    struct, unavailable = kernels.ArticulationData(), {}
    count, bodies = sim.num_envs, layout.body_slice
    coords, dofs = slice(layout.coords.start, layout.coords.stop), slice(layout.dofs.start, layout.dofs.stop)
    if not isinstance(bodies, slice):
        raise RuntimeError(f"'{layout.path}': its bodies are not contiguous in the model, terms cannot read them")

    def view(array: wp.array | None, rows: slice, dtype: Any) -> wp.array:
        return wp.from_torch(sim.per_env(array)[:, rows], dtype=dtype) if array is not None and array.size else None

    def rows(tensor: torch.Tensor, dtype: Any) -> wp.array:
        return wp.from_torch(tensor, dtype=dtype)

    struct.root_pose = rows(data.root_pose_w, wp.transform)
    struct.root_vel = rows(data.root_vel_w, wp.spatial_vector)
    struct.default_root_pose = rows(data.default_root_state[:, :7], wp.transform)
    struct.default_root_vel = rows(data.default_root_state[:, 7:], wp.spatial_vector)
    struct.body_pose = view(sim.state.body_q, bodies, wp.transform)
    struct.body_vel = view(sim.state.body_qd, bodies, wp.spatial_vector)
    for name, attribute in (("body_acc", "body_qdd"), ("body_parent_wrench", "body_parent_f")):
        array = getattr(sim.observables, attribute, None) if sim.observables is not None else None
        if array is None:
            unavailable[name] = f"not computed; set SimulationCfg(observables=('{attribute}',))"
        else:
            setattr(struct, name, view(array, bodies, wp.spatial_vector))
    if sim.external_wrench is None:
        unavailable["external_wrench"] = "not enabled; call sim.enable_external_wrench() first"
    else:
        struct.external_wrench = view(sim.external_wrench, bodies, wp.spatial_vector)
    if len(layout.joint_names):
        struct.joint_pos = view(sim.state.joint_q, coords, wp.float32)
        struct.joint_vel = view(sim.state.joint_qd, dofs, wp.float32)
        struct.previous_joint_vel = view(sim.previous_joint_qd, dofs, wp.float32)
        struct.default_joint_pos = rows(data.default_joint_pos, wp.float32)
        struct.default_joint_vel = rows(data.default_joint_vel, wp.float32)
        struct.joint_pos_target = view(sim.control.joint_target_q, coords, wp.float32)
        struct.joint_vel_target = view(sim.control.joint_target_qd, dofs, wp.float32)
        struct.joint_effort_target = view(sim.control.joint_act, dofs, wp.float32)
        struct.joint_other_effort = view(sim.control.joint_f, dofs, wp.float32)
        for name, attribute in _MODEL.items():
            setattr(struct, name, view(getattr(sim.model, attribute), dofs, wp.float32))
        effort = getattr(sim.observables, "qfrc_actuator", None) if sim.observables is not None else None
        if effort is None:
            unavailable["joint_drive_effort"] = f"{type(sim.solver).__name__} does not report it, use MuJoCoSolverCfg"
        else:
            struct.joint_drive_effort = view(effort, dofs, wp.float32)
    else:
        empty = wp.zeros((count, 0), dtype=wp.float32, device=sim.device)
        for name in ("joint_pos", "joint_vel", "previous_joint_vel", "default_joint_pos", "default_joint_vel",
                     "joint_pos_target", "joint_vel_target", "joint_effort_target", "joint_drive_effort",
                     "joint_other_effort", *_MODEL):  # fmt: skip
            setattr(struct, name, empty)
    struct.soft_limit_factor, struct.physics_dt = soft, sim.physics_dt
    struct.env_origin = sim.env_origin
    struct.gravity_dir = wp.vec3(*data.GRAVITY_VEC_W[0].tolist())
    return struct, unavailable
