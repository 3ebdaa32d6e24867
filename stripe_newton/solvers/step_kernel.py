# SPDX-License-Identifier: Apache-2.0
"""Step kernel: the time step of all worlds of a model as one Warp kernel, from C++ source and the model's tables."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import warp as wp
from mujoco_warp import OverflowType

import stripe_kernels
from stripe_newton.generated_files import write_generated

from .model_tables import PARAMETERS, ModelTables

__all__ = ["OUTPUTS", "STATE", "KernelOptions", "StepKernel", "step_kernel"]

_SOURCES = ("algebra.h", "dynamics.h", "constraints.h", "collision.h", "newton.h", "step.h")
STATE = ("qpos", "qvel", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")
"""Arrays of the state in MuJoCo Warp's data, ``(num_worlds, ...)``; the first three are written, too."""
OUTPUTS = ("nefc", "solver_niter", "overflow", "qfrc_actuator")
"""Arrays of results in MuJoCo Warp's data: constraint rows, iterations, what did not fit, forces of actuators."""
_OVERFLOW = {"ROWS": OverflowType.NEFC, "CONTACTS": OverflowType.NARROWPHASE}
"""Bits that MuJoCo Warp reports for what did not fit."""
_SHARED_BYTES = 48 * 1024
"""Shared memory that a block may have without a driver call, on every GPU [bytes]."""
_SM_BYTES, _SM_THREADS = 227 * 1024, 768
"""Shared memory of a multiprocessor of an H100, and the threads for which it should have registers."""


@dataclass(frozen=True)
class KernelOptions:
    """Options of the step that are constants of the kernel."""

    lanes: int = 1
    """Threads that share a world: 1, or the 32 of a warp."""
    double: bool = False
    """Double precision, to test the source against MuJoCo's C."""
    tolerance: float = 1e-6
    iterations: int = 100
    ls_iterations: int = 50
    given_contacts: bool = False
    """Contacts come from the caller, rather than from the collision routines of the kernel."""


@dataclass(frozen=True)
class StepKernel:
    """The compiled step of a model."""

    kernel: wp.Kernel
    arguments: type
    """Struct of the addresses that it takes; see :func:`step_kernel`."""
    options: KernelOptions
    worlds_per_block: int
    in_shared: bool
    """Whether the state of a world is in shared memory; otherwise the caller gives a workspace."""

    def launch(self, arguments: object, num_worlds: int, device: str) -> None:
        """Launch it for ``num_worlds`` worlds."""
        lanes, per_block = self.options.lanes, self.worlds_per_block
        blocks = -(-num_worlds // per_block)
        dim = num_worlds if lanes == 1 else blocks * per_block * lanes
        block = 256 if lanes == 1 else per_block * lanes
        wp.launch(self.kernel, dim=dim, inputs=[arguments, num_worlds], device=device, block_dim=block)


def step_kernel(tables: ModelTables, options: KernelOptions) -> StepKernel:
    """Write the kernel of a model.

    Its argument is a struct. For each array of the state and of :data:`PARAMETERS` it has the address ``name`` (uint64)
    and the stride from one world to the next ``name_stride`` (in numbers; 0 for one that all worlds share).
    """
    per_block = 1 if options.lanes == 1 else max(1, min(4, _SHARED_BYTES // max(1, tables.world_bytes(4))))
    in_shared = options.lanes > 1 and tables.world_bytes(4) <= _SHARED_BYTES
    text = _python_source(tables, options, per_block, in_shared)
    module = _module(text)
    return StepKernel(module.step_worlds, module.Arguments, options, per_block, in_shared)


def _library(tables: ModelTables, options: KernelOptions) -> str:
    folder = Path(stripe_kernels.__file__).parent / "fused"
    sources = {name: (folder / name).read_text() for name in _SOURCES}
    exact = 1e-14 if options.double else 1e-6
    head = [
        *(["#define FUSED_DOUBLE"] if options.double else []),
        f"#define LANES {options.lanes}",
        f"#define TOLERANCE ((real){options.tolerance!r})",
        f"#define MAX_ITERATIONS {options.iterations}",
        f"#define LINE_STEPS {options.ls_iterations}",
        *(f"#define OVERFLOW_{name} {int(bit)}" for name, bit in _OVERFLOW.items()),
        f"#define LINE_TOLERANCE ((real){exact!r})",
    ]
    parts = ["\n".join(head) + "\n", sources["algebra.h"], tables.source, *(sources[n] for n in _SOURCES[1:])]
    return "".join(parts)


def _python_source(tables: ModelTables, options: KernelOptions, per_block: int, in_shared: bool) -> str:
    arrays = [*STATE, *PARAMETERS, "contacts"]
    fields = [f"    {name}: wp.uint64\n    {name}_stride: int\n" for name in arrays]
    fields += [f"    {name}: wp.uint64\n" for name in (*OUTPUTS, "contact_count", "workspace")]
    # The body of a native function stands in braces: the first one closes them, and so makes room for a library.
    library = f"}}\n{_library(tables, options)}\nstatic CUDA_CALLABLE inline void fused_library_end() {{\n"
    bounds = ""
    if in_shared:  # as many registers as leave room for all blocks whose worlds fit into the shared memory
        threads = per_block * options.lanes
        blocks = min(_SM_BYTES // (per_block * tables.world_bytes(4)), _SM_THREADS // threads)
        bounds = f", launch_bounds=({threads}, {max(1, blocks)})"
    return "\n".join(
        [
            "import warp as wp",
            "@wp.struct",
            "class Arguments:",
            *fields,
            f"@wp.func_native({library!r})",
            "def library(): ...",
            f"@wp.func_native({_body(options, per_block, in_shared)!r})",
            "def step_world(tid: int, m: Arguments, num_worlds: int): ...",
            f"@wp.kernel(enable_backward=False{bounds})",
            "def step_worlds(m: Arguments, num_worlds: int):",
            "    library()",
            "    step_world(wp.tid(), m, num_worlds)",
            "",
        ]
    )


def _body(options: KernelOptions, per_block: int, in_shared: bool) -> str:
    """Source that finds the world of a thread, takes its state in, steps it and writes its state out."""
    lanes = options.lanes
    lines = [f"const int lane = tid % {lanes}, id = tid / {lanes};", "if (id >= num_worlds) return;"]
    if in_shared:
        lines += ["#ifdef __CUDA_ARCH__", f"__shared__ fused::World worlds[{per_block}];"]
        lines += [
            f"fused::World& w = worlds[(threadIdx.x / {lanes}) % {per_block}];",
            "#else",
            "fused::World w;",
            "#endif",
        ]
    elif lanes > 1:
        lines.append("fused::World& w = ((fused::World*)m.workspace)[id];")
    else:
        lines.append("fused::World w;")
    of_world = "(real*)m.{0} + (long long)id * m.{0}_stride"
    lines += [f"real *{n} = {of_world.format(n)};" for n in STATE]
    parameters = ", ".join(of_world.format(n) for n in PARAMETERS)
    contacts = of_world.format("contacts") if options.given_contacts else "(const real*)0"
    count = "((int*)m.contact_count)[id]" if options.given_contacts else "0"
    lines += [
        f"const fused::Parameters P = {{{parameters}}};",
        "EACH(i, NQ) w.q[i] = qpos[i];",
        "EACH(i, NV) w.v[i] = qvel[i], w.a[i] = qacc_warmstart[i];",
        "SYNC();",
        "real* qfrc_actuator = m.qfrc_actuator ? (real*)m.qfrc_actuator + (long long)id * NV : (real*)0;",
        "const fused::Results out = {(int*)m.nefc + id, (int*)m.solver_niter + id, (int*)m.overflow + id,",
        "                            qfrc_actuator};",
        f"fused::step(w, P, ctrl, qfrc_applied, xfrc_applied, {contacts}, {count}, out, lane);",
        "EACH(i, NQ) qpos[i] = w.q[i];",
        "EACH(i, NV) qvel[i] = w.v[i], qacc_warmstart[i] = w.a[i];",
    ]
    return "\n" + "\n".join(lines) + "\n"


def _module(text: str) -> ModuleType:
    """The text as a module. Warp reads the source of kernels from a file, and caches what it compiled by content."""
    name = f"stripe_fused_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    path = write_generated(f"{name}.py", text)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
