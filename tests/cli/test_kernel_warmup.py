# SPDX-License-Identifier: Apache-2.0
"""Early start of the kernel warm-up: only where it is needed, in Warp's own cache, and never left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
import warp as wp

from stripe_newton.cli import _device_of, kernel_warmup
from stripe_newton.cli.kernel_cache import cache_folder
from tests.helpers.checkout import PYTHONPATH


@pytest.fixture
def started(monkeypatch):
    """Arguments of the processes that would have been started."""
    words: list[list[str]] = []
    monkeypatch.setattr(kernel_warmup, "_early", None)
    monkeypatch.setattr(kernel_warmup.subprocess, "Popen", words.append)
    monkeypatch.setattr(kernel_warmup.atexit, "register", lambda function: None)
    monkeypatch.setattr(kernel_warmup.os, "cpu_count", lambda: 4)
    return words


def test_the_folder_is_that_of_warp(monkeypatch, tmp_path):
    wp.init()
    assert cache_folder() == type(tmp_path)(wp.config.kernel_cache_dir)
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    assert cache_folder() == tmp_path / wp.config.version


def test_it_starts_once_and_where_nothing_is_compiled(started, monkeypatch, tmp_path):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    kernel_warmup.start_early("cpu")
    assert [words[-2:] for words in started] == [["--all", "cpu"]]
    started.clear()
    folder = tmp_path / wp.config.version
    folder.mkdir()
    (folder / f"stripe_newton_{kernel_warmup._versions()}_cpu.warm").touch()
    kernel_warmup.start_early("cpu")
    assert started == []
    kernel_warmup.start_early("cuda:1")  # the file is about the CPU
    assert [words[-1] for words in started] == ["cuda:1"]


def test_it_does_not_start_where_nothing_can_be_compiled(started, monkeypatch, tmp_path):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    (tmp_path / wp.config.version).mkdir()
    monkeypatch.setattr(kernel_warmup.os, "access", lambda path, mode: False)  # root may write everywhere
    kernel_warmup.start_early("cpu")
    assert started == []


def test_what_is_compiled_belongs_to_the_name_of_the_stamp(monkeypatch):
    """Another set of modules, or gradients, are compiled although an earlier set was."""
    before = kernel_warmup._versions()
    monkeypatch.setenv("STRIPE_NEWTON_GRADIENTS", "1")
    with_gradients = kernel_warmup._versions()
    monkeypatch.setitem(kernel_warmup.MODULES, "newton._src.sim.collide", 1.0)
    assert len({before, with_gradients, kernel_warmup._versions()}) == 3


def test_ranks_and_single_cores_do_not_start_it(started, monkeypatch, tmp_path):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    monkeypatch.setenv("WORLD_SIZE", "2")
    kernel_warmup.start_early("cpu")
    monkeypatch.delenv("WORLD_SIZE")
    monkeypatch.setattr(kernel_warmup.os, "cpu_count", lambda: 1)
    kernel_warmup.start_early("cpu")
    assert started == []


def test_the_device_of_a_command():
    assert _device_of("train", ["A-v0", "--device", "cuda:1"]) == "cuda:1"
    assert _device_of("train", ["A-v0", "--device=cpu"]) == "cpu"
    assert _device_of("train", ["A-v0"]) is None
    assert _device_of("demo", []) == "cpu"


@pytest.mark.slow
def test_nothing_goes_on_after_the_command_has_ended(tmp_path):
    """The command is ended while kernels are compiled; its processes end with it."""
    env = os.environ | {"PYTHONPATH": PYTHONPATH, "WARP_CACHE_PATH": str(tmp_path)}
    words = [sys.executable, "-m", "stripe_newton.cli", "demo", "--viewer", "none", "--steps", "1"]
    command = subprocess.Popen(words, env=env, stderr=subprocess.PIPE, text=True, start_new_session=True)
    for line in command.stderr:
        if "compiling kernels" in line:
            break
    command.send_signal(signal.SIGTERM)
    assert command.wait(60) == 143
    assert command.stderr.read().count("ended by SIGTERM") == 1  # by the command alone
    for _ in range(100):
        time.sleep(0.1)
        if not subprocess.run(["pgrep", "-g", str(command.pid)], capture_output=True, text=True).stdout:
            return
    pytest.fail("processes are left")


def test_what_is_compiled_for_which_device(monkeypatch):
    """On a GPU in the sizes of blocks that are launched; kernels that check a file's masses on the CPU, too."""
    compiled = []

    def compile_one(module: wp.Module, device: str) -> None:
        compiled.append((module.name, device, module.options["block_dim"]))

    monkeypatch.setattr(wp, "compile_aot_module", compile_one)
    monkeypatch.setattr(wp.Module, "mark_modified", lambda module: None)
    names = ["newton._src.sim.articulation", "newton._src.geometry.inertia"]
    options = [wp.get_module(name).options for name in names]
    before = [dict(o) for o in options]
    try:
        kernel_warmup.compile_modules("cuda:0", names)
    finally:
        for now, then in zip(options, before, strict=True):
            now.update(then)
    found = {(name.partition("_kernel_")[0], *rest) for name, *rest in compiled}
    assert found == {
        ("newton._src.sim.articulation", "cuda:0", 8),
        ("newton._src.sim.articulation", "cuda:0", 16),
        ("newton._src.geometry.inertia", "cuda:0", 256),
        ("validate_and_correct_inertia", "cuda:0", 256),
        ("validate_and_correct_inertia", "cpu", 1),
        ("compute_body_inverses", "cuda:0", 256),
        ("compute_body_inverses", "cpu", 1),
    }


def test_shares_are_compiled_in_processes_that_are_forked(tmp_path):
    """One that fails, as there are no kernels in ``json``, does not hold the others up, and is told."""
    env = os.environ | {"PYTHONPATH": PYTHONPATH, "WARP_CACHE_PATH": str(tmp_path)}
    words = [sys.executable, "-m", "stripe_newton.cli.kernel_warmup", "cpu", "stripe_kernels.episode", "json"]
    ran = subprocess.run([*words, "stripe_kernels.adam"], env=env, capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert sorted(ran.stdout.split()) == ["compiled", "compiled", "stripe_kernels.adam", "stripe_kernels.episode"]
    assert len(list(tmp_path.rglob("*.o"))) == 2
