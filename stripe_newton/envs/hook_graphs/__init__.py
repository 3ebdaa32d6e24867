# SPDX-License-Identifier: Apache-2.0
"""Hook graphs: torch hooks of direct environments, recorded as CUDA graphs where a replay gives what the hook gives."""

from .env_rows import EnvRows
from .hook_recorder import HookGraphError, HookRecorder
from .recorded_hook import RecordedHook
from .recording_context import HookGraph, Launched

__all__ = ["EnvRows", "HookGraph", "HookGraphError", "HookRecorder", "Launched", "RecordedHook"]
