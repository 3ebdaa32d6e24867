# SPDX-License-Identifier: Apache-2.0
"""BatchedDistillation: rsl_rl's distillation with an update that computes many steps at once."""

from __future__ import annotations

import torch
from rsl_rl.algorithms import Distillation
from rsl_rl.models import CNNModel, MLPModel, RNNModel
from rsl_rl.modules import HiddenState
from tensordict import TensorDict
from torch import nn

from .recurrent_cnn import RecurrentCNNModel

__all__ = ["BatchedDistillation"]


class BatchedDistillation(Distillation):
    """Distillation whose update takes the steps between two gradient steps together.

    rsl_rl runs the student step by step and waits for the device after each. Only the memory of a student goes from
    step to step: its encoders and its MLP take all of them in one batch. The numbers are rsl_rl's but for rounding.
    Where that cannot be said (:attr:`why_not_batched`), rsl_rl's own update runs.
    """

    last_hidden_states: tuple[HiddenState, HiddenState]

    @property
    def why_not_batched(self) -> str:
        """Reason why the update is rsl_rl's own; empty if it is batched."""
        if self.storage.num_transitions_per_env % self.gradient_length:
            return "gradient_length does not divide num_steps_per_env"
        if self.teacher.is_recurrent:
            return "the teacher has a memory"
        if type(self.student) not in (MLPModel, CNNModel, RNNModel, RecurrentCNNModel):
            return f"the student is a {type(self.student).__name__}"
        return ""

    def update(self) -> dict[str, float]:
        """Run all epochs over the steps of the rollout, and update the student's observation normaliser.

        Returns:
            The mean loss, ``"behavior"``.
        """
        if self.why_not_batched:
            return super().update()
        self.num_updates += 1
        student, storage, length = self.student, self.storage, self.gradient_length
        total = torch.zeros((), device=self.device)
        memory: HiddenState = None
        for _ in range(self.num_learning_epochs):
            memory = self.last_hidden_states[0]
            for first in range(0, storage.num_transitions_per_env, length):
                memory = _detached(memory)
                loss, memory = self._loss(slice(first, first + length), memory)
                self.optimizer.zero_grad()
                # rsl_rl adds up the losses of the steps.
                (length * loss).backward()
                if self.is_multi_gpu:
                    self.reduce_parameters()
                if self.max_grad_norm:
                    nn.utils.clip_grad_norm_(student.parameters(), self.max_grad_norm)
                self.optimizer.step()
                total += loss.detach()
        # The memory that the student goes on with is that of its new parameters.
        memory = _detached(memory)
        student.reset(hidden_state=memory)
        self.last_hidden_states = memory, None
        student.update_normalization(storage.observations.flatten(0, 1))
        storage.clear()
        return {"behavior": float(total) * length / (self.num_learning_epochs * storage.num_transitions_per_env)}

    def _loss(self, steps: slice, memory: HiddenState) -> tuple[torch.Tensor, HiddenState]:
        """Mean loss of some steps, and the memory after them."""
        student, storage = self.student, self.storage
        obs = storage.observations[steps].flatten(0, 1)
        kind = torch.device(self.device).type
        with torch.autocast(kind, dtype=torch.bfloat16, enabled=self.use_mixed_precision):
            if student.is_recurrent:
                inputs = _encode(student, obs).unflatten(0, (-1, storage.num_envs))
                latent, memory = _remember(student.rnn.rnn, inputs, memory, storage.dones[steps])
            else:
                latent = student.get_latent(obs)
            output = student.mlp(latent)
            actions = output if student.distribution is None else student.distribution.deterministic_output(output)
            return self.loss_fn(actions, storage.privileged_actions[steps].flatten(0, 1)), memory


def _encode(student: RNNModel | RecurrentCNNModel, obs: TensorDict) -> torch.Tensor:
    """Inputs of a student's recurrent layer, shape ``(samples, inputs)``."""
    return student.encode(obs) if isinstance(student, RecurrentCNNModel) else MLPModel.get_latent(student, obs)


def _remember(
    layer: nn.GRU | nn.LSTM, inputs: torch.Tensor, memory: HiddenState, dones: torch.Tensor
) -> tuple[torch.Tensor, HiddenState]:
    """Outputs of a recurrent layer over some steps, and its memory, which is cleared where an episode ends.

    Args:
        layer: The layer.
        inputs: Shape ``(steps, num_envs, inputs)``.
        memory: Memory before the first step; None for none.
        dones: Whether an episode ends with a step, shape ``(steps, num_envs, 1)``.

    Returns:
        Outputs, shape ``(steps * num_envs, outputs)``, and the memory after the last step.
    """
    outputs = []
    for row, kept in zip(inputs, dones == 0, strict=True):
        output, memory = layer(row.unsqueeze(0), memory)
        memory = tuple(m * kept for m in memory) if isinstance(memory, tuple) else memory * kept
        outputs.append(output)
    return torch.cat(outputs).flatten(0, 1), memory


def _detached(memory: HiddenState) -> HiddenState:
    """A memory without the computation that led to it."""
    if memory is None:
        return None
    return tuple(m.detach() for m in memory) if isinstance(memory, tuple) else memory.detach()
