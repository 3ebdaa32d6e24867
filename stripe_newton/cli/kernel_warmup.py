# SPDX-License-Identifier: Apache-2.0
"""Kernel warm-up: the first time on a machine, compiles the large kernel modules of the libraries in several processes.

Warp compiles a module when its first kernel is launched, one after the other, which takes most of a first start. Here
processes compile them side by side into Warp's kernel cache, from which the command then loads them. They begin while
the command still imports its libraries.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import importlib
import importlib.metadata
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from .end_signals import is_one_of_several
from .kernel_cache import cache_folder, is_read_only

__all__ = ["MODULES", "compile_modules", "start_early", "warm_up"]

MODULES = {
    "newton._src.solvers.mujoco.kernels": 4.0,
    "newton._src.sim.articulation": 2.5,
    "mujoco_warp._src.smooth": 2.4,
    "newton._src.geometry.inertia": 1.0,
    "mujoco_warp._src.set_const": 0.7,
    "newton._src.geometry.bvh": 0.7,
    "stripe_kernels.mujoco_model": 0.4,
    "stripe_kernels.actuators": 0.4,
    "stripe_kernels.sensors.contact": 0.4,
    "stripe_kernels.ppo": 0.4,
    "stripe_kernels.rollout": 0.3,
    "stripe_kernels.env_rows": 0.3,
    "stripe_kernels.adam": 0.2,
    "stripe_kernels.actuation": 0.2,
    "stripe_kernels.episode": 0.2,
}
"""Modules that every task needs, with the seconds that they take to compile."""
_OWN_MODULES = {
    "newton._src.geometry.inertia": ("validate_and_correct_inertia_kernel", "compute_body_inverses_kernel"),
}
"""Kernels that have a Warp module of their own, by the Python module that defines them."""
_BLOCK_DIMS = {
    "newton._src.sim.articulation": (8, 16),
    "stripe_kernels.ppo": (64,),
    "stripe_kernels.rollout": (64,),
}
"""Sizes of the blocks that a module is launched in on a GPU, each of which is compiled, if not Warp's own. Newton takes
16 for articulations of few joints."""
_MOST_WORKERS = 8
"""Most processes that compile: the largest module takes as long as the shares of so many."""


_early: subprocess.Popen[bytes] | None = None
"""The process that :func:`start_early` has started."""


def start_early(device: str | None) -> None:
    """Begin the warm-up in a process of its own, if this machine seems to need it; :func:`warm_up` waits for it.

    Called before Warp is imported, so it only looks for the files that an earlier warm-up has left.

    Args:
        device: ``"cpu"``, ``"cuda:N"``, or None for the device that a command takes by default.
    """
    global _early
    # Ranks wait for each other, one of them compiles. On a single core nothing is gained.
    if is_one_of_several() or (os.cpu_count() or 1) < 2 or _early is not None:
        return
    guess = device or ("cuda:0" if Path("/proc/driver/nvidia/version").exists() else "cpu")
    folder = cache_folder()
    kind = "cpu" if guess == "cpu" else "sm*"
    if folder is None or any(folder.glob(f"stripe_newton_{_versions()}_{kind}.warm")) or is_read_only(folder):
        return
    _early = subprocess.Popen([sys.executable, "-m", "stripe_newton.cli.kernel_warmup", "--all", guess])
    atexit.register(_end_early)


def _end_early() -> None:
    """End a warm-up that nobody waits for any more, as after a wrong option."""
    if _early is not None and _early.poll() is None:
        _early.terminate()


def warm_up(device: str, out: TextIO | None = None) -> bool:
    """Compile the modules for a device, unless that was done before. Returns whether it was necessary.

    A process that fails is left alone: the command then compiles what is missing, and says what is wrong.

    Args:
        device: ``"cpu"`` or ``"cuda:N"``.
        out: Stream for the progress; by default the standard error.
    """
    import warp as wp  # here, as --help needs it not

    from .kernel_lock import hold_cache  # likewise

    wp.init()  # after which the folder of the cache is known
    if _early is not None:
        _early.wait()
    stamp = Path(str(wp.config.kernel_cache_dir)) / f"stripe_newton_{_versions()}_{_architecture(device)}.warm"
    shares = _shares(min(os.cpu_count() or 1, _MOST_WORKERS))
    if stamp.exists() or len(shares) < 2 or is_read_only(stamp.parent):
        return False
    # Of several commands that start at once one compiles, in as many processes as the machine has room for.
    with hold_cache(stamp.with_suffix(".lock"), "the kernels that every task needs"):
        if stamp.exists():
            return False
        if _compile_all(device, shares, out or sys.stderr):
            with contextlib.suppress(OSError):
                stamp.touch()
    return True


def _compile_all(device: str, shares: Sequence[Sequence[str]], out: TextIO) -> bool:
    """Compile shares of the modules, each in a process. Returns whether all ended well."""
    command = [sys.executable, "-m", "stripe_newton.cli.kernel_warmup", device]
    words = [" ".join(share) for share in shares]
    # Forked processes share the imports, which take as long as the compiling. Elsewhere a fork is not safe.
    programs = [words] if sys.platform == "linux" else [[word] for word in words]
    workers = [
        subprocess.Popen(
            [*command, *program],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # so that those that it forks can be ended with it
        )
        for program in programs
    ]
    try:
        return _follow(workers, len(shares), out)
    except BaseException:
        for worker in workers:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(worker.pid, signal.SIGKILL)
        raise


def _follow(workers: Sequence[subprocess.Popen[str]], count: int, out: TextIO) -> bool:
    """Show how many modules are done until all workers have ended. Returns whether all ended well."""
    began, total, done = time.perf_counter(), len(MODULES), 0
    title = f"compiling kernels in {count} processes, once for this machine"
    if not out.isatty():
        print(title, file=out, flush=True)
    for worker in workers:
        os.set_blocking(worker.stdout.fileno(), False)  # type: ignore[union-attr]  # it is a pipe
    while any(worker.poll() is None for worker in workers):
        done += sum(line.startswith("compiled ") for worker in workers for line in worker.stdout or ())
        if out.isatty():
            bar = "#" * round(20 * done / total)
            print(f"\r{title} [{bar:<20}] {time.perf_counter() - began:.0f} s ", end="", file=out, flush=True)
        time.sleep(0.2)
    print(f"{chr(13) if out.isatty() else ''}{title}: {time.perf_counter() - began:.0f} s{' ' * 24}".rstrip(), file=out)
    return all(worker.returncode == 0 for worker in workers)


def _shares(count: int) -> list[list[str]]:
    """The modules in shares of about the same time, the longest first."""
    shares: list[list[str]] = [[] for _ in range(count)]
    for name, _ in sorted(MODULES.items(), key=lambda item: -item[1]):
        min(shares, key=lambda share: sum(MODULES[n] for n in share)).append(name)
    return [share for share in shares if share]


def _versions() -> str:
    """Versions of the libraries, and a digest of what is compiled of them and how."""
    what = repr((MODULES, _OWN_MODULES, _BLOCK_DIMS, os.environ.get("STRIPE_NEWTON_GRADIENTS")))
    libraries = [importlib.metadata.version(name) for name in ("warp-lang", "newton", "mujoco-warp")]
    return "_".join([*libraries, hashlib.sha256(what.encode()).hexdigest()[:8]])


def _architecture(device: str) -> str:
    import warp as wp

    return "cpu" if device == "cpu" else f"sm{wp.get_device(device).arch}"


def _is_there(device: str) -> bool:
    """Whether this machine has a device, by Warp."""
    import warp as wp  # here, as start_early must not import it

    wp.init()
    return device in [str(found) for found in wp.get_devices()] or (device == "cuda" and wp.is_cuda_available())


def compile_shares(device: str, shares: Sequence[Sequence[str]]) -> bool:
    """Compile each share in a process of its own, forked when all is imported. Returns whether all ended well.

    Warp is imported and not initialised when it forks: a CUDA driver that was initialised before would be of no use.
    """
    from .quick_imports import skip_module_references  # here, as the parent process needs it not

    skip_module_references()
    for name in (name for share in shares for name in share):
        importlib.import_module(name)
    forked = []
    for share in shares[1:]:
        process = os.fork()
        if process == 0:
            code = 1
            try:
                compile_modules(device, share)
                code = 0
            finally:
                os._exit(code)
        forked.append(process)
    compile_modules(device, shares[0])
    failed = [os.waitpid(process, 0)[1] for process in forked]
    return not any(failed)


def compile_modules(device: str, names: Sequence[str]) -> None:
    """Compile modules and print the name of each that is done: the part of one process."""
    import warp as wp  # here, as the parent process needs it not

    from stripe_newton.forward_only import leave_out_gradients  # likewise: it imports Warp

    wp.config.log_level = wp.LOG_WARNING
    for name in names:
        python_module = importlib.import_module(name)
        leave_out_gradients()
        block_dims = (1,) if device == "cpu" else _BLOCK_DIMS.get(name, (256,))
        wanted = [(wp.get_module(name), device, block_dim) for block_dim in block_dims]
        for kernel in _OWN_MODULES.get(name, ()):
            module = getattr(python_module, kernel).module
            # Also for the CPU: masses of a file are checked there, whatever the device of the simulation.
            wanted += [(module, "cpu", 1)] + [(module, device, 256)] * (device != "cpu")
        for module, where, block_dim in wanted:
            # Compiled and not loaded: loading would make a context on the GPU in each of the processes.
            module.options["block_dim"] = block_dim
            module.mark_modified()
            wp.compile_aot_module(module, where)
        print(f"compiled {name}", flush=True)


def main(words: Sequence[str]) -> None:
    """``--all DEVICE``: the whole warm-up, with its progress; ``DEVICE SHARE ...``: shares, in a process each.

    A share is the names of its modules with spaces between.
    """
    if words[0] != "--all":
        sys.exit(0 if compile_shares(words[0], [share.split() for share in words[1:]]) else 1)
    from .compile_log import CompileLog  # here, as the parts need neither
    from .end_signals import end_on_signals

    end_on_signals(quietly=True)  # the command that has started it says what there is to say
    with contextlib.suppress(KeyboardInterrupt):
        try:
            CompileLog.install()
        except OSError:  # no folder for the kernels: the command says so
            sys.exit(1)
        if not _is_there(words[1]):  # the command says so
            sys.exit(1)
        warm_up(words[1])


if __name__ == "__main__":
    main(sys.argv[1:])
