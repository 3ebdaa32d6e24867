# SPDX-License-Identifier: Apache-2.0
"""Term table: write docs/terms.md, every term with its formula and the fields that it reads, from its source.

python tools/documentation/term_table.py [--output docs/terms.md]
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
import textwrap
from pathlib import Path
from types import ModuleType, SimpleNamespace

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.mdp import (
    actions,
    commands,
    contact,
    curriculums,
    events,
    feet,
    imu,
    inverse_kinematics,
    motion,
    objects,
    observations,
    obstacles,
    randomization_bodies,
    randomization_cameras,
    randomization_encoder,
    randomization_joints,
    randomization_scene,
    randomization_shapes,
    rewards,
    scan,
    terminations,
    terrain,
    tracking,
    walking,
)
from stripe_kernels.term_info import observation_size

Modules = tuple[ModuleType | SimpleNamespace, ...]

KINDS: dict[str, Modules] = {
    "Observations": (observations,),
    "Rewards": (rewards, tracking, walking),
    "Terminations": (terminations,),
    "Events": (events,),
    "Commands": (commands,),
    "Actions": (actions,),
}
"""Modules of the terms that work on one environment, by kind."""
CURRICULUMS: dict[str, Modules] = {"Curriculums": (curriculums,)}
"""Terms that one thread runs for all environments."""
OBJECTS: dict[str, Modules] = {
    "Observations: objects": (objects.observations,),
    "Rewards: objects": (objects.rewards,),
    "Terminations: objects": (objects.terminations,),
    "Events: objects": (objects.events,),
}
"""Terms about the objects of a pool."""
RAYS: dict[str, Modules] = {"Observations: height scan": (scan,)}
"""Terms about the hits of a sensor's rays."""


def part(module: ModuleType, *names: str) -> SimpleNamespace:
    """Some terms of a module, in place of the module."""
    return SimpleNamespace(__all__=names, **{n: getattr(module, n) for n in names})


def observations_of(module: ModuleType) -> SimpleNamespace:
    """Observations of a module that has other terms too."""
    return part(module, *(n for n in module.__all__ if observation_size(getattr(module, n)) is not None))


OBSTACLES: dict[str, Modules] = {
    "Observations: obstacles": (observations_of(obstacles),),
    "Terminations: obstacles": (part(obstacles, "obstacle_too_close"),),
}
"""Terms of docs/specifications.md about collider slots."""
CONTACTS: dict[str, Modules] = {
    "Observations: contacts and IMUs": (observations_of(contact), imu),
    "Rewards: contacts": (part(contact, "undesired_contacts", "desired_contacts", "contact_forces"), feet),
    "Terminations: contacts": (part(contact, "illegal_contact"),),
}
"""Terms of docs/sensors.md."""
RANDOMIZATION: dict[str, Modules] = {
    "Events: randomisation of the model": (
        randomization_bodies,
        randomization_joints,
        part(randomization_encoder, "randomize_encoder_bias"),
        randomization_shapes,
        randomization_scene,
    ),
    "Events: randomisation of cameras": (randomization_cameras,),
    "Observations: joint encoders": (part(randomization_encoder, "joint_pos_biased", "joint_pos_rel_biased"),),
    "Actions: joint encoders": (part(randomization_encoder, "apply_joint_position_biased"),),
}
"""Terms of docs/randomization.md."""
GROUND: dict[str, Modules] = {
    "Terminations: terrain": (part(terrain, "terrain_out_of_bounds", "root_height_over_ground_below_minimum"),),
    "Events: terrain": (part(terrain, "reset_root_state_from_terrain", "reset_root_state_uniform_on_terrain"),),
    "Curriculums: terrain": (part(terrain, "terrain_levels_vel", "terrain_levels_survival"),),
    "Commands: terrain": (part(terrain, "resample_terrain_based_pose_2d"),),
}
"""Terms of docs/terrain.md."""
MOTIONS: dict[str, Modules] = {
    "Observations: motion tracking": (observations_of(motion),),
    "Rewards: motion tracking": (part(motion, *(n for n in motion.__all__ if n.endswith("_error_exp"))),),
    "Terminations: motion tracking": (
        part(motion, *(n for n in motion.__all__ if n.startswith("bad_")), "motion_finished"),
    ),
    "Metrics: motion tracking": (part(motion, *(n for n in motion.__all__ if n.endswith("_error"))),),
    "Commands: motion tracking": (part(motion, "resample_motion", "update_motion"),),
}
"""Terms of docs/motions.md."""
BODIES: dict[str, Modules] = {"Actions: inverse kinematics": (inverse_kinematics,)}
"""Terms that read Jacobians as well as the state."""
EXTRA_COLUMNS = {"Observations": "values"} | dict.fromkeys(("Events", "Curriculums", "Commands", "Actions"), "writes")
"""Additional column of the tables, by the first word of a kind."""
GIVEN = {"env", "rng", "out", "action", "processed", "step", "memory", "peak", "return"}
"""Arguments that the managers pass, which are not parameters of a term."""
COUNTS = {
    "joint_ids": "a joint",
    "body_ids": "a body",
    "ray_ids": "a ray",
    "direction_ids": "a direction",
    "num_slots": "a slot",
    "num_actions": "an action",
    "num_command": "a number",
    "num_objects": "an object",
}


def is_struct(annotation: object) -> bool:
    """Whether an annotation is a Warp struct."""
    return getattr(annotation, "cls", None) is not None


def accesses(function: wp.Function) -> tuple[set[str], set[str]]:
    """Fields of structs that a function and the functions it calls read and write: ``parameter.field``."""
    source = textwrap.dedent(inspect.getsource(function.func))
    scope = function.func.__globals__
    structs = {k for k, t in function.func.__annotations__.items() if is_struct(t)}
    reads: set[str] = set()
    writes: set[str] = set()
    tree = ast.parse(source)
    stored = [n.value for n in ast.walk(tree) if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store)]
    measured = [n.value for n in ast.walk(tree) if isinstance(n, ast.Attribute) and n.attr == "shape"]
    for node in ast.walk(tree):
        if any(node is target for target in measured):  # its shape is read, not its values
            continue
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in structs:
            found = writes if any(node is target for target in stored) else reads
            found.add(f"{node.value.id}.{node.attr}")
        if isinstance(node, ast.Call):
            called = resolve(node.func, scope)
            if isinstance(called, wp.Function) and hasattr(called.func, "__code__"):
                names = dict(zip(inspect.signature(called.func).parameters, node.args))
                for inner, outer in zip(accesses(called), (reads, writes)):
                    for access in inner:
                        parameter, field = access.split(".")
                        passed = names.get(parameter)
                        if isinstance(passed, ast.Name):
                            outer.add(f"{passed.id}.{field}")
    return reads, writes


def resolve(node: ast.expr, scope: dict[str, object]) -> object:
    """Value of a name or a dotted name in a function's source."""
    if isinstance(node, ast.Name):
        return scope.get(node.id)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id != "wp":
        return getattr(scope.get(node.value.id), node.attr, None)
    return None


def section(function: wp.Function, head: str) -> str:
    """The paragraph of a docstring that begins with ``head:``, on one line."""
    doc = inspect.getdoc(function.func) or ""
    for paragraph in doc.split("\n\n"):
        if paragraph.startswith(f"{head}: "):
            return " ".join(paragraph[len(head) + 2 :].split()).rstrip(".")
    raise ValueError(f"the docstring of {function.key} has no paragraph 'Formula: ...' or 'Source: ...'")


def code(names: set[str]) -> str:
    """Names as code, sorted."""
    return ", ".join(f"`{n}`" for n in sorted(names))


def size(function: wp.Function) -> str:
    """Number of values that an observation writes."""
    rule = observation_size(function)
    if rule is None:
        raise ValueError(f"{function.key} has no size: put @writes(...) of stripe_kernels.term_info above it")
    if isinstance(rule, int):
        return str(rule)
    fixed = rule(dict.fromkeys(COUNTS, 0))
    if fixed:
        return str(fixed)
    return next(f"{n} {what}" for key, what in COUNTS.items() if (n := rule(dict.fromkeys(COUNTS, 0) | {key: 1})))


def extra_column(kind: str) -> str | None:
    """The column that tables of some kinds have beside the common ones."""
    return EXTRA_COLUMNS.get(kind.split(":")[0])


def row(kind: str, function: wp.Function) -> str:
    """Row of a term in the table of its kind."""
    reads, writes = accesses(function)
    parameters = {k for k, t in function.func.__annotations__.items() if k not in GIVEN and not is_struct(t)}
    summary = (inspect.getdoc(function.func) or "").split("\n\n")[0].replace("\n", " ")
    cells = [f"`{function.func.__name__}`", summary, section(function, "Formula"), code(reads), code(parameters)]
    column = extra_column(kind)
    if column is not None:
        cells.append(size(function) if column == "values" else code(writes))
    cells.append(section(function, "Source"))
    return "| " + " | ".join(re.sub(r"``", "`", c).replace("|", "\\|") for c in cells) + " |"


def tables(kinds: dict[str, Modules]) -> list[str]:
    """A section for each kind, with a row for each of its terms."""
    lines = []
    for kind, modules in kinds.items():
        column = extra_column(kind)
        head = ["name", "description", "formula", "reads", "parameters", *([column] if column else []), "source"]
        lines += ["", f"## {kind}", "", "| " + " | ".join(head) + " |", "| --- " * len(head) + "|"]
        for module in modules:
            functions = [f for n, f in vars(module).items() if n in module.__all__ and isinstance(f, wp.Function)]
            lines += [row(kind, f) for f in functions]
    return lines


INTRODUCTION = Path(__file__).with_name("term_introduction.md")
"""The text above the tables."""


def contents() -> list[str]:
    """Links to the sections, a line for each kind of term."""
    others = CURRICULUMS | OBJECTS | RAYS | OBSTACLES | CONTACTS | RANDOMIZATION | GROUND | MOTIONS | BODIES
    by_kind: dict[str, list[str]] = {}
    for title in [*KINDS, *others]:
        kind, _, subject = title.partition(": ")
        anchor = title.lower().replace(":", "").replace(" ", "-")
        by_kind.setdefault(kind, []).append(f"[{subject or 'general'}](#{anchor})")
    return ["", "| kind | sections |", "|---|---|", *(f"| {k.lower()} | {', '.join(v)} |" for k, v in by_kind.items())]


def page() -> str:
    """The whole page."""
    lines = [*INTRODUCTION.read_text(encoding="utf-8").splitlines(), *contents()]
    lines += tables(KINDS)
    lines += ["", "Configs of commands and actions use these functions as follows.", ""]
    lines += ["| command | when a new command is due | every step | values |", "| --- | --- | --- | ---: |"]
    for name, command in mdp.COMMANDS.items():
        update = f"`{command.update.func.__name__}`" if command.update else ""
        lines.append(f"| `{name}` | `{command.resample.func.__name__}` | {update} | {command.size or '2 a joint'} |")
    lines += ["", "| action | every step | before each physics step | at the start of an episode |", "| --- " * 4 + "|"]
    for name, action in mdp.ACTIONS.items():
        reset = f"`{action.reset.func.__name__}`" if action.reset else ""
        lines.append(f"| `{name}` | `{action.process.func.__name__}` | `{action.apply.func.__name__}` | {reset} |")
    lines += tables(CURRICULUMS | OBJECTS | RAYS | OBSTACLES | CONTACTS | RANDOMIZATION | GROUND | MOTIONS | BODIES)
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[2] / "docs" / "terms.md")
    parser.parse_args(arguments).output.write_text(page())


if __name__ == "__main__":
    main(sys.argv[1:])
