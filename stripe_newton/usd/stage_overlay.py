# SPDX-License-Identifier: Apache-2.0
"""Stage overlay: a stage that is edited without a change of the given one."""

from __future__ import annotations

from pxr import Sdf, Usd

__all__ = ["StageOverlay"]


class StageOverlay:
    """A stage that is opened a second time, with a session layer of its own, at the first edit.

    Most stages need no edit, and opening a large one again takes as long as the first time.
    """

    def __init__(self, stage: Usd.Stage):
        self.stage = stage
        self._own = False

    def prim(self, path: Sdf.Path | str) -> Usd.Prim:
        """The prim to edit. An instance that it is part of is made editable."""
        if not self._own:
            self._open()
        prim = self.stage.GetPrimAtPath(path)
        # Instances may be nested: making the outermost one editable may leave the prim in an inner one.
        while prim.IsInstanceProxy():
            instance = prim
            while not instance.IsInstance():
                instance = instance.GetParent()
            instance.SetInstanceable(False)
            prim = self.stage.GetPrimAtPath(path)
        return prim

    def _open(self) -> None:
        base, session = self.stage, Sdf.Layer.CreateAnonymous("stripe-newton.usda")
        if base.GetSessionLayer() is not None:
            session.subLayerPaths.append(base.GetSessionLayer().identifier)
        arguments = (base.GetRootLayer(), session, base.GetPathResolverContext())
        # The same mask, load rules and muted layers, or the second stage would hold other prims than the first.
        self.stage = Usd.Stage.OpenMasked(*arguments, base.GetPopulationMask(), Usd.Stage.LoadAll)
        self.stage.SetLoadRules(base.GetLoadRules())
        self.stage.MuteAndUnmuteLayers(base.GetMutedLayers(), [])
        self.stage.SetEditTarget(session)
        self._base, self._own = base, True  # the reference keeps the base's session layer alive
