# SPDX-License-Identifier: Apache-2.0
"""Scene of the Isaac Lab dialect: assets and states with quaternions (w, x, y, z)."""

from __future__ import annotations

from typing import ClassVar

import torch
from pxr import Usd

from stripe_newton import scene as native
from stripe_newton.assets.root_writer import EnvIds
from stripe_newton.configclass import configclass
from stripe_newton.sim import Simulation

from .body_prims import author_body_prims
from .latest_simulation import latest_simulation
from .quaternions import pose_to_wxyz, pose_to_xyzw

__all__ = ["InteractiveScene", "InteractiveSceneCfg"]

States = dict[str, dict[str, dict[str, torch.Tensor]]]


@configclass
class InteractiveSceneCfg(native.InteractiveSceneCfg):
    """:class:`stripe_newton.scene.InteractiveSceneCfg`, whose subclasses may lack the decorator."""

    ADOPTS_SUBCLASSES: ClassVar[bool] = True


class InteractiveScene(native.InteractiveScene):
    """:class:`stripe_newton.scene.InteractiveScene`, whose states have quaternions (w, x, y, z).

    Without a simulation it is the scene of the :class:`SimulationContext` that was made last, on its stage.
    """

    def __init__(self, cfg: native.InteractiveSceneCfg, sim: Simulation | None = None, stage: Usd.Stage | None = None):
        latest = latest_simulation() if sim is None else None
        if latest is None:
            super().__init__(cfg, sim, stage)
            if sim is not None and sim is latest_simulation():
                latest_simulation().scene = self
        else:
            super().__init__(cfg, latest, latest.stage if stage is None else stage)
            latest.take_scene(self)

    def build(self) -> None:
        super().build()
        author_body_prims(self)

    def get_state(self, is_relative: bool = False) -> States:
        states = super().get_state(is_relative)
        for family in states.values():
            for values in family.values():
                values["root_pose"] = pose_to_wxyz(values["root_pose"]).as_subclass(torch.Tensor)  # a copy of its own
        return states

    def reset_to(self, state: States, env_ids: EnvIds = None, is_relative: bool = False) -> None:
        converted = {
            kind: {name: values | {"root_pose": pose_to_xyzw(values["root_pose"])} for name, values in family.items()}
            for kind, family in state.items()
        }
        super().reset_to(converted, env_ids, is_relative)
