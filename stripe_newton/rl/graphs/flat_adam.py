# SPDX-License-Identifier: Apache-2.0
"""FlatAdam: Adam, with clipping, on two networks whose parameters are one contiguous tensor, in few kernels."""

from __future__ import annotations

from collections.abc import Iterator

import torch
import warp as wp

from stripe_kernels.adam import prepare_adam, take_adam_step

__all__ = ["FlatAdam", "as_array"]

_ALIGNMENT = 64
"""Numbers that a parameter's place is a multiple of, so that matrix products may load it in whole cache lines."""


def as_array(tensor: torch.Tensor) -> wp.array:
    """The memory of a tensor as a Warp array, without a gradient."""
    return wp.from_torch(tensor, requires_grad=False)


class FlatAdam:
    """Steps of Adam or AdamW with gradients that are clipped for each of two networks.

    Parameters, gradients and the optimiser's state become parts of four pieces of memory. So a step is one kernel,
    whatever the number of layers. The optimiser keeps settings and state, in torch's form, for checkpoints.

    Attributes:
        parameters: All parameters that are trained, with zeros between them, ``(n,)``.
        gradient: Their gradients, in the same places, ``(n,)``.
    """

    def __init__(
        self,
        optimizer: torch.optim.Optimizer,
        first: torch.nn.Module,
        second: torch.nn.Module,
        rate: torch.Tensor,
        max_norm: float,
    ):
        """Move the parameters, whose gradients are 0 from then on.

        Args:
            optimizer: Adam or AdamW.
            first: The first network.
            second: The second one. What it shares with the first is clipped for both, one after the other.
            rate: Learning rate, float64, no dimensions; read in each step.
            max_norm: Largest norm of the gradient of a network.
        """
        wp.init()  # an environment of torch alone has not done it
        self._optimizer, self._networks, self._max_norm, self._rate = optimizer, (first, second), max_norm, rate
        own = [p for p in first.parameters() if p.requires_grad]
        ids = {id(p) for p in own}
        others = [p for p in second.parameters() if p.requires_grad]
        self._shares = any(id(p) in ids for p in others)
        self._trained = own + [p for p in others if id(p) not in ids]
        ends = [0]
        for parameter in self._trained:
            ends.append(ends[-1] + -(-parameter.numel() // _ALIGNMENT) * _ALIGNMENT)
        self._offsets, self._split = ends[:-1], ends[len(own)]
        device = rate.device
        # Each on its own: a checkpoint has parameters and state, but no gradients.
        memory = (torch.zeros(ends[-1], device=device) for _ in range(4))
        self.parameters, self.gradient, self._mean, self._square = memory
        self._copies: torch.Tensor | None = None
        self._step, self._norms, self._factors = (torch.zeros(n, device=device) for n in (1, 2, 3))
        moved = zip(self._trained, self.views(self.parameters), self.views(self.gradient), strict=True)
        for parameter, place, gradient in moved:
            place.copy_(parameter.detach())
            parameter.data, parameter.grad = place, gradient
        self.take_state()

    def views(self, flat: torch.Tensor) -> Iterator[torch.Tensor]:
        """The parts of memory like :attr:`parameters` that belong to the trained parameters, in their shapes."""
        for parameter, place in zip(self._trained, self._offsets, strict=True):
            yield flat[place : place + parameter.numel()].view(parameter.shape)

    def make_copies(self) -> dict[torch.Tensor, torch.Tensor]:
        """Copies of the parameters in bfloat16 by parameter, which :meth:`update_copies` brings up to date."""
        self._copies = self.parameters.to(torch.bfloat16)
        return dict(zip(self._trained, self.views(self._copies), strict=True))

    def update_copies(self) -> None:
        """Copy all parameters to those of :meth:`make_copies`, if there are any."""
        if self._copies is not None:
            self._copies.copy_(self.parameters)

    @torch.no_grad()
    def take_state(self) -> None:
        """Take over the optimiser's state, as after loading it, and put this memory in its place."""
        for parameter, mean, square in zip(
            self._trained, self.views(self._mean), self.views(self._square), strict=True
        ):
            state = self._optimizer.state.get(parameter)
            if state:
                mean.copy_(state["exp_avg"])
                square.copy_(state["exp_avg_sq"])
                self._step.fill_(float(state["step"]))
            else:
                mean.zero_()
                square.zero_()
                self._step.zero_()
            self._optimizer.state[parameter] = {"step": self._step[0], "exp_avg": mean, "exp_avg_sq": square}

    @torch.no_grad()
    def step(self) -> None:
        """Clip :attr:`gradient`, and change :attr:`parameters` by it."""
        settings, count = self._optimizer.param_groups[0], len(self.parameters)
        beta1, beta2 = settings["betas"]
        if self._shares:
            for network in self._networks:
                torch.nn.utils.clip_grad_norm_(network.parameters(), self._max_norm)
        else:
            for index, part in enumerate((self.gradient[: self._split], self.gradient[self._split :])):
                torch.linalg.vector_norm(part, out=self._norms[index])
        step, factors = as_array(self._step), as_array(self._factors)
        rate, device = as_array(self._rate.view(1)), step.device
        wp.launch(prepare_adam, dim=1, inputs=[rate, beta1, beta2, step, factors], device=device)
        limits = [as_array(self._norms), self._split, self._max_norm, factors]
        options = [beta1, 1.0 - beta1, beta2, 1.0 - beta2, settings["eps"], settings["weight_decay"]]
        decouples = isinstance(self._optimizer, torch.optim.AdamW)
        changed = [as_array(t) for t in (self._mean, self._square, self.parameters)]
        inputs = [as_array(self.gradient), *limits, *options, decouples, *changed]
        wp.launch(take_adam_step, dim=count, inputs=inputs, device=device)
