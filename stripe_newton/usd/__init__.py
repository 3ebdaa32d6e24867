# SPDX-License-Identifier: Apache-2.0
"""Reading USD stages that others wrote: load, refuse with a reason, report."""

from stripe_newton.scene.report import StageReport
from stripe_newton.scene.usd_import import StageError, asset_prim, inspect_stage, load_stage, read_lights, read_semantics
from stripe_newton.sim.lights import Light
from stripe_newton.scene.usd_stage import open_stage

__all__ = ["Light", "StageError", "StageReport", "asset_prim", "inspect_stage", "load_stage", "open_stage", "read_lights", "read_semantics"]
