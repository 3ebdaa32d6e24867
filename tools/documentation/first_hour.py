# SPDX-License-Identifier: Apache-2.0
"""First hour: does what a tutorial page says, in a new folder, and writes a recording of it.

    python tools/documentation/first_hour.py [--page docs/tutorial.md] [--output docs/first_hour.md] [--install]

The page is read from top to bottom. A fenced block that begins with the name of a file is written to that file, a
``diff`` block changes one, and each indented line is a command. Warp's kernel cache begins empty, so that the
times are those of a new machine. ``--install`` also makes a virtual environment and installs the checkout into it.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
STEP = re.compile(
    r"^## (?P<heading>[^\n]*)$|^```(?P<kind>xml|python|diff)\n(?P<block>.*?)^```|^ {4}(?P<command>\S[^\n]*)$",
    re.S | re.M,
)
HUNK = re.compile(r"(?:^[ -].*\n)+(?:^\+.*\n)*", re.M)
FILE_NAME = re.compile(r"(?:<!-- |# |--- )([\w/]+\.\w+)(?: -->)?\n")
PACKAGES = ("newton", "warp-lang", "torch", "rsl-rl-lib")


@dataclass
class Step:
    """One step of a page."""

    kind: str
    """``heading``, ``command``, ``xml``, ``python`` or ``diff``."""
    text: str
    """The heading, the command, or the content of the file."""
    file: str = ""
    """File that a block is written to, or that it changes."""


def read_steps(page: Path) -> Iterator[Step]:
    """The steps of a page, in its order.

    Raises:
        ValueError: if a block does not name its file.
    """
    for match in STEP.finditer(page.read_text(encoding="utf-8")):
        if match["heading"]:
            yield Step("heading", match["heading"])
        elif match["command"]:
            yield Step("command", match["command"])
        else:
            name = FILE_NAME.match(match["block"])
            if name is None:
                raise ValueError(
                    f"{page.name}: a block begins with {match['block'].splitlines()[0]!r}, not with a file"
                )
            kind, text = match["kind"], match["block"]
            yield Step(kind, text if kind == "python" else text[name.end() :], name[1])


def apply_block(step: Step, folder: Path) -> None:
    """Write a block's file below a folder, or change it.

    Raises:
        ValueError: if a file does not have the lines that a ``diff`` block removes.
    """
    path = folder / step.file
    if step.kind != "diff":
        path.write_text(step.text, encoding="utf-8")
        return
    text = path.read_text(encoding="utf-8")
    for hunk in HUNK.findall(step.text):
        lines = hunk.splitlines(keepends=True)
        old, new = ("".join(line[1:] for line in lines if line[0] != sign) for sign in "+-")
        if text.count(old) != 1:
            raise ValueError(f"{step.file} has {text.count(old)} times the lines\n{old}")
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def with_run(command: str, folder: Path) -> str:
    """A command in which ``DATE_TIME`` is the newest run folder."""
    match = re.search(r"(\S*/)DATE_TIME", command)
    if match is None:
        return command
    newest = max(path.name for path in (folder / match[1]).iterdir() if path.is_dir())
    return command.replace("DATE_TIME", newest)


class Recorder:
    """Runs commands in a folder and keeps what they print."""

    def __init__(self, folder: Path, env: dict[str, str]):
        self.folder = folder
        self.env = env
        self.lines: list[str] = []
        self.machine = machine()  # now, before the recording adds to the load
        self.began = time.monotonic()

    def run(self, command: str) -> None:
        """Run a command; an error of it ends the recording."""
        if command.startswith("cd "):
            self.folder /= command[3:]
            self._block(command, "", 0.0)
            return
        command = with_run(command, self.folder)
        print(f"$ {command}", flush=True)
        began = time.monotonic()
        done = subprocess.run(
            command, shell=True, cwd=self.folder, env=self.env, text=True, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
        print(done.stdout, flush=True)
        self._block(command, done.stdout, time.monotonic() - began)
        if done.returncode:
            raise SystemExit(f"exit code {done.returncode}")

    def _block(self, command: str, output: str, seconds: float) -> None:
        total = time.monotonic() - self.began
        shown = f"$ {command}\n{output}".rstrip().splitlines()
        text = "\n".join(line.rstrip() for line in shown)
        took = f"\n\n{_clock(seconds)}, at {_clock(total)}" if seconds else ""
        self.lines.append(f"```text\n{text}\n```{took}\n")


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def _packages(env: dict[str, str]) -> str:
    """Versions of the packages that the commands used."""
    code = f"from importlib.metadata import version; print(*[f'{{n}} {{version(n)}}' for n in {PACKAGES}], sep=', ')"
    return subprocess.run(["python", "-c", code], env=env, text=True, capture_output=True, check=True).stdout.strip()


def machine() -> str:
    """The machine in words, with what else it had to do."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[0]
    busy = f", which {load:.0f} other processes shared" if load > 0.5 * cores else ""
    return f"{cores} cores of a CPU ({platform.machine()}){busy}; no GPU; Python {platform.python_version()}"


def main() -> None:
    """Record a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "tutorial.md")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "first_hour.md")
    parser.add_argument("--install", action="store_true", help="make a virtual environment and install the checkout")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "work"
        folder.mkdir()
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        env = os.environ | {"WARP_CACHE_PATH": f"{name}/kernels", "PATH": path, "COLUMNS": "120"}
        recorder = Recorder(folder, env)
        if args.install:
            env["PATH"] = os.pathsep.join([f"{folder}/.venv/bin", env["PATH"]])
            env.pop("PYTHONPATH", None)
            recorder.lines.append("\n## Set-up\n")
            recorder.run(f"{Path(sys.executable).name} -m venv .venv")
            recorder.run(f'pip install -qq "{ROOT}[export]" pytest')
        for step in read_steps(args.page):
            if step.kind == "heading":
                recorder.lines.append(f"\n## {step.text}\n")
            elif step.kind == "command":
                recorder.run(step.text)
            else:
                apply_block(step, recorder.folder)
                recorder.lines.append(f"`{step.file}` is {'changed' if step.kind == 'diff' else 'written'}.\n")
        args.output.write_text(_page(recorder, args.page, name), encoding="utf-8")


def _page(recorder: Recorder, page: Path, folder: str) -> str:
    total = _clock(time.monotonic() - recorder.began)
    packages = _packages(recorder.env)
    head = f"""# The first hour

A recording of [the tutorial]({page.name}), in {total}. `python tools/documentation/first_hour.py` did what the page
says, in a new folder and with an empty kernel cache. Below each command stands how long it took, and how long the hour
had lasted when it ended.

- {recorder.machine}
- {packages}
"""
    text = head + "\n".join(recorder.lines)
    text = text.replace(f"{folder}/work", "~").replace(str(ROOT), "stripe-newton").replace(str(Path.home()), "~")
    return re.sub(r"\n{3,}", "\n\n", text)


if __name__ == "__main__":
    main()
