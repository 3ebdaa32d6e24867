# SPDX-License-Identifier: Apache-2.0
"""Clean install: builds sdist and wheel, installs the wheel in a new environment, and uses it without the repository.

python tools/checks/clean_install.py OUT [--torch torch==2.13.0] [--wheel FILE] [--python python3.12]

The wheel is built from the sdist, as an index would build it. The commands run in an empty folder, with an empty kernel
cache unless --keep-cache is given. OUT gets the distributions, the environment, what the commands wrote, and
``clean_install.json`` with their times. The exit code is 1 if anything fails.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"stripe_newton", "stripe_kernels", "stripe_tasks"}
TASK = "Stripe-Cartpole-Direct-v0"
SMALL = ["--num-envs", "16", "--max-iterations", "2", "--device", "cpu", "--final-video", "False"]
COMMANDS: tuple[tuple[str, list[str]], ...] = (
    ("help", ["--help"]),
    ("list", ["list", "--json"]),
    ("new", ["new", "my_arm", "--manager"]),
    ("train", ["train", TASK, *SMALL]),
    ("train again", ["train", TASK, *SMALL]),
    ("report", ["report", "logs"]),
    ("demo", ["demo", "--steps", "20", "--browser", "False"]),
    ("a robot's task", ["bench", "Stripe-Velocity-Flat-Quadruped-v0", "--num-envs", "2", "--steps", "4"]),
)
"""What is run, by the title in the table."""


class InstallError(Exception):
    """A step that failed, with what it printed."""


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for everything; what is in it is replaced")
    parser.add_argument("--torch", default="torch", help="which torch is installed first")
    parser.add_argument("--wheel", type=Path, help="this wheel instead of one of the sources")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the environment")
    parser.add_argument("--keep-cache", action="store_true", help="use the kernel cache of this machine")
    args = parser.parse_args(argv)
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    times: dict[str, float] = {}
    try:
        wheel = args.wheel.resolve() if args.wheel else build(out / "dist", times)
        check_wheel(wheel)
        python = install(wheel, out / "venv", args.python, args.torch, times)
        use(python, out, args.keep_cache, times)
    except InstallError as error:
        print(f"failed: {error}", file=sys.stderr)
        return 1
    finally:
        (out / "clean_install.json").write_text(json.dumps(times, indent=1), encoding="utf-8")
    return 0


def timed(title: str, times: dict[str, float], command: Sequence[str | Path], **options: object) -> str:
    """Run a command, print how long it took, and return what it printed.

    Raises:
        InstallError: if it fails.
    """
    began = time.perf_counter()
    run = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
    times[title] = round(time.perf_counter() - began, 2)
    print(f"{title:<24} {times[title]:8.1f} s", flush=True)
    if run.returncode:
        raise InstallError(f"{title}: exit code {run.returncode}\n{run.stdout[-3000:]}\n{run.stderr[-3000:]}")
    return run.stdout


def build(folder: Path, times: dict[str, float]) -> Path:
    """Build sdist and wheel with the program ``build``; returns the wheel."""
    shutil.rmtree(folder, ignore_errors=True)
    timed("build", times, [sys.executable, "-m", "build", "--outdir", folder, ROOT])
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    check_sdist(sdist)
    return wheel


def tracked_files() -> set[str]:
    """Files of the repository, from its root."""
    found = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(found.stdout.splitlines())


def check_sdist(sdist: Path) -> None:
    """Check that a sdist has the files of the repository and no others.

    Raises:
        InstallError: if it has not.
    """
    with tarfile.open(sdist) as archive:
        names = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    expected = {name for name in tracked_files() if not name.startswith(".ci/")}
    if wrong := (names - {"PKG-INFO"}) ^ expected:
        raise InstallError(f"{sdist.name}: lacks, or has too much: {', '.join(sorted(wrong)[:20])}")


def check_wheel(wheel: Path) -> None:
    """Check that a wheel has the three packages with all their files, and nothing else.

    Raises:
        InstallError: if it has not.
    """
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    expected = {name.removeprefix("kernels/").removeprefix("tasks/") for name in tracked_files()}
    expected = {name for name in expected if name.partition("/")[0] in PACKAGES}
    if wrong := names ^ expected:
        raise InstallError(f"{wheel.name}: lacks, or has too much: {', '.join(sorted(wrong)[:20])}")


def install(wheel: Path, folder: Path, interpreter: str, torch: str, times: dict[str, float]) -> Path:
    """Make an environment and install the wheel into it; returns its interpreter."""
    shutil.rmtree(folder, ignore_errors=True)
    timed("venv", times, [interpreter, "-m", "venv", folder])
    python = folder / "bin" / "python"
    timed("torch", times, [python, "-m", "pip", "install", "--quiet", torch])
    timed("wheel", times, [python, "-m", "pip", "install", "--quiet", wheel])
    return python


def use(python: Path, out: Path, keep_cache: bool, times: dict[str, float]) -> None:
    """Run the commands in an empty folder, without the repository on the path.

    Raises:
        InstallError: if one fails, or if the repository is imported nevertheless.
    """
    folder = out / "work"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    if not keep_cache:
        shutil.rmtree(out / "cache", ignore_errors=True)
        env["WARP_CACHE_PATH"] = str(out / "cache")
    where = "import stripe_newton, stripe_tasks; print(stripe_newton.__file__, stripe_tasks.__file__)"
    files = timed("import", times, [python, "-c", where], cwd=folder, env=env).split()
    if not all(Path(file).is_relative_to(out / "venv") for file in files):
        raise InstallError(f"imported from {files}, not from the environment")
    program = python.with_name("stripe-newton")
    for title, words in COMMANDS:
        text = timed(title, times, [program, *words], cwd=folder, env=env)
        if title == "list" and TASK not in text:
            raise InstallError(f"list: does not name {TASK}")
    if not list(folder.glob("logs/*/*/report.html")):
        raise InstallError("train: left no report")


if __name__ == "__main__":
    sys.exit(main())
