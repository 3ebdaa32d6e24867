# SPDX-License-Identifier: Apache-2.0
"""Structs of assets in terms: how a term finds its articulation or rigid object, and the encoders of its joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_kernels.model_data import EncoderData
from stripe_newton.fusion import Code, NamedStructs, SceneEntityCfg, StructRegistry, TermBinding

if TYPE_CHECKING:
    from .articulation import Articulation

__all__ = ["register_asset_structs"]


class ArticulationStructs:
    """Finds the state of an articulation or a rigid object, by ``<argument>``, ``<argument>_cfg`` or ``asset_cfg``.

    Where the config names none, it is the asset of the argument's name, or the only one of the scene.
    """

    def parameters(self, argument: str) -> Sequence[str]:
        """The parameters that name an asset for an argument, the most special first."""
        return argument, f"{argument}_cfg", "asset_cfg"

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source of the asset's state.

        Raises:
            ArgumentError: if the term reads a field that is not computed.
            KeyError: if there is no such asset.
        """
        own, general = (argument, f"{argument}_cfg"), ("asset_cfg",)
        cfg = binding.take_entity(*own, *(general if binding.asset is None else ()))
        if cfg is None:
            there = binding.context.entity_names()
            cfg = SceneEntityCfg(argument if argument in there or len(there) != 1 else there[0])
        binding.asset = binding.asset or cfg  # the first one is what joint_ids and body_ids are of
        data = binding.context.asset(cfg.name).data
        binding.check_available(data.unavailable, cfg.name)
        return binding.context.scope.name(cfg.name, data.struct)


class EncoderStructs(NamedStructs):
    """Finds the joint encoders of an articulation; by default those of the asset that the term is about."""

    def default(self, binding: TermBinding) -> str | None:
        owner = binding.asset or binding.take_entity("asset_cfg")
        return super().default(binding) or (owner.name if owner is not None else None)


def register_asset_structs(structs: StructRegistry, articulations: dict[str, Articulation]) -> None:
    """Register the structs of articulations, and of their encoders, whose errors are zero at first."""
    structs.register(ArticulationData, ArticulationStructs())
    for name, articulation in articulations.items():
        encoder = EncoderData()
        shape = articulation.num_instances, articulation.num_joints
        encoder.bias = wp.zeros(shape, dtype=float, device=articulation.device)
        structs.named(EncoderData, EncoderStructs).add(name, encoder)
