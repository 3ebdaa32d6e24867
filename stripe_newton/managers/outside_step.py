# SPDX-License-Identifier: Apache-2.0
"""Outside the step: runs items of managers between steps, to read their results or in chosen environments."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager

import torch
import warp as wp

from stripe_newton.configclass import ConfigError
from stripe_newton.fusion import Item, Plan, Stage

from .context import ManagerContext

__all__ = ["OutsideStep"]

Make = Callable[[], Sequence[Item]]
"""Function that makes the items."""


class OutsideStep:
    """Runs items between two steps of an environment. They are those of the step, compiled as kernels of their own.

    Kernels are made at the first call with a key.
    """

    def __init__(self, context: ManagerContext):
        self._context = context
        self._plans: dict[Hashable, Plan] = {}

    @contextmanager
    def computed(self, key: str, make: Make, states: Sequence[dict[str, object]] = ()) -> Iterator[None]:
        """Run items, so that their results can be read; afterwards all arrays are as they were.

        Args:
            key: Key of the items, a name.
            make: Makes them.
            states: Attributes of class terms, whose tensors are brought back, too.
        """
        plan, context = self._plan(key, make), self._context
        context.scene.sim.flush()
        with torch.inference_mode(False), torch.no_grad():
            tensors = [wp.to_torch(array) for array in context.arrays.values() if array.size]
            tensors += [v for state in states for v in state.values() if isinstance(v, torch.Tensor)]
            before = [tensor.clone() for tensor in tensors]
            attributes = [dict(state) for state in states]
            try:
                plan.run(replay=False)
                yield
            finally:
                for state, old in zip(states, attributes, strict=True):
                    state.update(old)  # a class may have bound a new tensor
                for tensor, old in zip(tensors, before, strict=True):
                    tensor.copy_(old)

    def run(self, key: str, make: Make) -> None:
        """Run items in all environments, to stay."""
        with torch.inference_mode(False), torch.no_grad():
            self._context.scene.sim.flush()
            self._plan(key, make).run(replay=False)

    def run_in(self, key: str, make: Make, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        """Run items that belong to environments whose episodes begin, in some environments; bodies follow the joints.

        Args:
            key: Key of the items.
            make: Makes them.
            env_ids: The environments; None for all.
        """
        context, sim = self._context, self._context.scene.sim
        plan, reset = self._plan(key, make), context.reset_mask
        with torch.inference_mode(False), torch.no_grad():
            sim.flush()
            chosen, moved = context.scene.controller.mask(env_ids), context.torch(context.moved)
            ended, moved_before = reset.tensor.clone(), moved.clone()
            reset.choose(chosen)
            try:
                plan.run(replay=False)
                chosen |= moved
            finally:
                reset.choose(ended)
                moved.copy_(moved_before)
            context.log.clear()  # what the items log is of episodes that a caller cut off
            sim.roots_moved = True
            sim.forward(chosen)

    def _plan(self, key: str, make: Make) -> Plan:
        if key not in self._plans:
            context, before = self._context, len(self._context.problems)
            with self._keeping_arrays():
                items = list(make())
            problems = context.problems[before:]
            del context.problems[before:]
            if problems:
                raise ConfigError(problems)
            name = f"outside_{key}".replace(".", "_")
            stages, scope = [Stage(key, items)], context.scope
            self._plans[key] = Plan(name, stages, scope, context.num_envs, context.device, use_graph=False)
        return self._plans[key]

    @contextmanager
    def _keeping_arrays(self) -> Iterator[None]:
        """Keep values that were changed since the step was made: making items writes those of the config again."""
        context = self._context
        own = {"parameters", "int_parameters"}  # which get new entries
        tensors = [wp.to_torch(array) for name, array in context.arrays.items() if name not in own and array.size]
        before = [tensor.clone() for tensor in tensors]
        with context.parameters.keeping_values():
            yield
        for tensor, old in zip(tensors, before, strict=True):
            tensor.copy_(old)
