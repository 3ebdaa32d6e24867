# SPDX-License-Identifier: Apache-2.0
"""USD stages that others wrote: read into a model builder, refused with a reason, reported on."""

from .extras import read_lights, read_semantics
from .lights import Light
from .loading import inspect_stage, load_stage
from .report import StageReport
from .report_build import joint_rows
from .stage import StageError, asset_prim, open_stage
from .trial import StageTrial, try_stage
from .units import si_stage

__all__ = [
    "Light",
    "StageError",
    "StageReport",
    "StageTrial",
    "asset_prim",
    "inspect_stage",
    "joint_rows",
    "load_stage",
    "open_stage",
    "read_lights",
    "read_semantics",
    "si_stage",
    "try_stage",
]
