# SPDX-License-Identifier: Apache-2.0
"""A robot's file as source code of a task: spawner, start, drives, and the terms that a floating base needs."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from .user_error import UserError

if TYPE_CHECKING:
    import newton

    from stripe_newton.usd import JointRow

__all__ = ["is_alone", "robot_values"]

_SPAWNERS = {"urdf": "UrdfFileCfg", "mjcf": "MjcfFileCfg", "usd": "UsdFileCfg"}
_SHARE = "# To share the package, copy the file with its meshes into it: Path(__file__).parent / NAME."
_INDENT = " " * 12
_FLOATING = {
    "FLOATING_OBSERVATIONS": [
        "base_lin_vel=ObservationTermCfg(func=mdp.base_lin_vel),",
        "base_ang_vel=ObservationTermCfg(func=mdp.base_ang_vel, scale=0.25),",
        "projected_gravity=ObservationTermCfg(func=mdp.projected_gravity),",
    ],
    "FLOATING_REWARDS": ["upright=RewardTermCfg(func=mdp.flat_orientation_l2, weight=-1.0),"],
    "FLOATING_TERMINATIONS": ['fallen=TerminationTermCfg(func=mdp.bad_orientation, params={"limit_angle": 1.0}),'],
    "FLOATING_EVENTS": [
        "start=EventTermCfg(",
        "    func=mdp.reset_root_state_uniform,",
        '    mode="reset",',
        '    params={"pose_range": {"yaw": (-3.14, 3.14)}, "velocity_range": {}},',
        "),",
        "push=EventTermCfg(",
        "    func=mdp.push_by_setting_velocity,",
        '    mode="interval",',
        "    interval_range_s=(1.0, 3.0),",
        '    params={"velocity_range": {"x": (-0.3, 0.3), "y": (-0.3, 0.3)}},',
        "),",
    ],
}
"""Lines of the task for a robot whose base floats."""


def robot_values(file: Path, floating: bool | None = None) -> dict[str, str]:
    """Values for the template of a robot, read from its file, by placeholder.

    Args:
        file: The file.
        floating: Whether the base floats, for a URDF file that does not say; None holds it.

    Raises:
        UserError: if the file is no robot, or cannot be simulated.
    """
    from .compile_log import CompileLog  # here, as the templates without a robot need no Warp; likewise below

    log = CompileLog.install()
    from stripe_newton.robot_files import RobotFileError, file_kind, inspect_robot_file
    from stripe_newton.usd import StageError, inspect_stage

    if not file.is_file():
        raise UserError(f"--robot {file}: does not exist")
    kind = file_kind(file)
    if kind.name not in _SPAWNERS:
        raise UserError(f"--robot {file} {kind.description}")
    try:
        report = inspect_stage(file) if kind.name == "usd" else inspect_robot_file(file)
    except (RobotFileError, StageError) as error:
        raise UserError(str(error)) from None
    if len(report.articulations) != 1:
        raise UserError(f"--robot {file}: has {len(report.articulations)} articulations, must be one robot")
    joints = [joint for joint in report.joints if joint.dof >= 0]
    if not joints:
        raise UserError(f"--robot {file}: has no joint that moves")
    undecided = any("fix_base" in row[2] for row in report.ignored)
    if floating is None or not undecided:
        floating = report.articulations[0].base == "floating"
    path, keyframe = file.resolve(), _keyframe(kind.name, file)
    start = {} if keyframe else _start(joints, floating)
    weight = 9.81 * sum(body.mass for body in report.bodies)
    values = {
        "FILE": str(path),
        "PLACE": f"{_SHARE}\nFILE = Path({json.dumps(str(path))})",
        "ROBOT": path.stem,
        "SPAWNER": _SPAWNERS[kind.name],
        "SPAWN": _spawn(kind.name, floating, keyframe),
        "INIT_STATE": _init_state(_height(kind.name, path, floating, keyframe, start), start, keyframe),
        "BASE": "floats" if floating else "is held",
        "UNDECIDED": " (the file does not say; --floating lets it float)" if undecided and not floating else "",
    }
    log.finish()
    values |= _drives(joints, weight) | _driven(joints)
    if is_alone(kind.name, path):  # the package gets a copy
        values |= {"COPY": path.name, "PLACE": f'FILE = Path(__file__).parent / "{path.name}"'}
    indents = {"FLOATING_OBSERVATIONS": _INDENT}
    for name, lines in _FLOATING.items():
        indent = indents.get(name, " " * 8)
        values[name] = "".join(f"{indent}{line}\n" for line in lines) if floating else ""
    return values


def is_alone(kind: str, file: Path) -> bool:
    """Whether a robot's file needs no other files, such as meshes."""
    if kind == "usd":
        from pxr import UsdUtils

        layers, assets, missing = UsdUtils.ComputeAllDependencies(str(file))
        return len(layers) == 1 and not assets and not missing
    return not any(name.startswith("file") for part in ElementTree.parse(file).iter() for name in part.attrib)


def _keyframe(kind: str, file: Path) -> str | None:
    """Name of an MJCF file's first keyframe, which is usually the pose to stand in."""
    if kind != "mjcf":
        return None
    from stripe_newton.robot_files import compile_mjcf

    model = compile_mjcf(file)
    return str(model.key(0).name) if model.nkey and model.key(0).name else None


def _spawn(kind: str, floating: bool, keyframe: str | None) -> str:
    if kind == "usd":
        return "UsdFileCfg(usd_path=str(FILE))"
    if kind == "mjcf":
        return f"MjcfFileCfg(asset_path=str(FILE){f', keyframe={json.dumps(keyframe)}' if keyframe else ''})"
    return f"UrdfFileCfg(asset_path=str(FILE), fix_base={not floating})"


def _name(joint: JointRow) -> str:
    return joint.path.rpartition("/")[2]


def _start(joints: list[JointRow], floating: bool) -> dict[str, float]:
    """Positions of joints that cannot be at zero: the middle of their range.

    Such a joint of a robot that stands is a knee. The hip above it turns back by half, which puts the foot below it.
    """
    knees = [j for j in joints if math.isfinite(j.lower + j.upper) and not j.lower <= 0.0 <= j.upper]
    middles = {j.child: 0.5 * (j.lower + j.upper) for j in knees}
    start = {j.child: middles[j.child] for j in knees}
    for knee in knees if floating else []:
        back = -0.5 * middles[knee.child]
        hips = [j for j in joints if j.child == knee.parent and j.child not in middles and j.lower <= back <= j.upper]
        start |= {hip.child: back for hip in hips if _turns_alike(hip, knee)}
    return {_name(j): round(start[j.child], 3) for j in joints if j.child in start}


def _turns_alike(first: JointRow, second: JointRow) -> bool:
    """Whether two joints turn about the same axis, if their frames are alike."""
    if first.axis is None or second.axis is None or not (first.angular and second.angular):
        return False
    return sum(a * b for a, b in zip(first.axis, second.axis, strict=True)) > 0.99


def _init_state(height: float, start: dict[str, float], keyframe: str | None) -> str:
    """Source code of the start; joints that are not in it start at zero, or as the keyframe says."""
    lines = [f"pos=(0.0, 0.0, {height:.3g}),  # m"] if height else []
    if keyframe:
        lines.append(f"joint_pos=None,  # as in the keyframe '{keyframe}'")
    elif start:
        lines.append(f"joint_pos={_source(start, 8)},  # rad, m; the middle of ranges without zero, and hips to match")
    inside = "".join(f"        {line}\n" for line in lines)
    return f"    init_state=ArticulationCfg.InitialStateCfg(\n{inside}    ),\n" if lines else ""


def _drives(joints: list[JointRow], weight: float) -> dict[str, str]:
    """Drives of the joints: those of the file, or for a file without any a guess from efforts or from the weight."""
    if any(joint.stiffness > 0.0 for joint in joints):
        return {"DRIVES": "", "DRIVES_WHY": "The drives are those of the file.", "ACTUATORS_IMPORT": ""}
    guess = 0.25 * weight  # N, or N m: a quarter of the weight, at a metre
    efforts = {_name(j): j.max_force if 0.0 < j.max_force < 1.0e4 else guess for j in joints}
    stiffness = {_name(j): _two_digits(efforts[_name(j)] / (0.5 if j.angular else 0.1)) for j in joints}
    damping = {name: _two_digits(0.05 * value) for name, value in stiffness.items()}
    lines = [
        "    actuators={",
        '        "all": ImplicitActuatorCfg(',
        '            joint_names_expr=[".*"],',
        f"            stiffness={_joined(stiffness)},  # N m/rad, or N/m",
        f"            damping={_joined(damping)},  # N m s/rad, or N s/m",
        "        )",
        "    },",
        "",
    ]
    why = "The file has no gains: these are a guess from its efforts or its weight. Set those of your robot."
    imported = "from stripe_newton.actuators import ImplicitActuatorCfg\n"
    return {"DRIVES": "\n".join(lines), "DRIVES_WHY": why, "ACTUATORS_IMPORT": imported}


def _driven(joints: list[JointRow]) -> dict[str, str]:
    """The joints that actions move, and a text about the others: a file with gains may have joints without, such as
    springs."""
    passive = [_name(j) for j in joints if not (j.stiffness > 0.0 or j.damping > 0.0)]
    if not passive or not any(joint.stiffness > 0.0 for joint in joints):
        return {"JOINTS": '".*"', "PASSIVE": ""}
    free = f"; {', '.join(passive)} of its joints {'have' if len(passive) > 1 else 'has'} no drive and no action"
    return {"JOINTS": json.dumps(f"(?!{'|'.join(f'{re.escape(name)}$' for name in passive)}).*"), "PASSIVE": free}


def _joined(values: dict[str, float]) -> str:
    """One number if all are the same, else a dict."""
    return repr(next(iter(values.values()))) if len(set(values.values())) == 1 else _source(values, 12)


def _source(values: dict[str, float], indent: int) -> str:
    """A dict as source code, an item a line if there are several."""
    items = [f'"{name}": {value}' for name, value in values.items()]
    if len(items) == 1:
        return f"{{{items[0]}}}"
    inside, end = "\n" + " " * (indent + 4), "\n" + " " * indent
    return "{" + inside + f",{inside}".join(items) + "," + end + "}"


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def _height(kind: str, file: Path, floating: bool, keyframe: str | None, start: dict[str, float]) -> float:
    """Height of the root's origin at which the lowest collider is a centimetre above the ground [m].

    A robot that is held stays where its file has it if nothing of it is below the ground.
    """
    import newton

    from stripe_newton.forward_only import leave_out_gradients
    from stripe_newton.robot_files import import_robot_file

    leave_out_gradients()  # as the warm-up compiles kernels, or they would be compiled again, and for longer
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    if kind == "usd":
        builder.add_usd(str(file))
    else:
        import_robot_file(builder, kind, file, {"floating": floating} if kind == "urdf" else {"keyframe": keyframe})
    root = builder.joint_q[2] if floating and builder.joint_q else 0.0
    for label, first in zip(builder.joint_label, builder.joint_q_start, strict=True):
        name = label.rpartition("/")[2]
        if name in start:
            builder.joint_q[first] = start[name]
    model = builder.finalize(device="cpu")
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    lowest = _lowest(model, state)
    return 0.0 if not floating and lowest >= 0.0 else float(root) - lowest + 0.01


def _lowest(model: newton.Model, state: newton.State) -> float:
    """Lowest point of the colliders' bounds of a model [m]."""
    import numpy as np
    import warp as wp

    bodies = state.body_q.numpy()
    local, owners = model.shape_transform.numpy(), model.shape_body.numpy()
    lower, upper = model.shape_collision_aabb_lower.numpy(), model.shape_collision_aabb_upper.numpy()
    found = []
    for shape, body in enumerate(owners):
        if body < 0:
            continue
        pose = wp.transform(*bodies[body].tolist()) * wp.transform(*local[shape].tolist())
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        points = lower[shape] + corners * (upper[shape] - lower[shape])
        found += [float(wp.transform_point(pose, wp.vec3(*p.tolist()))[2]) for p in points]
    return min(found, default=0.0)
