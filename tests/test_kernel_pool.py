# SPDX-License-Identifier: Apache-2.0
"""Kernel pool: modules are compiled in threads before they are launched, each once."""

from __future__ import annotations

import subprocess
import sys
from os import environ

from tests.helpers.checkout import PYTHONPATH

PROGRAM = """
import sys, threading
import warp as wp
wp.config.log_level = wp.LOG_WARNING
wp.config.kernel_cache_dir = sys.argv[1]
from stripe_newton.cli.kernel_lock import compile_once
from stripe_newton.kernel_pool import compile_ahead, kernel_pool
compile_once()

@wp.kernel(module="unique")
def add_one(x: wp.array[float]):
    x[0] = x[0] + 1.0

@wp.kernel(module="unique")
def add_two(x: wp.array[float]):
    x[0] = x[0] + 2.0

@wp.kernel(module="unique")
def wrong(x: wp.array[float]):
    x[0] = unknown_function(x[0])

# Both compilations are under way at once: each waits for the other to begin.
both = threading.Barrier(2, timeout=60.0)
build, main = wp._src.build.build_cpu, threading.current_thread()
def counted(*args, **kwargs):
    assert threading.current_thread() is not main
    both.wait()
    sys.stdout.write("compiled\\n")  # whole, as threads write side by side
    return build(*args, **kwargs)
wp._src.build.build_cpu = counted

with kernel_pool(2):
    for kernel in (wrong, add_one, add_two):
        compile_ahead(kernel, "cpu", 256)
x = wp.zeros(1, device="cpu")
wp.launch(add_one, 1, [x], device="cpu")
wp.launch(add_two, 1, [x], device="cpu")
assert x.numpy()[0] == 3.0
try:
    wp.launch(wrong, 1, [x], device="cpu")
except Exception as error:
    print("unknown_function" in str(error))
compile_ahead(add_one, "cpu", 256)  # without a pool it does nothing
"""


def test_modules_are_compiled_side_by_side_before_their_launch(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    command = [sys.executable, str(program), str(tmp_path / "cache")]
    ran = subprocess.run(command, env=environ | {"PYTHONPATH": PYTHONPATH}, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines() == ["compiled", "compiled", "True"], ran.stderr
    assert "waiting for" not in ran.stderr
