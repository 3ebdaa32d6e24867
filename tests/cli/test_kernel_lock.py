# SPDX-License-Identifier: Apache-2.0
"""Kernel lock: processes that start at once compile each module once."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from stripe_newton.cli.kernel_lock import hold_cache
from stripe_newton.file_lock import FileLock
from tests.helpers.checkout import PYTHONPATH

PROGRAM = """
import sys
import warp as wp
wp.config.log_level = wp.LOG_WARNING
wp.config.kernel_cache_dir = sys.argv[1]
from stripe_newton.cli.kernel_lock import compile_once
compile_once()
compile_once()

@wp.kernel
def {name}(x: wp.array[float]):
    x[0] = x[0] + 1.0

build = wp._src.build.build_cpu
def counted(*args, **kwargs):
    print("compiled", flush=True)
    return build(*args, **kwargs)
wp._src.build.build_cpu = counted
print("ready", flush=True)
sys.stdin.readline()
{first}
x = wp.zeros(1, device="cpu")
wp.launch({name}, 1, [x], device="cpu")
assert x.numpy()[0] == 1.0
"""


AHEAD = """
module = wp.get_module("__main__")
module.options["block_dim"] = 1
wp.compile_aot_module(module, "cpu")
"""
"""As kernels are compiled ahead for a GPU, into the cache and without loading."""


@pytest.mark.parametrize("first", ["", AHEAD])
def test_one_of_two_processes_compiles(tmp_path, first):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(name="add_one", first=first))
    command = [sys.executable, str(program), str(tmp_path / "cache")]
    environment = os.environ | {"PYTHONPATH": PYTHONPATH}
    pipe = subprocess.PIPE
    both = [subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment) for _ in range(2)]
    for process in both:
        assert process.stdout.readline() == "ready\n"
    outputs = [process.communicate("go\n")[0] for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert sorted(outputs) == ["", "compiled\n"]
    assert not list((tmp_path / "cache").glob("*.lock"))


def test_a_cache_that_cannot_be_written_is_no_error(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("")
    with hold_cache(tmp_path / "file" / "a.lock", "a"):
        pass
    monkeypatch.setattr("stripe_newton.cli.kernel_lock._SILENT_S", 0.0)
    monkeypatch.setattr("stripe_newton.cli.kernel_lock._MOST_S", 0.2)
    lock = FileLock(tmp_path / "b.lock")
    assert lock.acquire() is None
    with hold_cache(tmp_path / "b.lock", "module b"):
        assert lock.is_held
    err = capsys.readouterr().err
    assert f"waiting for process {os.getpid()}, which compiles module b" in err
    assert f"process {os.getpid()} has been compiling for long; compiling module b here, too" in err
    lock.release()
