# SPDX-License-Identifier: Apache-2.0
"""One line says that kernels are compiled, in a Python program that has not chosen a logger of Warp."""

import os
import subprocess
import sys

PROGRAM = """
import warp as wp
from stripe_newton.sim import Simulation, SimulationCfg
Simulation(SimulationCfg(device="cpu"))

@wp.kernel
def first(x: wp.array[float]):
    x[wp.tid()] = 1.0

@wp.kernel(module="unique")
def second(x: wp.array[float]):
    x[wp.tid()] = 2.0

x = wp.zeros(4, dtype=float, device="cpu")
wp.launch(first, dim=4, inputs=[x], device="cpu")
wp.launch(second, dim=4, inputs=[x], device="cpu")
"""


def test_a_program_says_once_that_kernels_are_compiled(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)  # Warp reads the source of kernels from a file
    env = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "cache")}
    for lines in (1, 0):  # the second run takes them from the cache
        done = subprocess.run(
            [sys.executable, tmp_path / "program.py"], env=env, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("compiling kernels, once for this machine\n") == lines
        assert "Module" not in done.stdout + done.stderr
