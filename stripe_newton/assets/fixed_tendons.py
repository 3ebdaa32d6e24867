# SPDX-License-Identifier: Apache-2.0
"""Fixed tendons of an articulation: couplings whose length is a weighted sum of joint positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import newton
import numpy as np
import torch
import warp as wp

from stripe_newton.matching import match_names

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

    from .layout import Layout

__all__ = ["FixedTendons"]

_FIXED = 0
"""Type of tendons whose length is a sum of joint positions, in Newton's attribute of MuJoCo's."""


class FixedTendons:
    """Fixed tendons of an articulation, as its MJCF file has them; only the solver of MuJoCo simulates them.

    Tensors have the shape ``(num_envs, count)``. A tendon's length is the sum of its joints' positions by coefficient,
    so that its units are those of the coefficients times m or rad: below, "length".

    Attributes:
        names: Names of the tendons.
    """

    def __init__(self, sim: Simulation, layout: Layout):
        self._sim = sim
        self._own = getattr(sim.model, "mujoco", None)
        self.names: list[str] = []
        rows: list[list[int]] = []
        if self._own is not None and hasattr(self._own, "tendon_stiffness"):
            per_env = sim.model.articulation_count // sim.num_envs
            first = next(i for i, start in enumerate(sim.template.articulation_start) if start == layout.joints.start)
            owners = self._own.tendon_articulation.numpy().copy()
            owners[self._own.tendon_type.numpy() != _FIXED] = -1
            rows = [np.flatnonzero(owners == env * per_env + first).tolist() for env in range(sim.num_envs)]
            self.names = [str(self._own.tendon_label[i]).rpartition("/")[2] for i in rows[0]]
        shape = (sim.num_envs, len(self.names))
        self._rows = torch.tensor(rows, dtype=torch.long, device=sim.device).reshape(shape)
        self.default_stiffness = self.stiffness.clone()
        self.default_damping = self.damping.clone()
        self.default_limits = self.limits.clone()

    def __len__(self) -> int:
        return len(self.names)

    def find(self, name_keys: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
        """Indices and names of the tendons that match regular expressions.

        Raises:
            ValueError: an expression matches nothing; the message lists what there is.
        """
        return match_names(name_keys, self.names, preserve_order, "fixed tendon")

    @property
    def stiffness(self) -> torch.Tensor:
        """Stiffness of the spring about the rest length [N m or N per length and coefficient]."""
        return self._values("tendon_stiffness")

    @property
    def damping(self) -> torch.Tensor:
        """Damping of the length [N m s or N s per length and coefficient]."""
        return self._values("tendon_damping")

    @property
    def limits(self) -> torch.Tensor:
        """Least and largest length, shape ``(num_envs, count, 2)``; both are 0 for a tendon without limits."""
        return self._values("tendon_range", (2,))

    def write(
        self,
        *,
        stiffness: torch.Tensor | float | None = None,
        damping: torch.Tensor | float | None = None,
        limits: torch.Tensor | None = None,
        env_ids: torch.Tensor | None = None,
        tendon_ids: Sequence[int] | torch.Tensor | slice = slice(None),
    ) -> None:
        """Change properties. What is None stays.

        Args:
            stiffness: New stiffness, shape ``(n, tendons)``, or a number.
            damping: New damping, the same.
            limits: New limits, shape ``(n, tendons, 2)``. A tendon that the file gives none gets none.
            env_ids: Environments; default all.
            tendon_ids: Tendons; default all.
        """
        rows = self._rows if env_ids is None else self._rows[env_ids]
        rows = rows[:, tendon_ids]
        given = {"tendon_stiffness": stiffness, "tendon_damping": damping, "tendon_range": limits}
        for name, value in given.items():
            if value is not None and self.names:
                array = wp.to_torch(getattr(self._own, name))
                array[rows] = torch.as_tensor(value, dtype=array.dtype, device=array.device)
        self._sim.notify(newton.ModelFlags.TENDON_PROPERTIES)

    def _values(self, name: str, width: tuple[int, ...] = ()) -> torch.Tensor:
        if not self.names:
            return torch.zeros((*self._rows.shape, *width), device=self._sim.device)
        return wp.to_torch(getattr(self._own, name))[self._rows]
