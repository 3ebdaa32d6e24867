# SPDX-License-Identifier: Apache-2.0
"""Running normalisation: an observation group normalised by the mean and variance of all observations so far."""

from __future__ import annotations

from typing import Annotated

import warp as wp

from stripe_kernels.processing import merge_statistics, normalize, sum_moments
from stripe_newton.configclass import configclass
from stripe_newton.fusion import KernelLaunches
from stripe_newton.value_types import INFINITE, PositiveFloat, Range

from .context import ManagerContext

__all__ = ["RunningNormCfg", "running_normalization"]

_PARTS = 64
"""Partial sums of a column, each over a share of the environments: threads then share the work of few columns."""


@configclass
class RunningNormCfg:
    """Running normalisation: ``clamp((x - mean) / (std + eps), -clip, clip)`` over all observations so far."""

    eps: PositiveFloat = 1.0e-2
    """Added to the standard deviation."""
    clip: Annotated[float, INFINITE, Range(above=0.0)] = 10.0
    """Bound of the normalised values."""
    update: bool = True
    """Keep updating mean and variance; the parameter ``observations.GROUP.normalization.update`` changes it."""


def running_normalization(
    context: ManagerContext, group: str, cfg: RunningNormCfg, raw: wp.array, buffer: wp.array, gather: bool
) -> KernelLaunches:
    """Item that normalises ``raw`` into ``buffer``, both of shape ``(num_envs, n)``.

    Args:
        context: The context of the managers.
        group: Name of the group.
        cfg: The config.
        raw: Observations before normalisation.
        buffer: Normalised observations.
        gather: Update mean and variance by ``raw`` first.
    """
    count, columns = buffer.shape
    path = f"observations.{group}.normalization"
    mean, seen = context.shared(f"{path}.mean", float, columns), context.shared(f"{path}.seen", float, columns)
    var = context.shared(f"{path}.var", float, columns, fill=1)
    sums, squares = (context.shared(f"{path}.{n}", float, columns, _PARTS) for n in ("sums", "squares"))
    context.parameters.add(f"{path}.update", cfg.update, bool)
    update = context.parameters.index(f"{path}.update")

    def launch() -> None:
        if gather:
            wp.launch(sum_moments, (columns, _PARTS), [raw, count, seen, mean], [sums, squares])
            wp.launch(
                merge_statistics,
                columns,
                [raw, count, context.parameters.ints, update, sums, squares],
                [seen, mean, var],
            )
        wp.launch(normalize, (count, columns), [raw, mean, var, cfg.eps, cfg.clip], [buffer])

    return KernelLaunches(f"running normalisation of '{group}'", launch, fields=frozenset())
