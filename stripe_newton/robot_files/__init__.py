# SPDX-License-Identifier: Apache-2.0
"""URDF and MJCF files: read into a model builder as they are written, with a report, or refused by name."""

from .error import RobotFileError
from .file_kind import FileKind, file_kind
from .importing import extend_report, import_robot_file, inspect_robot_file
from .mjcf_actuators import ActuatorRow, actuator_rows, actuator_table
from .mjcf_checks import compile_mjcf
from .mjcf_stage import mjcf_stage
from .model_names import rename_model, split_links

__all__ = [
    "ActuatorRow",
    "FileKind",
    "RobotFileError",
    "actuator_rows",
    "actuator_table",
    "compile_mjcf",
    "extend_report",
    "file_kind",
    "import_robot_file",
    "inspect_robot_file",
    "mjcf_stage",
    "rename_model",
    "split_links",
]
