# SPDX-License-Identifier: Apache-2.0
"""Fixed tendons of an articulation by Isaac Lab's names."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_newton import assets as native
from stripe_newton.assets.root_writer import EnvIds

__all__ = ["TendonMethods"]

TendonIds = Sequence[int] | slice | None


class TendonMethods(native.Articulation):
    """Isaac Lab's methods of an articulation with fixed tendons. Values are written at once, not with a second call."""

    @property
    def num_fixed_tendons(self) -> int:
        """Number of fixed tendons."""
        return len(self.fixed_tendons)

    @property
    def fixed_tendon_names(self) -> list[str]:
        """Names of the fixed tendons."""
        return list(self.fixed_tendons.names)

    def find_fixed_tendons(
        self,
        name_keys: str | Sequence[str],
        tendon_subsets: Sequence[str] | None = None,
        preserve_order: bool = False,
    ) -> tuple[list[int], list[str]]:
        """Indices and names of the fixed tendons that match regular expressions."""
        ids, names = self.fixed_tendons.find(name_keys, preserve_order)
        if tendon_subsets is None:
            return ids, names
        kept = [(i, n) for i, n in zip(ids, names, strict=True) if n in tendon_subsets]
        return [i for i, _ in kept], [n for _, n in kept]

    def names_of(self, kind: str) -> list[str] | None:
        return self.fixed_tendon_names if kind == "fixed_tendon" else super().names_of(kind)

    def set_fixed_tendon_stiffness(
        self, stiffness: torch.Tensor, fixed_tendon_ids: TendonIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set stiffness."""
        self._write_tendons(fixed_tendon_ids, env_ids, stiffness=stiffness)

    def set_fixed_tendon_damping(
        self, damping: torch.Tensor, fixed_tendon_ids: TendonIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set damping."""
        self._write_tendons(fixed_tendon_ids, env_ids, damping=damping)

    def set_fixed_tendon_position_limit(
        self, limit: torch.Tensor, fixed_tendon_ids: TendonIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set limits of the length, shape ``(n, tendons, 2)``."""
        self._write_tendons(fixed_tendon_ids, env_ids, limits=limit)

    def write_fixed_tendon_properties_to_sim(self, fixed_tendon_ids: TendonIds = None, env_ids: EnvIds = None) -> None:
        """Do nothing: what was set is in the simulation already."""

    def _write_tendons(self, ids: TendonIds, env_ids: EnvIds, **values: torch.Tensor) -> None:
        rows = None if env_ids is None else self.env_indices(env_ids)
        self.fixed_tendons.write(env_ids=rows, tendon_ids=slice(None) if ids is None else ids, **values)
