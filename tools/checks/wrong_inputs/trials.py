# SPDX-License-Identifier: Apache-2.0
"""Trials: tries wrong inputs, each in a process that is forked from one that has imported and compiled everything."""

from __future__ import annotations

import contextlib
import fcntl
import importlib
import io
import json
import linecache
import math
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from call_cases import ENVS
from case import judge_message
from command_cases import ABSOLUTE
from process_trial import try_process
from recipes import prepare

__all__ = ["Trials"]

MEMORY = 4 << 30
"""Bytes that a trial may use beyond those of the process that it is forked from."""
OURS = ("stripe_newton", "stripe_kernels", "stripe_tasks")

Result = tuple[str, str]
"""Outcome and text."""


class Trials:
    """Tries cases; imports and compiles on construction.

    Args:
        templates: Run folders by task.
        timeout: Seconds that a case may take.
    """

    def __init__(self, templates: dict[str, str], timeout: float = 60.0):
        self._templates, self._timeout = templates, timeout
        self._base = tempfile.mkdtemp(prefix="wrong-inputs-")
        _warm_up()

    def try_case(self, line: str) -> tuple[str, str, dict[str, Any]]:
        """Outcome and text of a case that is given as a line of JSON."""
        case = json.loads(line)
        # Two folders deep, so that what a trial writes beside its own folder is seen.
        outer = tempfile.mkdtemp(dir=self._base)
        folder = os.path.join(outer, "here")
        os.mkdir(folder)
        answer, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(answer)
            _run_child(case, folder, theirs, self._templates)
        os.close(theirs)
        try:
            return (*self._wait(child, answer), {})
        finally:
            os.close(answer)
            shutil.rmtree(outer, ignore_errors=True)

    def _wait(self, child: int, answer: int) -> Result:
        """Wait for a child, and end it and those that it has started if it takes too long."""
        deadline, content = time.monotonic() + self._timeout, b""
        while select.select([answer], [], [], max(0.0, deadline - time.monotonic()))[0]:
            part = os.read(answer, 1 << 16)
            if not part:
                break
            content += part
        else:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "hang", f"no end within {self._timeout:g} s"
        status = os.waitpid(child, 0)[1]
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        if content:
            outcome, text = json.loads(content)
            return outcome, text
        code = os.waitstatus_to_exitcode(status)
        return "crash", signal.Signals(-code).name if code < 0 else f"exit status {code}"


def _warm_up() -> None:
    """Import and compile what the trials need."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    for name in ("train", "eval", "play", "bench", "export", "compare", "inspect", "scene"):
        importlib.import_module(f"stripe_newton.cli.{name}")
    import torch

    torch.set_num_threads(1)
    for module in ("stripe_newton.rl.export.onnx_policy", "stripe_newton.rl.runner", "h5py", "onnxruntime", "onnx"):
        importlib.import_module(module)
    for env in ENVS:
        _made[env] = _make_env(env)


_made: dict[str, tuple[Any, Any]] = {}
"""Environment and config by name: made once, for the forked processes."""


def _make_env(name: str) -> tuple[Any, Any]:
    import torch

    env_class, cfg_class = (_resolve(path) for path in ENVS[name])
    cfg = cfg_class(seed=0)
    cfg.sim.device, cfg.scene.num_envs = "cpu", 4
    env = env_class(cfg)
    env.reset()
    env.step(torch.zeros(4, 1))
    return env, cfg


def _resolve(path: str) -> Any:
    module, _, name = path.partition(":")
    found: Any = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found


# -- in the child


def _run_child(case: dict[str, Any], folder: str, answer: int, templates: dict[str, str]) -> None:
    """Try a case in this process, which is forked, write the result, and end."""
    os.setpgid(0, 0)
    os.chdir(folder)
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    result: Result
    warnings.filterwarnings("always", category=UserWarning)  # as a user sees them who starts a command
    try:
        prepare(case["data"].get("files", []), templates)
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        result = KINDS[case["kind"]](case, folder)
    except BaseException:
        result = "broken", traceback.format_exc()
    # The limit may be reached, or the standard output a full disk: nothing but a write from here on.
    os.write(answer, json.dumps([result[0], result[1][-3000:]]).encode())
    os._exit(0)


def _try_config(case: dict[str, Any], folder: str) -> Result:
    from stripe_newton.configclass import ConfigError

    data = case["data"]
    cls, value = _resolve(data["cls"]), eval(data["value"])
    text = "no error"
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            cfg = cls()
            setattr(cfg, data["field"], value)
            cfg.validate()
        except ConfigError as error:
            text = str(error)
            wrong = [problem for problem in error.problems if "is missing" not in problem]
            if wrong and judge_message("\n".join(wrong), case["names"]) == "clear":
                return "clear", text
        except (AttributeError, TypeError, ValueError) as error:
            return _judge_error(error, case["names"])
        except Exception:
            return "traceback", traceback.format_exc()
    # A field that only makes others' configs load takes anything, and says that it has no effect.
    said = "\n".join(str(warning.message) for warning in warned)
    return ("clear" if said and judge_message(said, case["names"]) == "clear" else "silent"), f"{text}\n{said}"


def _judge_error(error: Exception, names: list[str]) -> Result:
    """An error that is raised on purpose by this project is judged by its message; any other is a traceback."""
    text = "".join(traceback.format_exception(error))
    if not _is_raised_here(error):
        return "traceback", text
    return judge_message(str(error), names), f"{type(error).__name__}: {error}"


def _is_raised_here(error: BaseException) -> bool:
    """Whether the innermost frame is a ``raise`` of this project, or of a function of its that raises."""
    frames = traceback.extract_tb(error.__traceback__)
    last = frames[-1]
    line = (linecache.getline(last.filename, last.lineno or 0)).strip()
    return any(f"/{name}/" in last.filename for name in OURS) and line.startswith("raise")


def _try_call(case: dict[str, Any], folder: str) -> Result:
    import numpy as np
    import torch

    data = case["data"]
    space: dict[str, Any] = {"torch": torch, "np": np}
    if data["env"]:
        from stripe_newton import managers
        from stripe_newton.envs import mdp
        from stripe_newton.rl import RslRlVecEnvWrapper, RunFolder, ZeroPolicy, evaluate, load_checkpoint, record_video

        space |= {name: getattr(managers, name) for name in managers.__all__ if name.endswith("Cfg")}
        space |= {"mdp": mdp, "RslRlVecEnvWrapper": RslRlVecEnvWrapper, "RunFolder": RunFolder}
        space |= {"ZeroPolicy": ZeroPolicy, "evaluate": evaluate, "load_checkpoint": load_checkpoint}
        space |= {"record_video": record_video}
        space["env"], space["cfg"] = _made[data["env"]]
    try:
        exec(data["prepare"], space)
    except Exception:  # the library that makes the file takes no such value
        return "works", f"cannot be made: {traceback.format_exc(limit=1)}"
    try:
        exec(data["code"], space)
        if data["env"] and not space["env"].closed:
            observations, rewards, *_ = space["env"].step(torch.zeros(4, 1))
            if not (torch.isfinite(rewards).all() and torch.isfinite(observations["policy"]).all()):
                return "silent", "observations or rewards are not finite"
    except Exception as error:
        return _judge_error(error, case["names"])
    return ("works", "") if case["may_pass"] else ("silent", "no error")


def _try_command(case: dict[str, Any], folder: str) -> Result:
    from stripe_newton.cli import main

    data = case["data"]
    if data.get("no_sweep"):
        _end_before_sweep()
    if case["group"] != "written places":
        _end_after_training()
    if "file_size_limit" in data:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    there = _files_around(folder)
    out = _Captured()
    with out:
        if "file_size_limit" in data:
            limit = data["file_size_limit"]
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            code: object = main(data["argv"])
        except BaseException as error:
            code = error
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    wrong = _written_elsewhere(data, folder, there)
    if wrong:
        return "silent", f"{wrong}\n{out.text()}"
    if isinstance(code, BaseException):
        return "traceback", "".join(traceback.format_exception(code)) + out.text()
    if code == 0:
        return _judge_success(case, out.text())
    text = out.text()
    # What commands print before they fail is no part of the message.
    begin = max(text.rfind("\nerror: "), 0)
    message = text[begin:]
    outcome = judge_message(message, case["names"])
    return outcome, text


def _judge_success(case: dict[str, Any], text: str) -> Result:
    finite = case["data"].get("finite")
    if finite is not None:
        from stripe_newton.rl import read_metrics

        rows = [read_metrics(file) for file in Path(finite).rglob("metrics.csv")]
        bad = [name for row in rows for name, values in row.items() if name.startswith("Loss/") and not _finite(values)]
        if bad or not rows:
            return "silent", f"not finite: {bad}\n{text}"
    warned = [line for line in text.splitlines() if "warning" in line.lower() or line.startswith("  ")]
    if warned and judge_message("\n".join(warned)[:3000], case["names"]) == "clear":
        return "clear", text
    return ("works", text) if case["may_pass"] else ("silent", text)


def _finite(values: list[float]) -> bool:
    return all(map(math.isfinite, values))


def _end_before_sweep() -> None:
    """Let sweeps end with success before their first run: only what is checked before it is of interest."""
    import stripe_newton.cli.train_sweep as module

    def stop(*args: object, **kwargs: object) -> Any:
        raise SystemExit(0)

    setattr(module, "list_slots", stop)  # noqa: B010


def _end_after_training() -> None:
    """Let trainings end without curve, export and video: they take longest, and are the same after any input."""
    import stripe_newton.cli.train as module

    setattr(module, "_finish", lambda *args, **kwargs: None)  # noqa: B010


def _files_around(folder: str) -> set[str]:
    """Files and folders beside the folder of the trial."""
    return set(os.listdir(Path(folder).parent)) | {name for name in (ABSOLUTE,) if os.path.exists(name)}


def _written_elsewhere(data: dict[str, Any], folder: str, before: set[str]) -> str:
    found = [name for name in data.get("forbidden", []) if Path(folder, name).exists()]
    if found:
        return f"foreign code was run, or a shell: {found}"
    if "only_below" not in data:
        return ""
    allowed = {*data["only_below"], "evilmod.py", "__pycache__"}
    inside = set(os.listdir(folder)) - allowed
    outside = _files_around(folder) - before
    shutil.rmtree(ABSOLUTE, ignore_errors=True)
    return f"written outside: {sorted(inside | outside)}" if inside | outside else ""


class _Captured:
    """Takes what is written to the standard output and error, by Python and by native code."""

    _text: str | None = None

    def __enter__(self) -> None:
        # A pipe, not a file: a trial may have a limit on the size of files.
        self._reading, writing = os.pipe()
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 1 << 20)
        sys.stdout.flush()
        sys.stderr.flush()
        self._kept = os.dup(1), os.dup(2)
        os.dup2(writing, 1)
        os.dup2(writing, 2)
        os.close(writing)
        self._streams = sys.stdout, sys.stderr
        sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), write_through=True)
        sys.stderr = io.TextIOWrapper(io.FileIO(2, "w", closefd=False), write_through=True)

    def __exit__(self, *_: object) -> None:
        for number, kept in zip((1, 2), self._kept, strict=True):
            os.dup2(kept, number)
            os.close(kept)
        sys.stdout, sys.stderr = self._streams

    def text(self) -> str:
        if self._text is None:
            # Both ends that write are closed by now, unless a process that was started here still has one.
            os.set_blocking(self._reading, False)
            content = b""
            with contextlib.suppress(BlockingIOError):
                while part := os.read(self._reading, 1 << 20):
                    content += part
            self._text = content.decode(errors="replace")
        return self._text


KINDS: dict[str, Callable[[dict[str, Any], str], Result]] = {
    "config": _try_config,
    "command": _try_command,
    "call": _try_call,
    "process": try_process,
}
