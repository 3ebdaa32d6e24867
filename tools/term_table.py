# SPDX-License-Identifier: Apache-2.0
"""Write docs/terms.md: every term with its formula and what it reads, from the functions themselves.

python tools/term_table.py [--output docs/terms.md]
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
import textwrap
from pathlib import Path
from typing import Any

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.mdp import actions, commands, events, observations, rewards, terminations, tracking

KINDS: dict[str, tuple[Any, ...]] = {
    "Observations": (observations,),
    "Rewards": (rewards, tracking),
    "Terminations": (terminations,),
    "Events": (events,),
    "Commands": (commands,),
    "Actions": (actions,),
}
PLUMBING = {"env", "rng", "out", "action", "processed", "return"}
COUNTS = {"joint_ids": "a joint", "body_ids": "a body", "num_actions": "an action", "num_command": "a number"}


def is_struct(annotation: Any) -> bool:
    return getattr(annotation, "cls", None) is not None


def accesses(function: wp.Function) -> tuple[set[str], set[str]]:
    """Fields of structs that a function, and what it calls, reads and writes: ``parameter.field``."""
    source = textwrap.dedent(inspect.getsource(function.func))
    scope = function.func.__globals__
    structs = {k for k, t in function.func.__annotations__.items() if is_struct(t)}
    reads: set[str] = set()
    writes: set[str] = set()
    tree = ast.parse(source)
    stored = [n.value for n in ast.walk(tree) if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store)]
    for node in ast.walk(tree):
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


def resolve(node: ast.expr, scope: dict[str, Any]) -> Any:
    """What a name or a dotted name in a function's source means."""
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
    return ", ".join(f"`{n}`" for n in sorted(names))


def size(name: str) -> str:
    """How many numbers an observation writes."""
    rule = mdp.OBSERVATION_SIZES[name]
    fixed = rule(dict.fromkeys(COUNTS, 0))
    if fixed:
        return str(fixed)
    return next(f"{n} {what}" for key, what in COUNTS.items() if (n := rule(dict.fromkeys(COUNTS, 0) | {key: 1})))


def row(kind: str, function: wp.Function) -> str:
    reads, writes = accesses(function)
    parameters = {k for k, t in function.func.__annotations__.items() if k not in PLUMBING and not is_struct(t)}
    summary = (inspect.getdoc(function.func) or "").split("\n\n")[0].replace("\n", " ")
    cells = [f"`{function.func.__name__}`", summary, section(function, "Formula"), code(reads), code(parameters)]
    if kind == "Observations":
        cells.append(size(function.func.__name__))
    if kind in ("Events", "Commands", "Actions"):
        cells.append(code(writes))
    cells.append(section(function, "Source"))
    return "| " + " | ".join(re.sub(r"``", "`", c).replace("|", "\\|") for c in cells) + " |"


def page() -> str:
    """The whole page."""
    lines = [
        "# Terms",
        "",
        "Every term that `stripe_kernels.mdp` has, as its docstring and its code say. `robot` is an articulation, a "
        "subscript `_b` means its root's frame, `U(range)` a uniform draw, `c` a command, `a` an action, `q`, `qd` and "
        "`tau` positions, velocities and efforts of joints, `*` a target. Linear velocities are those of the centre of "
        "mass. `python tools/term_table.py` writes this page; a test compares it.",
    ]
    for kind, modules in KINDS.items():
        extra = {"Observations": ["numbers"], "Events": ["writes"], "Commands": ["writes"], "Actions": ["writes"]}
        head = ["name", "what", "formula", "reads", "parameters", *extra.get(kind, []), "source"]
        lines += ["", f"## {kind}", "", "| " + " | ".join(head) + " |", "| --- " * len(head) + "|"]
        for module in modules:
            functions = [f for n, f in vars(module).items() if n in module.__all__ and isinstance(f, wp.Function)]
            lines += [row(kind, f) for f in functions]
    lines += ["", "The functions of commands and actions belong together as follows.", ""]
    lines += ["| command | new command | every step | numbers |", "| --- | --- | --- | ---: |"]
    for name, command in mdp.COMMANDS.items():
        update = f"`{command.update.func.__name__}`" if command.update else ""
        lines.append(f"| `{name}` | `{command.resample.func.__name__}` | {update} | {command.size} |")
    lines += ["", "| action | every step | before each physics step | when an episode starts |", "| --- " * 4 + "|"]
    for name, action in mdp.ACTIONS.items():
        reset = f"`{action.reset.func.__name__}`" if action.reset else ""
        lines.append(f"| `{name}` | `{action.process.func.__name__}` | `{action.apply.func.__name__}` | {reset} |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "docs" / "terms.md")
    parser.parse_args(arguments).output.write_text(page())


if __name__ == "__main__":
    main(sys.argv[1:])
