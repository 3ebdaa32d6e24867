# SPDX-License-Identifier: Apache-2.0
"""Support: what makes a model need MuJoCo Warp rather than the fused step."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

__all__ = ["why_slower", "why_unsupported"]

_MAX_DOFS = 64
_MOST_DOFS_ON_GPU = 40
"""Degrees of freedom beyond which MuJoCo Warp takes less time on a GPU. Up to 32 matrices lie in registers, a row in
each lane, and the fused step takes a ninth of MuJoCo Warp's time with 30; with 48 it takes 1.4 times as long."""
_MOST_ALONG = 2**15
"""Rows and columns of a height field, which the kernel numbers by two bytes."""
_PHYSICS = (
    "CONSTRAINT", "EQUALITY", "FRICTIONLOSS", "LIMIT", "SPRING", "DAMPER", "GRAVITY", "CLAMPCTRL",
    "ACTUATION", "EULERDAMP",
)  # fmt: skip
"""Parts of the physics that an option of MuJoCo can disable; contacts may be disabled, too."""


def why_unsupported(model: mujoco.MjModel) -> str:
    """Reason why the fused step cannot compute a model; empty if it can. Contacts are none: others can find them."""
    return next(_reasons(model), "")


def why_slower(num_dofs: int, is_cuda: bool) -> str:
    """Reason to leave a model to MuJoCo Warp though the fused step can compute it; empty if there is none."""
    if not is_cuda or num_dofs <= _MOST_DOFS_ON_GPU:
        return ""
    return f"with {num_dofs} degrees of freedom, more than {_MOST_DOFS_ON_GPU}, MuJoCo Warp is faster on a GPU"


def _reasons(model: mujoco.MjModel) -> Iterator[str]:
    opt = model.opt
    if not model.nv:
        yield "nothing in it can move"
    if model.nv > _MAX_DOFS:
        yield f"it has {model.nv} degrees of freedom, more than {_MAX_DOFS}"
    if int(opt.integrator) not in (mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICITFAST):
        yield f"its integrator is {mujoco.mjtIntegrator(opt.integrator).name}"
    if opt.solver != mujoco.mjtSolver.mjSOL_NEWTON:
        yield f"its solver is {mujoco.mjtSolver(opt.solver).name}"
    for name in _PHYSICS:
        if opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", 0)):
            yield f"its option 'disable {name.lower()}' is set"
    if opt.enableflags:
        yield "it enables an option such as sleeping or a contact override"
    if opt.density or opt.viscosity or np.any(opt.wind):
        yield "it has a medium"
    if opt.noslip_iterations:
        yield "it has noslip iterations"
    for count, what in (
        (model.nflex, "a flexible body"), (model.nplugin, "a plugin"),
        (int(np.any(model.body_gravcomp)) and int(np.any(model.jnt_actgravcomp)), "gravity compensation by actuators"),
    ):  # fmt: skip
        if count:
            yield f"it has {what}"
    if max(model.hfield_nrow.max(initial=0), model.hfield_ncol.max(initial=0)) > _MOST_ALONG:
        yield f"a height field has more than {_MOST_ALONG:,} rows or columns"
    yield from _joint_reasons(model)
    yield from _actuator_reasons(model)


def _joint_reasons(model: mujoco.MjModel) -> Iterator[str]:
    kinds = mujoco.mjtEq
    free, ball = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL
    for j in range(model.njnt):
        name = model.joint(j).name or j
        if int(model.jnt_type[j]) in (free, ball) and model.jnt_stiffness[j]:
            yield f"joint '{name}' is a spring of more than one degree of freedom"
        if model.jnt_type[j] == ball and j + 1 < model.njnt and model.jnt_bodyid[j + 1] == model.jnt_bodyid[j]:
            yield f"a joint follows the ball joint '{name}' in the same body"
    if np.any(model.jnt_stiffnesspoly) or np.any(model.dof_dampingpoly):
        yield "a joint has polynomial stiffness or damping"
    for e in range(model.neq):
        if int(model.eq_type[e]) not in (kinds.mjEQ_JOINT, kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            yield f"equality '{model.equality(e).name or e}' is of type {kinds(model.eq_type[e]).name}"


def _actuator_reasons(model: mujoco.MjModel) -> Iterator[str]:
    trn, gain, bias = mujoco.mjtTrn, mujoco.mjtGain, mujoco.mjtBias
    for u in range(model.nu):
        name = f"actuator '{model.actuator(u).name or u}'"
        if int(model.actuator_trntype[u]) not in (trn.mjTRN_JOINT, trn.mjTRN_TENDON):
            yield f"{name} acts on neither a joint nor a tendon"
        elif model.actuator_trntype[u] == trn.mjTRN_JOINT:
            joint = model.actuator_trnid[u, 0]
            if int(model.jnt_type[joint]) not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                yield f"{name} acts on a joint of more than one degree of freedom"
        if model.actuator_dyntype[u] != mujoco.mjtDyn.mjDYN_NONE:
            yield f"{name} has an activation"
        if int(model.actuator_gaintype[u]) not in (gain.mjGAIN_FIXED, gain.mjGAIN_AFFINE):
            yield f"{name} has a gain of type {gain(model.actuator_gaintype[u]).name}"
        if int(model.actuator_biastype[u]) not in (bias.mjBIAS_NONE, bias.mjBIAS_AFFINE):
            yield f"{name} has a bias of type {bias(model.actuator_biastype[u]).name}"
    if np.any(model.wrap_type != mujoco.mjtWrap.mjWRAP_JOINT):
        yield "it has a spatial tendon"
    if np.any(model.tendon_limited) or np.any(model.tendon_frictionloss) or np.any(model.tendon_stiffness):
        yield "a tendon has a limit, friction or stiffness"
    if np.any(model.tendon_damping) or np.any(model.tendon_armature):
        yield "a tendon has damping or armature"
