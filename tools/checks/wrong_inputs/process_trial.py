# SPDX-License-Identifier: Apache-2.0
"""Process trial: a command in a process of its own, with other surroundings, or ended at some moment."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any

from case import judge_message

__all__ = ["try_process"]


def try_process(case: dict[str, Any], folder: str) -> tuple[str, str]:
    """Outcome and text of a case in the working directory."""
    data = case["data"]
    environ = {**os.environ, **{name: value for name, value in data.get("environ", {}).items() if value is not None}}
    for name, value in data.get("environ", {}).items():
        if value is None:
            environ.pop(name, None)
    command = [sys.executable, "-m", "stripe_newton", *data["argv"]]
    how = {"closed": 'exec "$@" >&-', "closed input": 'exec "$@" <&-', "full": 'exec "$@" >/dev/full'}
    if data.get("output") in how:
        command = ["sh", "-c", how[data["output"]], "sh", *command]
    # The trials themselves may run under nohup, or in the background of a shell.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command, env=environ, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors
        )
        assert process.stdout is not None
        text = _read(process.stdout, data)
        if "signal" in data:
            time.sleep(data["after"])
            process.send_signal(signal.Signals[data["signal"]])
        text += process.stdout.read().decode(errors="replace") if not process.stdout.closed else ""
        code = process.wait()
        errors.seek(0)
        text += errors.read().decode(errors="replace")
    return _judge(case, code, text)


def _read(stream: IO[bytes], data: dict[str, Any]) -> str:
    if data.get("output") != "head":
        return ""
    line = stream.readline().decode(errors="replace")
    stream.close()
    return line


def _judge(case: dict[str, Any], code: int, text: str) -> tuple[str, str]:
    if "Traceback (most recent call last)" in text:
        return "traceback", text
    if "signal" in case["data"]:
        number = signal.Signals[case["data"]["signal"]]
        if code not in (0, 128 + number, -number):
            return "crash", f"{text}\nexit status {code}"
        left = [*Path("logs").rglob("*.part")] + [run for run in Path("logs").glob("*/*") if not _can_be_resumed(run)]
        return ("silent", f"half-made: {left}\n{text}") if left else ("works", text)
    if code < 0:
        return "crash", f"{text}\n{signal.Signals(-code).name}"
    return ("works", text) if code == 0 else (judge_message(text[max(text.rfind("error: "), 0) :], case["names"]), text)


def _can_be_resumed(run: Path) -> bool:
    return any(run.glob("checkpoints/model_*.pt")) and all(
        (run / "params" / f"{n}.yaml").exists() for n in ("env", "agent")
    )
