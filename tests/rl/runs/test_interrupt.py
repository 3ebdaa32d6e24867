# SPDX-License-Identifier: Apache-2.0
"""Interrupts: a terminal that is closed ends nothing before it is saved."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from stripe_newton.rl.runs import interrupt

pty = pytest.importorskip("pty")

PROGRAM = """
import os, runpy, signal, sys, time
result, module = sys.argv[1:]
os.close(os.open(os.ttyname(0), os.O_RDWR))  # the terminal of this session from now on
stop = []
def ask(number):
    stop.append(number.name)
    print("stopping after this iteration", flush=True)
    print("stopping after this iteration", file=sys.stderr, flush=True)
with runpy.run_path(module)["on_first_signal"]((signal.SIGHUP, signal.SIGTERM), ask):
    print("trains", flush=True)
    end = time.monotonic() + 30.0
    while not stop and time.monotonic() < end:
        time.sleep(0.01)
    with open(result, "w") as file:
        file.write(f"saved after {stop}")
"""


@pytest.mark.parametrize("redirected", [False, True])
def test_a_closed_terminal(redirected, tmp_path):
    result, output = tmp_path / "result", tmp_path / "output"
    mine, its = pty.openpty()
    command = [sys.executable, "-c", PROGRAM, str(result), interrupt.__file__]
    with open(output, "w") as file:
        streams = (file, file) if redirected else (its, its)
        process = subprocess.Popen(command, stdin=its, stdout=streams[0], stderr=streams[1], start_new_session=True)
    os.close(its)
    if redirected:
        while "trains" not in output.read_text() and process.poll() is None:
            pass
    else:
        assert b"trains" in os.read(mine, 100)
    os.close(mine)  # the window is closed
    assert process.wait(60.0) == 0
    assert result.read_text() == "saved after ['SIGHUP']"
    assert output.read_text().count("stopping") == (2 if redirected else 0)
