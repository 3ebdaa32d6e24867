# SPDX-License-Identifier: Apache-2.0
"""Early libraries: torch's libraries and the GPU's context are there before torch, and nothing depends on it."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest

from stripe_newton.cli import early_libraries

LOADED = """
import os, sys, threading
from stripe_newton.cli.early_libraries import load_early
os.cpu_count = lambda: 2
load_early("cpu", [])
[thread.join() for thread in threading.enumerate() if thread is not threading.main_thread()]
assert "torch" not in sys.modules
with open("/proc/self/maps") as maps:
    assert "libtorch_cpu.so" in maps.read()
import torch
print(torch.linalg.solve(torch.eye(2) * 2.0, torch.ones(2)).tolist())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems load libraries in their own way")
def test_torch_finds_its_libraries_loaded():
    ran = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.strip() == "[0.5, 0.5]"


class Driver:
    """A driver that notes what is asked of it."""

    def __init__(self, gpus):
        self.calls, self.gpus = [], gpus

    def cuInit(self, flags):
        self.calls.append("init")
        return 0

    def cuDeviceGet(self, gpu, number):
        self.calls.append(number)
        return 0 if number < self.gpus else 101

    def cuDevicePrimaryCtxRetain(self, context, gpu):
        self.calls.append("context")
        return 0


@pytest.fixture
def driver(monkeypatch):
    """A driver of two GPUs, on a machine on which torch was not imported yet."""
    made = Driver(gpus=2)
    monkeypatch.setattr(early_libraries.ctypes, "CDLL", lambda name: made if name else SimpleNamespace())
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    monkeypatch.setattr(early_libraries.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(early_libraries.sys, "platform", "linux")
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    return made


@pytest.mark.parametrize(
    ("device", "words", "calls"),
    [
        (None, [], ["init", 0, "context"]),
        ("cuda", ["--num-envs", "8"], ["init", 0, "context"]),
        ("cuda:1", [], ["init", 1, "context"]),
        ("cuda:2", [], ["init", 2]),
        ("cpu", [], []),
        ("cuda:x", [], []),
        (None, ["--gpus", "2"], []),
        (None, ["--sweep=file.yaml"], []),
    ],
)
def test_the_gpu_that_the_command_uses_gets_its_context(driver, device, words, calls):
    """A process that starts others must not take the memory of a context, which is half a gigabyte."""
    early_libraries.load_early(device, words)
    for thread in threading.enumerate():
        if thread.name.startswith("stripe-newton"):
            thread.join()
    assert driver.calls == calls


def test_a_rank_of_several_chooses_its_gpu_itself(driver, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    early_libraries.load_early(None, [])
    assert driver.calls == []


def test_without_a_driver_there_is_nothing_to_do(monkeypatch):
    def fail(name):
        raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", fail)
    assert early_libraries._context_maker(0) is None
