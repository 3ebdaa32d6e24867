# SPDX-License-Identifier: Apache-2.0
"""USD stages from any source: loaded into a model builder with a report, or refused with a reason."""

from .ignored_rows import Ignored, ignored_text
from .loading import check_content, inspect_stage, load_stage
from .prepare import converted, schema_typed
from .report_rows import joint_rows
from .semantic_labels import read_semantics
from .solver_errors import solver_reason
from .stage_access import StageError, asset_prim, labelled_prim, open_stage, stage_name
from .stage_lights import Light, read_lights
from .stage_report import JointRow, StageReport
from .stage_trial import StageTrial, try_stage
from .units import si_stage, to_si

__all__ = [
    "Ignored",
    "JointRow",
    "Light",
    "StageError",
    "StageReport",
    "StageTrial",
    "asset_prim",
    "check_content",
    "converted",
    "ignored_text",
    "inspect_stage",
    "joint_rows",
    "labelled_prim",
    "load_stage",
    "open_stage",
    "read_lights",
    "read_semantics",
    "schema_typed",
    "si_stage",
    "solver_reason",
    "stage_name",
    "to_si",
    "try_stage",
]
