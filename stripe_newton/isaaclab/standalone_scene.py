# SPDX-License-Identifier: Apache-2.0
"""Standalone scene of the Isaac Lab dialect: the scene of a script that has no environments, or names them itself.

Scripts spawn prims anywhere below ``/World``. Without a pattern in any path the stage is one environment as a whole.
Assets at a path such as ``/World/Origin.*/Robot`` are in each prim that the pattern matches: these prims are then the
environments, and everything else is shared by them.
"""

from __future__ import annotations

import re
from contextlib import AbstractContextManager

import torch
from pxr import Gf, Usd, UsdGeom

from stripe_newton.scene import InteractiveScene as NativeScene
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sensors import SensorBase
from stripe_newton.sim import Simulation
from stripe_newton.sim.scene_context import ENV_0, scene_context

from .scene import InteractiveScene

__all__ = ["StandaloneScene", "begin_authoring", "end_authoring"]

_GROUP = re.compile(r"^/World/(?!envs/)([A-Za-z_][A-Za-z0-9_]*)(?:\.\*|\*|\[0-9\]\+|\\d\+)(?=/|$)")
"""Pattern of prims right below the world, such as ``/World/Origin.*``."""

_open: list[AbstractContextManager[None]] = []


def begin_authoring(scene: NativeScene) -> None:
    """Let spawners and assets add to ``scene`` from now on, in place of the scene before it."""
    end_authoring()
    context = scene_context(scene)
    context.__enter__()
    _open.append(context)


def end_authoring() -> None:
    """Let spawners and assets add to no scene."""
    if _open:
        _open.pop().__exit__(None, None, None)


class StandaloneScene(InteractiveScene):
    """Scene of a script; :meth:`build` makes environments of it."""

    def __init__(self, sim: Simulation):
        super().__init__(InteractiveSceneCfg(num_envs=1, env_spacing=0.0), sim)
        self.stage.RemovePrim("/World/envs")
        self._group: str | None = None
        """Beginning of the names of the prims that are environments."""

    def alias(self, path: str) -> str:
        """The path in the environment for one with a pattern."""
        match = _GROUP.match(path)
        if match is None:
            return path
        if self._group not in (None, match[1]):
            raise ValueError(f"'{path}': the scene has environments '/World/{self._group}.*' already; use one pattern")
        self._group = match[1]
        return ENV_0 + path[match.end() :]

    def adopt_sensor(self, sensor: SensorBase) -> None:
        """Make a sensor part of the scene: a script keeps the ones that it creates to itself."""
        self.sensors[f"sensor_{len(self.sensors)}"] = sensor

    def build(self) -> None:
        if self._group is None:
            self.builder.template_root = "/"
            self.builder.allow_empty = True
        else:
            self._make_environments()
        super().build()

    def _make_environments(self) -> None:
        """Make environments of the prims of the group, at their places."""
        world = self.stage.GetPrimAtPath("/World")
        prims = [p for p in world.GetChildren() if re.fullmatch(f"{self._group}.*", p.GetName())]
        if not prims:
            raise ValueError(f"no prim matches '/World/{self._group}.*': create the prims before the model is made")
        if not self.stage.GetPrimAtPath(ENV_0):  # nothing is in them but cameras
            UsdGeom.Xform.Define(self.stage, ENV_0)
            self.builder.allow_empty = True
        self.cfg.num_envs = len(prims)
        self.env_origins = torch.tensor([_place(p) for p in prims], dtype=torch.float32, device=self.device)


def _place(prim: Usd.Prim) -> list[float]:
    pose = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    return [float(x) for x in Gf.Vec3d(pose.ExtractTranslation())]
