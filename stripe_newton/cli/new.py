# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton new``: makes a package with a task that trains at once, and tests, to begin from."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from .user_error import UserError

__all__ = ["NewArgs", "run"]

_KINDS = {
    "direct": "A cart that keeps up a pole, in the direct workflow.",
    "manager": "A cart that keeps up a pole, made of terms.",
    "scene": "An ant that walks east across generated ground: a scene and a task that know nothing of each other.",
    "robot": "The robot @ROBOT@ keeps its pose.",
}
"""Descriptions by kind of template."""
_FILES = {
    "__init__.py": "registers the task",
    "env.py": "config, environment and training",
    "env_cfg.py": "config of the environment and of the training",
    "terms.py": "terms of your own",
    "robot.py": "the robot: file, start, drives",
    "scene.py": "the scene specification",
    "task.py": "the training specification, for any scene",
    "binding.py": "the task in the scene",
    "sim.py": "the scene without the task",
}


@dataclass
class NewArgs:
    """Make a package with a task that trains at once, and tests."""

    name: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="NAME")]]
    """Name of the package, such as my_robot."""
    direct: bool = False
    """A task in the direct workflow, with torch hooks; this is the default."""
    manager: bool = False
    """A task made of terms."""
    scene: bool = False
    """A generated scene, a task, and what binds them."""
    robot: Path | None = None
    """A task for the robot of a URDF, MJCF or USD file."""
    floating: bool = False
    """With --robot: the base floats, if the file does not say; by default it is held."""
    out: Path = Path(".")
    """Folder in which the package's folder is made."""


def run(argv: list[str]) -> int:
    """Run the command."""
    args = tyro.cli(NewArgs, args=argv, prog="stripe-newton new")
    kind, folder = _kind(args), args.out / args.name
    _check_name(args.name)
    if folder.exists():
        raise UserError(f"{folder}: exists already; choose another name, or another folder by --out")
    title = "".join(word[:1].upper() + word[1:] for word in re.split(r"_+", args.name))
    values = {"NAME": args.name, "CLASS": title, "TASK": f"{title}-v0", "WHAT": _KINDS[kind]}
    if args.robot is not None:
        from .new_robot import robot_values  # here, as it reads the file, with Newton

        values |= robot_values(args.robot, args.floating or None)
        what = f"the base {values['BASE']}{values['UNDECIDED']}{values['PASSIVE']}"
        print(f"{values['ROBOT']}: {what}")
    made = _write(kind, folder, values)
    if "COPY" in values:
        made.append(Path(shutil.copy(values["FILE"], folder / args.name / values["COPY"])))
    print("\n".join(str(path) for path in made))
    print(f"next, in {folder}:")
    print(f"  stripe-newton train {values['TASK']} --import {args.name}")
    print("  python -m pytest tests")
    return 0


def _kind(args: NewArgs) -> str:
    chosen = [name for name in _KINDS if getattr(args, name)]
    if len(chosen) > 1:
        raise UserError(f"{' and '.join(f'--{name}' for name in chosen)}: give one of them")
    if args.floating and args.robot is None:
        raise UserError("--floating: only with --robot")
    return chosen[0] if chosen else "direct"


def _check_name(name: str) -> None:
    if not name.isidentifier() or keyword.iskeyword(name) or not name.islower():
        raise UserError(
            f"'{name}': must be the name of a Python package: small letters, digits and _, such as my_robot"
        )
    if importlib.util.find_spec(name) is not None:
        raise UserError(f"'{name}': Python has a package of this name already; choose another one")


def _write(kind: str, folder: Path, values: dict[str, str]) -> list[Path]:
    """Write the files of a template, with its placeholders filled. Returns their paths."""
    templates = Path(__file__).with_name("templates")
    package = templates / kind / "package"
    found: dict[str, Path] = {
        "pyproject.toml": templates / "common" / "pyproject.toml.template",
        "README.md": templates / "common" / "README.md.template",
        ".gitignore": templates / "common" / "gitignore.template",
    }
    own = {_file_name(entry) for entry in package.iterdir()}
    about = {name: text for name, text in _FILES.items() if name in own}
    about |= {values["COPY"]: "the robot's file, a copy"} if "COPY" in values else {}
    values = values | {"FILES": "\n".join(f"| `@NAME@/{name}` | {text} |" for name, text in about.items())}
    for place, target in ((package, values["NAME"]), (templates / kind / "tests", "tests")):
        found |= {f"{target}/{_file_name(entry)}": entry for entry in sorted(place.iterdir())}
    made = []
    for name, template in found.items():
        path = folder / _filled(name, values)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_filled(template.read_text(encoding="utf-8"), values), encoding="utf-8")
        made.append(path)
    return made


def _file_name(template: Path) -> str:
    return template.name.removesuffix(".template")


def _filled(text: str, values: dict[str, str]) -> str:
    """A text with the values of its placeholders, which may have placeholders themselves."""
    for _ in range(2):
        for name, value in values.items():
            text = text.replace(f"@{name}@", value)
    return text
