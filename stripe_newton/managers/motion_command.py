# SPDX-License-Identifier: Apache-2.0
"""Motion command: reads the reference motions of a command, and keeps the probabilities of where episodes begin."""

from __future__ import annotations

import numpy as np
import warp as wp

from stripe_kernels.data import CommandData
from stripe_kernels.motion import MotionCommandData, accumulate_probabilities, average_failures
from stripe_newton.assets import Articulation
from stripe_newton.fusion import Item, KernelLaunches
from stripe_newton.matching import match_names
from stripe_newton.motions import MotionError, MotionLibrary, find_motions, read_motion

from .commands_cfg import MotionCommandCfg
from .context import ManagerContext

__all__ = ["MODES", "MotionCommand", "MotionError", "motion_robot"]

MODES = {"adaptive": 0, "uniform": 1, "start": 2}
"""Numbers of the sampling modes, as the kernels have them."""


def motion_robot(context: ManagerContext, path: str, cfg: MotionCommandCfg) -> Articulation | None:
    """The robot of a motion command; None after a problem that says why there is none."""
    try:
        robot = context.asset(cfg.asset_name)
    except KeyError as error:
        context.problems.append(f"{path}.asset_name: {error.args[0]}")
        return None
    if not isinstance(robot, Articulation):
        context.problems.append(f"{path}.asset_name: '{cfg.asset_name}' has no joints, must be an articulation")
        return None
    return robot


class MotionCommand:
    """Frames of a motion command on the device, and the launches that update its probabilities.

    Attributes:
        struct: Data that terms read.
        library: The motions at the control rate.
    """

    def __init__(
        self, context: ManagerContext, path: str, cfg: MotionCommandCfg, robot: Articulation, data: CommandData
    ):
        """Read the motions.

        Raises:
            MotionError: a file is no motion, or one of another robot.
            ValueError: the anchor is no body, or several.
        """
        self._cfg, self._device = cfg, context.device
        names = robot.data.body_names
        ids, found = match_names(cfg.anchor_body_name, names, what=f"body of '{cfg.asset_name}'")
        if len(ids) > 1:
            raise ValueError(f"'{cfg.anchor_body_name}' matches more than one body, name one of: {', '.join(found)}")
        files = find_motions(cfg.motion_file)
        motions = [read_motion(file, cfg.motion_fps, cfg.joint_names, cfg.quaternions) for file in files]
        self.library = MotionLibrary.of_robot(motions, robot, context.scene.sim, 1.0 / context.step_dt)
        self.struct = self._make_struct(context, path, data, ids[0])

    def _make_struct(self, context: ManagerContext, path: str, data: CommandData, anchor: int) -> MotionCommandData:
        library, motion = self.library, MotionCommandData()
        motion.command, motion.anchor = data.command, anchor
        motion.frame = context.array(f"{path}.frame", int)
        motion.start = context.array(f"{path}.start", int)
        motion.started_at = context.array(f"{path}.started_at", wp.int64)
        # What files say is no state of the environment: it is not among the context's arrays, which are saved.
        motion.joint_pos, motion.joint_vel = (
            self._array(library.joint_pos, float),
            self._array(library.joint_vel, float),
        )
        motion.body_pose = self._array(library.body_pose, wp.transform)
        motion.body_vel = self._array(library.body_vel, wp.spatial_vector)
        starts, sizes, motions = library.bins()
        motion.last, motion.bin = self._array(library.last, int), self._array(library.bin_of_frames(), int)
        motion.bin_start, motion.bin_size = self._array(starts, int), self._array(sizes, int)
        motion.bin_motion, motion.motion_start = self._array(motions, int), self._array(library.starts, int)
        count = len(starts)
        motion.failures = context.shared(f"{path}.failures", float, count)
        motion.failure_rate = context.shared(f"{path}.failure_rate", float, count)
        motion.cumulative = context.shared(f"{path}.cumulative", float, count)
        # Episodes of the first reset begin anywhere.
        motion.cumulative.assign(np.arange(1, count + 1, dtype=np.float32) / count)
        return motion

    def _array(self, values: np.ndarray, dtype: type) -> wp.array:
        numbers = np.int32 if dtype is int else np.float32
        return wp.array(np.ascontiguousarray(values, dtype=numbers), dtype=dtype, device=self._device)

    def items(self) -> list[Item]:
        """The launches after each step, where failures count."""
        if self._cfg.sampling_mode != "adaptive":
            return []
        # The episodes of the next step read the probabilities, nothing in this step does.
        return [KernelLaunches("motion probabilities", self._update, concurrent=True, fields=frozenset())]

    def _update(self) -> None:
        cfg, motion = self._cfg, self.struct
        count = motion.failures.shape[0]
        wp.launch(average_failures, dim=count, inputs=[motion, cfg.adaptive_alpha], device=self._device)
        inputs = [motion, cfg.adaptive_uniform_ratio, cfg.adaptive_kernel_size, cfg.adaptive_lambda]
        wp.launch(accumulate_probabilities, dim=count, inputs=inputs, device=self._device)
