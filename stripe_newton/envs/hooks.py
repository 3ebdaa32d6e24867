# SPDX-License-Identifier: Apache-2.0
"""Hooks of the direct workflow: each is overridden with torch code, with Warp kernels, or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from stripe_newton.fusion import Item, KernelLaunches

__all__ = ["DirectHooks", "Filling", "Hook"]


class Filling(Enum):
    """Kind of code that a class fills a hook with."""

    NOTHING = "nothing"
    TORCH = "torch"
    WARP = "Warp"


@dataclass(frozen=True)
class Hook:
    """A hook of one class.

    Attributes:
        torch_name: Name of the method with torch code.
        warp_name: Name of the method that launches kernels.
        filling: The one that the class overrides.
    """

    torch_name: str
    warp_name: str
    filling: Filling

    @property
    def is_warp(self) -> bool:
        """Whether it is filled with Warp kernels, so that it can be captured in a CUDA graph."""
        return self.filling is Filling.WARP

    @property
    def is_empty(self) -> bool:
        """Whether the class fills neither of the two."""
        return self.filling is Filling.NOTHING

    def item(self, launch: Callable[[], None], torch_hook: Callable[[str], Item], note: str = "") -> Item:
        """The hook as an item of a step: Warp kernels become part of the graph, torch code runs between graphs.

        Args:
            launch: Launches the kernels of the Warp hook.
            torch_hook: Makes the item of the torch hook, of its name.
            note: Other things that run with the torch hook, for the description of the step.
        """
        if self.is_warp:
            return KernelLaunches(self.warp_name, launch)
        return torch_hook(f"{self.torch_name}{note}")


@dataclass(frozen=True)
class DirectHooks:
    """The hooks of a direct environment that may be filled either way, in the order in which a step runs them."""

    pre_physics: Hook
    apply_action: Hook
    dones: Hook
    rewards: Hook
    reset: Hook
    observations: Hook

    @staticmethod
    def of(cls: type, base: type) -> DirectHooks:
        """The hooks that ``base`` declares, as ``cls`` fills them.

        Raises:
            TypeError: if it fills a hook twice.
        """
        hooks = {field: _hook(cls, base, *names) for field, names in _NAMES.items()}
        twice = [f"{names[0]} and {names[1]}" for field, names in _NAMES.items() if hooks[field] is None]
        if twice:
            raise TypeError(f"{cls.__name__} fills {'; '.join(twice)}: fill one of the two")
        return DirectHooks(**{field: hook for field, hook in hooks.items() if hook is not None})


_NAMES = {
    "pre_physics": ("_pre_physics_step", "_launch_pre_physics_step"),
    "apply_action": ("_apply_action", "_launch_apply_action"),
    "dones": ("_get_dones", "_launch_dones"),
    "rewards": ("_get_rewards", "_launch_rewards"),
    "reset": ("_reset_idx", "_launch_reset"),
    "observations": ("_get_observations", "_launch_observations"),
}
"""Names of the hooks with torch, which are Isaac Lab's, and with Warp."""


def _hook(cls: type, base: type, torch_name: str, warp_name: str) -> Hook | None:
    """A hook as a class fills it; None if the class overrides both methods."""
    with_torch, with_warp = (getattr(cls, name) is not getattr(base, name) for name in (torch_name, warp_name))
    if with_torch and with_warp:
        return None
    filling = Filling.WARP if with_warp else Filling.TORCH if with_torch else Filling.NOTHING
    return Hook(torch_name, warp_name, filling)
