# SPDX-License-Identifier: Apache-2.0
"""Step body: what a thread of the step's kernel does, as lines of C++."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stripe_kernels.actuators import (
    ask_solver_joint,
    drive_explicit_joint,
    feed_solver_joint,
    solver_drive,
    solver_feed,
)

if TYPE_CHECKING:
    from .step_kernel import KernelOptions, Layout

__all__ = ["PLACING", "advance", "find_world"]

_BEGIN = "fused::begin_steps(w, P, lane);"
PLACING = [_BEGIN, "fused::kinematics(w, P, lane);", "fused::write_geom_poses(w, P, lane);"]
"""Lines that only place bodies and geoms."""


def find_world(options: KernelOptions, layout: Layout) -> list[str]:
    """Source that finds the world of a thread, and the memory of its state."""
    lanes = options.lanes
    lines = ["fused::share_tables();"] if layout.in_shared else []
    lines += [f"const int lane = tid % {lanes}, id = tid / {lanes};", "if (id >= num_worlds) return;"]
    memory = f"((real*)m.workspace + (long long)id * {layout.workspace_size})"
    if layout.in_shared:
        lines += [
            "#ifdef __CUDA_ARCH__",
            "fused::World& w = fused::in_place();",
            "#else",
            "fused::World w;",
            "#endif",
            *([] if layout.is_limbs else [f"if (lane == 0) w.spill = {memory};"]),
        ]
    elif lanes > 1:
        lines.append(f"fused::World& w = *(fused::World*){memory};")
    else:
        lines.append("fused::World w;")
    return [*lines, "const fused::Parameters P{m, id, num_worlds};"]


def advance(options: KernelOptions) -> list[str]:
    """Source that advances the world by the steps of a launch."""
    contacts, count = ("P.contacts()", "((int*)m.contact_count)[id]") if options.given_contacts else ("0", "0")
    drive = f"[&](int dof, float q, float v) {{ return {drive_explicit_joint.native_func}(id, dof, q, v, drives); }}"
    feed = f"[&](int id, int dof) {{ return {feed_solver_joint.native_func}(id, dof, drives); }}"
    ask = f"[&](int id, int dof, float q, float v) {{ return {ask_solver_joint.native_func}(id, dof, q, v, drives); }}"
    # A launch may be without actuators.
    first = [f"if (drives.law.data) fused::give_efforts(w, P, {feed}, lane);"]
    each = [f"    if (left && drives.law.data) fused::drive_joints(w, fused::fresh(P), {drive}, lane);"]
    last = [f"        if (drives.law.data) fused::note_efforts(w, fused::fresh(P), {ask}, lane);"]
    has_solver_drives = "solver_drives" in options.per_step
    begin = [*(first if has_solver_drives else []), _BEGIN]
    if has_solver_drives:
        rows_begin, rows_last = _rows_of_drives()
        begin = ["#if ROWS_OF_DRIVES", *rows_begin, "#else", *begin, "#endif"]
        last = ["#if ROWS_OF_DRIVES", *rows_last, "#else", *last, "#endif"]
    return [
        *begin,
        "for (int left = steps; left >= 0; left--) {",
        *(each if "drives" in options.per_step else []),
        "#if HAS_NEWTON",
        "    if (left == 1) {",
        "        fused::begin_last_step(w, fused::fresh(P), lane);",
        *(last if has_solver_drives else []),
        "    }",
        "#endif",
        f"    fused::step(w, P, {contacts}, {count}, left, lane);",
        "}",
        "fused::end_steps(w, fused::fresh(P), lane);",
    ]


def _rows_of_drives() -> tuple[list[str], list[str]]:
    """Source for drives whose rows are copied into the state: the begin of a launch, and of its last step."""
    feed = f"{solver_feed.native_func}(drives.feeds_velocity, mode, kd, speed, effort, limit)"
    ask = f"{solver_drive.native_func}(mode, kp, kd, target, speed, effort, q, v)"
    numbers = [f"float {name}" for name in ("kd", "speed", "effort", "limit")]
    asked = [f"float {name}" for name in ("kp", "kd", "target", "speed", "effort", "q", "v")]
    begin = [
        "fused::begin_steps(w, P,",
        "    [&](const fused::Rows& r) { return fused::ask_efforts(r, P, drives); },",
        "    [&] { fused::give_asked_efforts(w, P,",
        f"        [&](int mode, {', '.join(numbers)}) {{ return {feed}; }}, lane); }}, lane);",
    ]
    last = [
        "        if (drives.law.data) fused::note_asked_efforts(w, fused::fresh(P), drives,",
        f"            [&](int mode, {', '.join(asked)}) {{ return {ask}; }}, lane);",
    ]
    return begin, last
