# SPDX-License-Identifier: Apache-2.0
"""Lane emulator: the fused step as a GPU computes it, by lanes that share a world, on a CPU.

A lane is a context of its own that runs until it waits for the others; then the next one goes on. So a barrier is one
turn of all lanes, and what they tell each other goes through memory between two turns. This shows errors of the code
for lanes that a thread a world does not have. A race shows if lanes take their turns in the opposite order.

In the form for a hub with limbs the worlds of a warp stay together, so that all lanes of a warp take turns, with its
worlds side by side as in shared memory. Otherwise it is the lanes of one world.
"""

from __future__ import annotations

import ctypes
import dataclasses
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from stripe_newton.solvers import SolverFused, step_kernel, step_launcher
from stripe_newton.solvers.model_tables import ModelTables
from stripe_newton.solvers.step_kernel import KernelOptions, Layout

_PRELUDE = """
#include <cstring>
#include <math.h>
#include <ucontext.h>
#define __CUDA_ARCH__ 900
#define __device__
#define __forceinline__ inline
#define __noinline__ __attribute__((noinline))
#define __fdividef(a, b) ((a) / (b))
#define COPY_ASYNC(to, from) *(to) = *(from)
#define AWAIT_COPIES()
#define __popc __builtin_popcount
#define __ffsll __builtin_ffsll
#define __shared__
#define rsqrtf(x) (1 / sqrtf(x))
enum { EMULATED = %d };
struct Index { int x; };
static Index threadIdx, blockIdx = {1 << 20}, blockDim = {EMULATED};
static int lanes_there = EMULATED;  // those of worlds that are missing have left
static int backwards;  // whether the last lane takes its turn first
static int lane_after(int own) { return (own + (backwards ? lanes_there - 1 : 1)) %% lanes_there; }
static void __syncthreads() {}
static ucontext_t contexts[EMULATED], caller;
static void take_turns() {
    int own = threadIdx.x, next = lane_after(own);
    threadIdx.x = next;
    swapcontext(&contexts[own], &contexts[next]);
}
static void __syncwarp(unsigned) { take_turns(); }
static unsigned char told[EMULATED][8];
template <class T> static T hear(T own, int from) {
    T heard;
    memcpy(told[threadIdx.x], &own, sizeof(T));
    take_turns();
    memcpy(&heard, told[from], sizeof(T));
    take_turns();
    return heard;
}
template <class T> static T __shfl_sync(unsigned, T x, int from, int width) {
    return hear(x, threadIdx.x / width * width + from %% width);
}
template <class T> static T __shfl_xor_sync(unsigned, T x, int mask, int) { return hear(x, threadIdx.x ^ mask); }
template <class T> static T __shfl_up_sync(unsigned, T x, int by, int width) {
    return hear(x, threadIdx.x %% width >= by ? threadIdx.x - by : threadIdx.x);
}
static unsigned __ballot_sync(unsigned, int holds) {
    unsigned votes = 0;
    told[threadIdx.x][0] = holds != 0;
    take_turns();
    for (int i = 0; i < lanes_there; i++) votes |= (unsigned)told[i][0] << i;
    take_turns();
    return votes;
}
static int __any_sync(unsigned, int holds) { return __ballot_sync(0, holds) != 0; }
static unsigned __float_as_uint(float x) { unsigned bits; memcpy(&bits, &x, 4); return bits; }
static int atomicOr(int* to, int bits) { int was = *to; return *to |= bits, was; }
static void atomicOr(unsigned long long* to, unsigned long long bits) { *to |= bits; }
static int atomicAdd(int* to, int x) { int was = *to; return *to += x, was; }
template <class T> static void atomicMin(T* to, T x) { if (x < *to) *to = x; }
"""
_RUN = """
enum { WORLDS = EMULATED / LANES };
#if IN_SHARED
namespace fused {
alignas(16) char dynamic_smem_base[sizeof(Tables) + WORLDS_PER_BLOCK * sizeof(World) + 4 * WARP_SEARCHES_SIZE];
}
#endif
static fused::World* worlds_there;
static const Arguments* arguments;
static int first_world, num_worlds, steps;
static char stacks[EMULATED][1 << 18];
static void lane_of_world() {
    const int own = threadIdx.x, lane = own % LANES, at = own / LANES;
    fused::World& world = worlds_there[at];
    const fused::Parameters P{*arguments, first_world + at, num_worlds};
    fused::begin_steps(world, P, lane);
    for (int left = steps; left >= 0; left--) {
#if HAS_NEWTON
        if (left == 1) fused::begin_last_step(world, P, lane);
#endif
        fused::step(world, P, 0, 0, left, lane);
    }
    fused::end_steps(world, P, lane);
    threadIdx.x = lane_after(own);
}
extern "C" void run(const Arguments* m, int worlds, int count, real* spill, int spill_size, int is_backwards,
                    float before) {
    backwards = is_backwards;
#if IN_SHARED
    fused::tables() = fused::given_tables;
    worlds_there = (fused::World*)(fused::dynamic_smem_base + sizeof(fused::Tables));
#else
    worlds_there = new fused::World[WORLDS];
#endif
    arguments = m, num_worlds = worlds, steps = count;
    for (first_world = 0; first_world < worlds; first_world += WORLDS) {
        lanes_there = LANES * (worlds - first_world < WORLDS ? worlds - first_world : WORLDS);
        for (unsigned i = 0; i < WORLDS * sizeof(fused::World) / 4; i++) ((float*)worlds_there)[i] = before;
#if !LIMBS
        worlds_there->spill = spill + (long long)first_world * spill_size;
#endif
        for (int i = 0; i < lanes_there; i++) {
            getcontext(&contexts[i]);
            contexts[i].uc_stack.ss_sp = stacks[i], contexts[i].uc_stack.ss_size = sizeof(stacks[i]);
            const int next = lane_after(i), start = backwards ? lanes_there - 1 : 0;
            contexts[i].uc_link = next == start ? &caller : &contexts[next];
            makecontext(&contexts[i], lane_of_world, 0);
        }
        threadIdx.x = backwards ? lanes_there - 1 : 0;
        swapcontext(&caller, &contexts[threadIdx.x]);
    }
#if !IN_SHARED
    delete[] worlds_there;
#endif
}
"""


@dataclasses.dataclass(frozen=True)
class EmulatedStep:
    """The fused step of a solver's model by some lanes."""

    solver: SolverFused
    layout: Layout
    run: Callable[..., None]
    struct: type[ctypes.Structure]

    def __call__(self, steps: int, backwards: bool = False, before: float = 0.0) -> None:
        """Advance the worlds of the solver, in MuJoCo's arrays, as one launch does.

        Args:
            steps: Number of physics steps.
            backwards: Let the lanes take their turns in the opposite order: results that differ show a race.
            before: What all memory of the kernel's own holds at first: results that differ show that it was read.
        """
        given = self.solver.launcher.arguments(self.solver._call)
        m = self.struct(**{name: kind(getattr(given, name)) for name, kind in self.struct._fields_})
        worlds = self.solver.mjw_data.nworld
        size = -(-self.layout.spill_size // 4) * 4  # rows are read as fours, as in `Layout.workspace_size`
        spill = np.full(worlds * max(4, size), before, dtype=np.float32)
        memory = spill.ctypes.data_as(ctypes.POINTER(ctypes.c_float))
        self.run(ctypes.byref(m), worlds, steps, memory, size, backwards, ctypes.c_float(before))


def emulate(solver: SolverFused, lanes: int) -> EmulatedStep:
    """The step of a solver on the CPU by lanes that share a world; skips the test where there is no compiler.

    Args:
        solver: The solver, on the CPU, whose contacts are all found in the kernel.
        lanes: Number of lanes, a power of two.
    """
    made: list[tuple[ModelTables, KernelOptions]] = []

    def keep(tables: ModelTables, options: KernelOptions) -> step_kernel.StepKernel:
        made.append((tables, options))
        return step_kernel.step_kernel(tables, options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(step_launcher, "step_kernel", keep)
        solver.launcher.remake()
        assert solver.one_launch
    tables, options = made[-1]
    options = dataclasses.replace(options, lanes=lanes)
    layout = dataclasses.replace(Layout.of(tables, options), in_shared=tables.limbs is not None)
    source = step_kernel._library(tables, options, layout).replace(step_kernel._STRUCT, "Arguments")
    fields = [f"unsigned long long {n}; int {n}_stride;" for n in step_kernel._ARRAYS]
    fields += [f"unsigned long long {n};" for n in step_kernel._ADDRESSES] + ["float dt;"]
    arguments = "struct Arguments {" + "\n".join(fields) + "};\n"
    library = _compiled(_PRELUDE % (32 if layout.is_limbs else lanes) + arguments + source + _RUN)
    members: list[tuple[str, type]] = []
    for name in step_kernel._ARRAYS:
        members += [(name, ctypes.c_uint64), (f"{name}_stride", ctypes.c_int)]
    members += [*((name, ctypes.c_uint64) for name in step_kernel._ADDRESSES), ("dt", ctypes.c_float)]
    struct = type("Arguments", (ctypes.Structure,), {"_fields_": members})
    return EmulatedStep(solver, layout, library.run, struct)


@cache
def _compiled(source: str) -> ctypes.CDLL:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    name = hashlib.sha256(source.encode()).hexdigest()[:16]
    folder = Path(wp.config.kernel_cache_dir or tempfile.gettempdir()) / "stripe_lanes"
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{name}.so"
    if not target.exists():
        command = [compiler, "-O1", "-std=c++17", "-fPIC", "-shared", "-w", "-ffp-contract=off"]
        # Renamed when it is whole: other processes of the tests load it as soon as it is there.
        with tempfile.TemporaryDirectory(dir=folder) as made:
            (text := Path(made, f"{name}.cpp")).write_text(source)
            whole = text.with_suffix(".so")
            done = subprocess.run([*command, str(text), "-o", str(whole)], capture_output=True, text=True)
            assert done.returncode == 0, done.stderr[:3000]
            whole.replace(target)
    return ctypes.CDLL(str(target))


def rows_by_thread_and_lanes(solver: SolverFused, lanes: Callable[[int], object]) -> int:
    """Compute a step of a solver's state by a thread a world and by its :func:`emulate` ``lanes``, which must agree.

    Returns:
        The number of constraint rows of all worlds.
    """
    data, results = solver.mjw_data, []
    before = {name: getattr(data, name).numpy().copy() for name in ("qpos", "qvel", "qacc_warmstart")}
    for run in (
        lambda: solver.fused.launch(solver.launcher.arguments(solver._call), data.nworld, "cpu"),
        lambda: lanes(1),
    ):
        for name, value in before.items():
            getattr(data, name).assign(value)
        run()
        results.append((data.nefc.numpy().copy(), data.qvel.numpy().copy()))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_allclose(results[0][1], results[1][1], atol=1e-3)
    return int(results[0][0].sum())
