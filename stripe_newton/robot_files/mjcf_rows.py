# SPDX-License-Identifier: Apache-2.0
"""MJCF rows: what of MuJoCo's model of a file Newton's importer leaves out, or reads as something else."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import mujoco
import newton
import numpy as np

from .mjcf import MjcfStart
from .mjcf_constants import constant_rows
from .urdf_checks import Row

__all__ = ["mjcf_rows"]

_RELATIVE = 1e-3
"""Differences below this share are those of single precision."""
_UNLIMITED = 1e9
"""Newton writes 1e10 for a limit that is not there."""


def mjcf_rows(
    builder: newton.ModelBuilder, start: MjcfStart, model: mujoco.MjModel, options: dict[str, Any]
) -> list[Row]:
    """Compare what was added to a builder with the model that MuJoCo makes of the same file.

    Args:
        builder: The builder, completed.
        start: Counts before the file was added.
        model: MuJoCo's model of the file.
        options: Options of the importer; what they change on purpose is not compared.
    """
    rows = [
        *_unused(model, options),
        *_integrator(builder, model),
        *_counts(builder, start, model, options),
        *_shortened_tendons(builder, start, model),
        *_filtered_collisions(model),
        *constant_rows(builder, start.shape, model),
    ]
    if options.get("scale", 1.0) == 1.0:
        rows += _joint_differences(builder, start, model)
        if not options.get("collapse_fixed_joints"):
            rows += _body_differences(builder, start, model)
    return rows


def _unused(model: mujoco.MjModel, options: dict[str, Any]) -> Iterator[Row]:
    for count, what, why in (
        (model.nsensor, "sensors", "a scene's config adds sensors"),
        (model.ncam, "cameras", "a scene's config adds cameras"),
        (model.nlight, "lights", "a scene's config adds lights"),
        (model.nskin, "skins", "only rigid geometry is drawn"),
        (model.nplugin, "plugins", "plugins of MuJoCo are not loaded"),
        (model.nmocap, "mocap bodies", "they are read as bodies that stand still"),
    ):
        if count:
            one = what.replace("bodies", "body").removesuffix("s")
            yield f"{count} {one if count == 1 else what}", "not read", why
    if model.nkey and options.get("keyframe") is None:
        names = ", ".join(model.key(k).name or f"number {k}" for k in range(model.nkey))
        yield (
            "keyframes",
            "not used",
            f"the pose is the file's; MjcfFileCfg(keyframe=...) takes one of {names}",
        )
    yield "option", f"timestep {model.opt.timestep:g}", "the step is SimulationCfg.dt"
    if not np.allclose(model.opt.gravity, (0.0, 0.0, -9.81), atol=1e-6):
        yield "option", f"gravity {_vector(model.opt.gravity)}", "gravity is SimulationCfg.gravity"
    if model.opt.noslip_iterations:
        yield (
            "option",
            "noslip_iterations",
            "not read: MuJoCo Warp has none; solimp makes contacts harder",
        )
    for name in options.get("ignore_names", ()):
        for kind in (mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_BODY):
            if mujoco.mj_name2id(model, kind, name) >= 0:
                yield name, "left out", "it is in ignore_names: the scene has a ground of its own"


def _integrator(builder: newton.ModelBuilder, model: mujoco.MjModel) -> Iterator[Row]:
    """The integrator where the file's is not the one that Newton reads: a file that names none means Euler."""
    attribute = builder.custom_attributes.get("mujoco:integrator")
    if attribute is None:  # the scene's solver is not MuJoCo's
        return
    values = attribute.values or {}
    here, there = (mujoco.mjtIntegrator(v) for v in (int(values.get(0, attribute.default)), model.opt.integrator))
    if here != there:
        names = [kind.name.removeprefix("mjINT_").lower() for kind in (here, there)]
        why = f"MuJoCo reads {names[1]}; MuJoCoSolverCfg(integrator=...) chooses one for the scene"
        yield "option", f"integrator {names[0]}", why


def _counts(
    builder: newton.ModelBuilder, start: MjcfStart, model: mujoco.MjModel, options: dict[str, Any]
) -> Iterator[Row]:
    read = options.get("actuators", True)
    if not read and model.nu:
        yield f"{model.nu} actuators", "not read", "MjcfFileCfg(actuators=False) leaves the joints to the config"
    for what, here, there in (
        ("actuators", start.actuators_since(builder), model.nu if read else 0),
        ("equality constraints", start.equalities_since(builder), model.neq),
        ("tendons", start.tendons_since(builder), model.ntendon),
    ):
        if here != there:
            yield what, f"{here} of {there} read", "Newton's importer has no counterpart for the others"


def _shortened_tendons(builder: newton.ModelBuilder, start: MjcfStart, model: mujoco.MjModel) -> Iterator[Row]:
    """Joints of fixed tendons that Newton's solver leaves out, as it takes none that it merged with another."""
    merged = {
        name
        for joint in range(start.joint, builder.joint_count)
        if builder.joint_type[joint] == newton.JointType.D6
        for name in builder.joint_label[joint].rpartition("/")[2].split("+")
    }
    for tendon in range(model.ntendon):
        wraps = range(int(model.tendon_adr[tendon]), int(model.tendon_adr[tendon] + model.tendon_num[tendon]))
        joints = [w for w in wraps if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT]
        names = [model.joint(int(model.wrap_objid[w])).name for w in joints]
        if lost := [name for name in names if name.replace("-", "_") in merged]:
            what = "the tendon and what acts on it" if lost == names else f"{', '.join(lost)} of the tendon"
            why = f"{what} left out: joints that share a body with others are no part of a tendon of Newton's solver"
            yield model.tendon(tendon).name or f"tendon {tendon}", "tendon", f"{why}; give each a body of its own"


def _filtered_collisions(model: mujoco.MjModel) -> Iterator[Row]:
    """Bodies that MuJoCo lets collide with the parent that their joint is on, as that one is fixed to the world."""
    kinds = [(0, 0)] * model.nbody
    for geom, body in enumerate(model.geom_bodyid):
        contype, conaffinity = kinds[body]
        kinds[body] = contype | int(model.geom_contype[geom]), conaffinity | int(model.geom_conaffinity[geom])
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent == 0 or model.body_weldid[parent] != 0 or model.body_weldid[body] == 0:
            continue
        one, two = kinds[parent], kinds[body]
        if one[0] & two[1] or two[0] & one[1]:
            why = f"not with its parent '{model.body(parent).name}': MuJoCo would let them, as that one is fixed"
            yield model.body(body).name or f"body {body}", "collisions", why


def _joint_differences(builder: newton.ModelBuilder, start: MjcfStart, model: mujoco.MjModel) -> Iterator[Row]:
    own = _dofs_by_name(builder, start)
    for joint in range(model.njnt):
        name = model.joint(joint).name
        dof = own.get(name.replace("-", "_"))
        # As numbers: a number of NumPy is in no tuple of these enumerators.
        if int(model.jnt_type[joint]) in (int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)):
            yield from _lost_of_joint(model, joint)
            continue
        if dof is None:
            continue
        at = model.jnt_dofadr[joint]
        limits = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        for what, here, there in (
            ("damping", float(builder.joint_damping[dof]), model.dof_damping[at]),
            ("armature", float(builder.joint_armature[dof]), model.dof_armature[at]),
            ("frictionloss", float(builder.joint_friction[dof]), model.dof_frictionloss[at]),
            ("stiffness", float(builder.joint_stiffness[dof]), model.jnt_stiffness[joint]),
            ("lower limit", _limit(builder.joint_limit_lower[dof]), limits[0]),
            ("upper limit", _limit(builder.joint_limit_upper[dof]), limits[1]),
        ):
            if not (here == there or np.isclose(here, there, rtol=_RELATIVE, atol=1e-6)):
                yield name, what, f"MuJoCo reads {there:.4g}, Newton {here:.4g}"


def _limit(value: float) -> float:
    return float(np.copysign(np.inf, value)) if abs(value) >= _UNLIMITED else float(value)


def _lost_of_joint(model: mujoco.MjModel, joint: int) -> Iterator[Row]:
    """Rows of what Newton's solver leaves out of free joints and ball joints."""
    name = model.joint(joint).name or f"joint of {model.body(int(model.jnt_bodyid[joint])).name}"
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
        if model.jnt_limited[joint]:
            yield name, "range", "not read: ball joints have no limits"
        return
    at = model.jnt_dofadr[joint]
    for what in ("damping", "armature", "frictionloss"):
        if value := float(getattr(model, f"dof_{what}")[at]):
            yield name, what, f"{value:.4g} in the file is not read: free joints have none"


def _dofs_by_name(builder: newton.ModelBuilder, start: MjcfStart) -> dict[str, int]:
    """Degree of freedom of each joint of the file by its name."""
    found: dict[str, int] = {}
    for joint in range(start.joint, builder.joint_count):
        names = builder.joint_label[joint].rpartition("/")[2].split("+")
        if len(names) == sum(builder.joint_dof_dim[joint]):
            found.update((name, builder.joint_qd_start[joint] + k) for k, name in enumerate(names))
    return found


def _body_differences(builder: newton.ModelBuilder, start: MjcfStart, model: mujoco.MjModel) -> Iterator[Row]:
    own = {builder.body_label[b].rpartition("/")[2]: b for b in range(start.body, builder.body_count)}
    for body in range(1, model.nbody):
        name = model.body(body).name
        here = own.get(name.replace("-", "_"))
        if not name or here is None or model.body_mass[body] < 1e-9:  # without mass it has no centre of mass
            continue
        mass = float(builder.body_mass[here])
        if not np.isclose(mass, model.body_mass[body], rtol=_RELATIVE, atol=1e-9):
            yield name, "mass", f"MuJoCo reads {model.body_mass[body]:.4g} kg, Newton {mass:.4g}"
            continue  # the inertia follows from it
        if not np.allclose(builder.body_com[here], model.body_ipos[body], rtol=_RELATIVE, atol=1e-5):
            yield (
                name,
                "centre of mass",
                f"MuJoCo reads {_vector(model.body_ipos[body])} m, Newton {_vector(builder.body_com[here])}",
            )
        moments = np.sort(np.linalg.eigvalsh(np.array(builder.body_inertia[here], dtype=float).reshape(3, 3)))
        expected = np.sort(model.body_inertia[body])
        if not np.allclose(moments, expected, rtol=10.0 * _RELATIVE, atol=1e-2 * expected.max() + 1e-12):
            yield (
                name,
                "inertia",
                f"MuJoCo reads the moments {_vector(expected)} kg m^2, Newton {_vector(moments)}",
            )


def _vector(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{float(v):.3g}" for v in values) + ")"
