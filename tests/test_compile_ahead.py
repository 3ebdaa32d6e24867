# SPDX-License-Identifier: Apache-2.0
"""Compiling ahead: kernels run as always, several are compiled at once, and errors come at the launch."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from stripe_newton import compile_ahead as module_under_test
from stripe_newton.compile_ahead import compile_ahead, wait_for
from tests.helpers.forked import run_forked


def _kernel(folder: Path, line: str) -> wp.Kernel:
    """A kernel of its own module, new in each test."""
    name = f"ahead_{folder.name}"
    head = f"import warp as wp\n@wp.kernel(module='unique')\ndef {name}(x: wp.array[float]):\n"
    text = f"{head}    i = wp.tid()\n    {line}\n"
    path = folder / f"{name}.py"
    path.write_text(text)
    space = {"__name__": name}
    exec(compile(text, str(path), "exec"), space)
    kernel = space[name]
    assert isinstance(kernel, wp.Kernel)
    return kernel


@pytest.fixture(autouse=True)
def cores(monkeypatch):
    monkeypatch.setattr(module_under_test.os, "cpu_count", lambda: 4)


def _launch(kernel: wp.Kernel) -> list[float]:
    x = wp.zeros(3, dtype=float, device="cpu")
    wait_for(kernel)
    wp.launch(kernel, dim=3, inputs=[x], device="cpu")
    return np.asarray(x.numpy()).tolist()


def test_a_kernel_runs_after_it_was_compiled_in_a_thread(tmp_path, monkeypatch):
    threads, load = [], wp.force_load
    monkeypatch.setattr(wp, "force_load", lambda *a, **k: (threads.append(threading.current_thread()), load(*a, **k)))
    kernel = _kernel(tmp_path, "x[i] = float(i) * 2.0")
    compile_ahead(kernel, 128, "cpu")
    compile_ahead(kernel, 128, "cpu")  # once is enough
    assert _launch(kernel) == [0.0, 2.0, 4.0]
    assert len(threads) == 1
    assert threads[0] is not threading.main_thread()
    compile_ahead(kernel, 128, "cpu")  # nor is one compiled that is loaded
    assert kernel.module not in module_under_test._running


def test_a_launch_waits(tmp_path, monkeypatch):
    may_go_on = threading.Event()
    monkeypatch.setattr(module_under_test, "_compile", lambda module, device: may_go_on.wait(10.0))
    kernel = _kernel(tmp_path, "x[i] = 1.0")
    compile_ahead(kernel, 128, "cpu")
    timer = threading.Timer(0.2, may_go_on.set)
    timer.start()
    wait_for(kernel)
    assert may_go_on.is_set()
    timer.join()


def test_an_error_is_that_of_the_launch(tmp_path):
    kernel = _kernel(tmp_path, "x[i] = unknown_function(i)")
    compile_ahead(kernel, 128, "cpu")
    with pytest.raises(Exception, match="unknown_function"):
        _launch(kernel)


def test_a_forked_process_does_not_wait_for_threads_that_it_has_not(tmp_path, monkeypatch):
    """It has a pool that believes in its threads, and what they compile would never end there."""
    may_go_on = threading.Event()
    monkeypatch.setattr(module_under_test, "_compile", lambda module, device: may_go_on.wait(10.0))
    kernel = _kernel(tmp_path, "x[i] = 3.0")
    compile_ahead(kernel, 128, "cpu")

    def launch_and_compile() -> int:
        wait_for(kernel)
        compile_ahead(kernel, 128, "cpu")
        return 7 if kernel.module in module_under_test._running else 8

    code = run_forked(launch_and_compile)
    may_go_on.set()
    wait_for(kernel)
    assert code == 7
