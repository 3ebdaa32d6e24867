# SPDX-License-Identifier: Apache-2.0
"""End signals: a command that is ended comes to an end, whatever its threads and native code do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from stripe_newton.cli import end_signals
from tests.helpers.checkout import PYTHONPATH

PROGRAM = """
import atexit, ctypes, os, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # which is ignored where the tests run in the background
sys.argv = ["stripe-newton", "stay"]
import stripe_newton.cli as cli
from stripe_newton.cli import end_signals
end_signals.GRACE_S = 1
cli.COMMANDS["stay"] = ("__main__", "")
sys.modules["__main__"].run = lambda argv: stay()
atexit.register(print, "exit functions were called")
{code}
sys.exit(cli.main())
"""
THREAD = """
from stripe_newton.thread_pool import ThreadPool
start, pool = threading.Thread.start, ThreadPool(1, "work")
def start_and_end(self):
    start(self)
    os.kill(os.getpid(), signal.{name})
threading.Thread.start = start_and_end
import stripe_newton.cli.end_signals as module
module._watch = lambda: None  # whose thread would be the first
def stay():
    pool.executor.submit(int).result()
"""
"""A thread pool that knows nothing of the thread that it has started waits for it without end."""
IMPORT = """
import importlib, pathlib, tempfile
folder = pathlib.Path(tempfile.mkdtemp())
(folder / "optional.py").write_text(
    "import os, signal\\n"
    "try:\\n    os.kill(os.getpid(), signal.{name})\\n    sum(range(1000))\\n"
    "except BaseException:\\n    raise ImportError('initialization failed')\\n"
    "print('imported')\\n"
)
sys.path.insert(0, str(folder))
def stay():
    import optional
    time.sleep(60.0)
"""
"""What a module raises while it is imported may be lost, or become another error."""
DESTRUCTOR = """
class Odd:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
def stay():
    Odd()
    time.sleep(60.0)
"""
NATIVE = """
def stay(library=ctypes.{library}(None)):
    lock = ctypes.create_string_buffer(64)  # a mutex of zeros is a new one
    {before}
    try:
        print("stays", flush=True)
        {wait}
    finally:
        for _ in range(2):
            library.pthread_mutex_lock(lock)
"""
"""Native code that waits for itself, with Python's lock (``PyDLL``) or without."""
CASES = {
    "native code": NATIVE.format(library="CDLL", before="library.pthread_mutex_lock(lock)", wait="pass"),
    "what cleans up": NATIVE.format(library="CDLL", before="", wait="time.sleep(60.0)"),
    "what cleans up, with Python's lock": NATIVE.format(library="PyDLL", before="", wait="time.sleep(60.0)"),
}


def _start(code: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", PROGRAM.format(code=code)]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, env=os.environ | {"PYTHONPATH": PYTHONPATH}, preexec_fn=_unignore
    )


def _unignore() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which the tests may be run with, under nohup


@pytest.mark.parametrize(("name", "code"), [("SIGHUP", 129), ("SIGINT", 130)])
def test_signal_while_a_pool_starts_a_thread(name, code):
    process = _start(THREAD.format(name=name))
    out, error = process.communicate(timeout=60.0)
    assert process.returncode == code, error
    assert out == "exit functions were called\n"


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_signal_in_an_import_is_put_off(name, code):
    process = _start(IMPORT.format(name=name))
    out, error = process.communicate(timeout=30.0)
    assert process.returncode == code, error
    assert out == "imported\nexit functions were called\n"
    assert "Traceback" not in error


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_signal_in_a_destructor_is_not_lost(name, code):
    process = _start(DESTRUCTOR.format(name=name))
    _, error = process.communicate(timeout=30.0)
    assert process.returncode == code, error
    assert "ignored" not in error


@pytest.mark.parametrize("case", list(CASES))
def test_stuck_command_is_cut_off(case):
    process = _start(CASES[case])
    assert process.stdout.readline() == "stays\n"
    began = time.monotonic()
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=60.0)
    # A thread of Python cannot end a process whose main thread keeps Python's lock: the system does.
    by_system = case.endswith("Python's lock")
    assert process.returncode == (-signal.SIGALRM if by_system else 143), error
    assert time.monotonic() - began > 0.9
    assert by_system or "no end within 1 s of SIGTERM" in error


def test_ctrl_c_while_the_program_is_loaded():
    code = """
    import os, signal, sys
    signal.signal(signal.SIGINT, signal.default_int_handler)
    from stripe_newton.__main__ import main

    class Finder:
        def find_spec(name, path, target=None):
            if name == "stripe_newton.cli":
                print(*sys.modules)
                sys.stdout.flush()
                os.kill(os.getpid(), signal.SIGINT)

    sys.meta_path.insert(0, Finder)
    main()
    """
    env = os.environ | {"PYTHONPATH": PYTHONPATH}
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], env=env, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (130, "interrupted\n")
    # Before that point Ctrl-C is Python's own: so nothing is imported there that takes long.
    loaded = set(run.stdout.split())
    own = {name for name in loaded if name.startswith("stripe_newton")}
    assert own == {"stripe_newton", "stripe_newton.moved_modules", "stripe_newton.__main__"}
    # Nor are these, unless Python's own start has loaded them.
    python = subprocess.run([sys.executable, "-c", "import sys; print(*sys.modules)"], capture_output=True, text=True)
    new = loaded - set(python.stdout.split())
    assert not {"typing", "dataclasses", "importlib.abc", "importlib.metadata", "torch", "yaml"} & new


def test_a_signal_that_waits_for_an_import_is_dropped_at_the_end(monkeypatch):
    called = []
    monkeypatch.setattr(end_signals, "_put_off_since", time.monotonic())
    end_signals._call_soon(lambda *_: called.append(True), signal.SIGTERM)
    end_signals.leave_signals()
    time.sleep(5 * end_signals._POLL_S)
    assert not called
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
