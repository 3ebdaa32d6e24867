# SPDX-License-Identifier: Apache-2.0
"""Record of values of Isaac Lab's own functions, for tests on machines without its files.

    ISAACLAB_SOURCE=.../isaaclab/source python -m tests.helpers.isaaclab_record

calls Isaac Lab's ``utils.math`` with the arguments of :mod:`tests.helpers.isaaclab_math_cases`, and its terms in the
environment of :mod:`tests.helpers.isaaclab_terms`, and writes what they return to :data:`MATH` and :data:`TERM_VALUES`.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import torch

from tests.helpers.isaaclab_math_cases import CASES, SAMPLES, N, copies
from tests.helpers.isaaclab_source import isaaclab_modules
from tests.helpers.isaaclab_terms import TERMS, Bench
from tests.helpers.isaaclab_walker import put, walker_task

__all__ = ["MATH", "RECORDED_TERMS", "SEED", "TERM_VALUES", "prepare", "sampled"]

FOLDER = Path(__file__).parents[1] / "isaaclab" / "recorded"
MATH = FOLDER / "math.json"
"""Values by function, then by its cases."""
TERM_VALUES = FOLDER / "terms.json"
"""Values by term, one for each environment."""
SEED = 7
"""Seed of torch before each function that draws."""
ROWS = [0, 3, 5, 9, 21, 40]
"""Rows that are kept of results with one for each random quaternion."""
_OF_A_STEP = (
    "height_scan", "imu_", "joint_effort", "last_action", "time_s", "is_terminated", "lin_acc", "joint_torques",
    "joint_acc", "contact", "action_", "time_out", "command_resample",
)  # fmt: skip
"""Terms that only steps of the simulation, or actions, tell from zero."""
RECORDED_TERMS = [term for term in TERMS if not any(part in term for part in _OF_A_STEP)]
"""Terms whose value is that of the state."""


def sampled(value: object) -> list:
    """Numbers of a result: the :data:`ROWS` of those with a row for each quaternion, and all of others."""
    if isinstance(value, tuple):
        return [sampled(part) for part in value]
    if isinstance(value, bool):
        return [value]
    array = value.detach().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
    return (array[ROWS] if array.ndim and len(array) == N else array).tolist()


def prepare(bench: Bench) -> None:
    """Bring the environment in the state of the record."""
    bench.env.reset(seed=1)
    put(bench.env, seed=5)


def _rounded(value: object) -> object:
    if isinstance(value, list):
        return [_rounded(part) for part in value]
    return float(f"{value:.8g}") if isinstance(value, float) else value


def _record_math() -> dict[str, list]:
    found: dict[str, list] = {}
    with isaaclab_modules("isaaclab.utils.math") as (theirs,):
        for name, cases in [*CASES.items(), *SAMPLES.items()]:
            for arguments in cases:
                torch.manual_seed(SEED)
                value = getattr(theirs, name)(*copies(arguments))
                found.setdefault(name, []).append(_rounded(sampled(value)))
    return found


def _record_terms() -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder, walker_task(Path(folder)) as task:
        bench = Bench(task)
        prepare(bench)
        found = {term: _rounded(bench.value_of_isaac_lab(term).tolist()) for term in RECORDED_TERMS}
        bench.env.close()
        return found


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file, values in ((MATH, _record_math()), (TERM_VALUES, _record_terms())):
        lines = [f"{json.dumps(key)}: {json.dumps(value, separators=(',', ':'))}" for key, value in values.items()]
        file.write_text("{\n" + ",\n".join(lines) + "\n}\n")
