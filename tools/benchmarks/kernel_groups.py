# SPDX-License-Identifier: Apache-2.0
"""Kernel groups: the kernels of a training's iteration by what they do, with what bounds each group."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

__all__ = ["Kernel", "groups_table"]

Kernel = tuple[float, int, str]
"""Microseconds, launches and name."""

_PRODUCTS = "gemm|gemv|cutlass|splitK|nvjet|xmma"
_GROUPS = {
    "rollout": {
        "physics": ("step_worlds", "the solver"),
        "terminations, rewards, resets, observations": (
            "^step_|_contacts|finish_log|^reset_|drive_joints|forward_kinematics|eval_articulation|scan_",
            "fetching code",
        ),
        "policy, and values of all steps at once": (f"{_PRODUCTS}|elu", "latency"),
        "sampling, storage, checks, sums of episodes": ("", "latency"),
    },
    "update": {
        "gradient through ELU, sums for biases": ("elu_gradient|reduce_kernel<128, 4", "bytes: two read, one written"),
        "matrix products": (_PRODUCTS, "bytes"),
        "ELU": ("elu", "bytes: each activation is read and written"),
        "gathering observations": ("gather", "bytes, in rows of 192"),
        "losses and their gradients": ("ppo_loss", "latency"),
        "norms, learning rate, Adam": ("adam|adapt_rate|NormTwo", "latency"),
        "casts": ("bfloat16_copy|direct_copy|LoadWithCast", "latency"),
        "permutation, random numbers, normalisers, the rest": ("", "latency"),
    },
}
"""Part of an iteration, and group: an expression for the names of its kernels, and what bounds it. The first counts."""


def groups_table(cases: Mapping[str, Mapping[str, Sequence[Kernel]]]) -> str:
    """Table of the groups in Markdown.

    Args:
        cases: Kernels by case, such as ``"graph tf32"``, and by part of the iteration: ``"rollout"`` or ``"update"``.
    """
    columns = " | ".join(f"{case} | kernels" for case in cases)
    lines = [f"| | | {columns} | bound by |", "|---|---|" + "---:|---:|" * len(cases) + "---|"]
    for part, groups in _GROUPS.items():
        sums = [_sums(kernels.get(part, ()), groups) for kernels in cases.values()]
        for group, (_, bound) in groups.items():
            cells = " | ".join(f"{us[group] / 1e3:.2f} ms | {count[group]}" for us, count in sums)
            lines.append(f"| {part} | {group} | {cells} | {bound} |")
    return "\n".join(lines)


def _sums(kernels: Sequence[Kernel], groups: Mapping[str, tuple[str, str]]) -> tuple[dict[str, float], dict[str, int]]:
    times, counts = dict.fromkeys(groups, 0.0), dict.fromkeys(groups, 0)
    for us, count, name in kernels:
        group = next(group for group, (pattern, _) in groups.items() if re.search(pattern, name))
        times[group] += us
        counts[group] += count
    return times, counts
