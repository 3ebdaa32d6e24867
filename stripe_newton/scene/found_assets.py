# SPDX-License-Identifier: Apache-2.0
"""Found assets: articulations and bodies that a stage brings itself, without a config."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import newton

from stripe_newton.assets import Articulation, ArticulationCfg, Layout, RigidObject

from .scene_contents import SceneContents

__all__ = ["FoundArticulation", "FoundBody", "adopt_layouts"]


def adopt_layouts(scene: SceneContents, layouts: Sequence[Layout]) -> None:
    """Make assets of the articulations and free bodies of a stage, named after their prims."""
    for layout in layouts:
        name = _unique(layout.path.rsplit("/", 1)[-1], scene.keys())
        if layout.floating and len(layout.bodies) == 1:
            scene.rigid_objects[name] = FoundBody(layout)
            scene.assets.append(scene.rigid_objects[name])
        else:
            scene.articulations[name] = FoundArticulation(layout)
            scene.assets.append(scene.articulations[name])


def _unique(name: str, taken: list[str]) -> str:
    """``name``, or the first of ``name_2``, ``name_3``, ... that is free."""
    number = 1
    while (candidate := name if number == 1 else f"{name}_{number}") in taken:
        number += 1
    return candidate


class _Found:
    """Binding of an asset to an articulation that is there: nothing is spawned."""

    in_every_env = True  # also where the whole of a stage is one environment, and no path says so

    def __init__(self, layout: Layout):
        state = ArticulationCfg.InitialStateCfg(pos=None, rot=None, joint_pos=None, joint_vel={})
        self.cfg: Any = ArticulationCfg(prim_path=layout.path, articulation_root_prim_path="", init_state=state)
        self.path = layout.path
        self._found = layout

    def _find_layout(self, layouts: Sequence[Layout], root_path: str | None = None) -> Layout:
        """The articulation itself: a body may stand below another body's prim."""
        return self._found


class FoundArticulation(_Found, Articulation):
    """An articulation that a stage brings, with the drives that the stage gives it."""

    def prepare(self, layouts: Sequence[Layout], builder: newton.ModelBuilder) -> None:
        targets = list(builder.joint_target_q), list(builder.joint_target_qd)
        super().prepare(layouts, builder)
        # A drive of the stage pulls where the stage says: no config moved the joints.
        builder.joint_target_q[:], builder.joint_target_qd[:] = targets


class FoundBody(_Found, RigidObject):
    """A free body that a stage brings."""
