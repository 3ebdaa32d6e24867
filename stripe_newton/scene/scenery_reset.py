# SPDX-License-Identifier: Apache-2.0
"""Scenery reset: at the start of an episode draws a place to start and puts the bodies of an imported stage back."""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from stripe_kernels.scenery import draw_spots, put_back
from stripe_newton.sim import Simulation
from stripe_newton.terrains.scenery_ground import SceneryGround

__all__ = ["SceneryReset"]


class SceneryReset:
    """Reset of an imported stage where an episode begins. It launches kernels alone, so a graph may hold it.

    Attributes:
        draws: Whether environments draw another place for each episode: not where something of theirs is fixed to the
            world, which was built at the first place.
    """

    def __init__(self, sim: Simulation, ground: SceneryGround, joints: Sequence[int], draws: bool):
        """Remember the initial state of the bodies.

        Args:
            sim: The built simulation.
            ground: The places.
            joints: Joints of the template that are the stage's.
            draws: Whether environments draw another place for each episode.
        """
        self.draws, self._ground, self._sim = draws, ground, sim
        self._rows: list[tuple[wp.array, wp.array, wp.array]] = []
        starts = {
            "joint_q": (sim.template.joint_q_start, sim.template.joint_coord_count),
            "joint_qd": (sim.template.joint_qd_start, sim.template.joint_dof_count),
        }
        for name, (start, total) in starts.items():
            ends = [*start[1:], total]
            columns = [i for j in joints for i in range(start[j], ends[j])]
            if columns:
                state = wp.from_torch(sim.per_env(getattr(sim.state, name)), dtype=wp.float32)
                indices = wp.array(columns, dtype=int, device=sim.device)
                self._rows.append((state, wp.clone(state), indices))

    def launch(self, env_mask: wp.array, rng: wp.array) -> None:
        """Begin episodes.

        Args:
            env_mask: Environments whose episode begins, bool, shape ``(num_envs,)``.
            rng: Random streams, uint32, shape ``(num_envs,)``.
        """
        sim, struct = self._sim, self._ground.struct
        if self.draws:
            inputs = [env_mask, struct.init_pos[0, 0], rng, struct.env_origin]
            wp.launch(draw_spots, dim=sim.num_envs, inputs=inputs, device=sim.device)
        for state, first, columns in self._rows:
            inputs = [env_mask, columns, first, state]
            wp.launch(put_back, dim=(sim.num_envs, len(columns)), inputs=inputs, device=sim.device)
