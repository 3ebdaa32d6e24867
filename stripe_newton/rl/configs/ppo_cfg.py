# SPDX-License-Identifier: Apache-2.0
"""Configs of PPO and its extensions: random network distillation and symmetry."""

from __future__ import annotations

from collections.abc import Callable

from stripe_newton.configclass import configclass
from stripe_newton.value_types import CodeName, NonNegativeFloat, PositiveFloat, PositiveInt, UnitFloat

from .field_checks import Problems, layer_widths, one_of
from .model_cfg import ACTIVATIONS

__all__ = ["OPTIMIZERS", "RslRlPpoAlgorithmCfg", "RslRlRndCfg", "RslRlSymmetryCfg"]

OPTIMIZERS = ("adam", "adamw", "sgd", "rmsprop")
"""Names of the optimisers that rsl_rl knows."""


@configclass
class RslRlRndCfg:
    """Random network distillation (RND): a reward for states that the predictor has not learned yet.

    Reference:
        Burda et al. "Exploration by random network distillation", arXiv:1810.12894 (2018).
    """

    num_outputs: PositiveInt = 1
    """Width of the embedding."""
    predictor_hidden_dims: tuple[int, ...] = (-1,)
    """Widths of the predictor's hidden layers; -1 is the width of the input."""
    target_hidden_dims: tuple[int, ...] = (-1,)
    """Widths of the fixed target network's hidden layers; -1 is the width of the input."""
    activation: str = "elu"
    """Activation function, as in :class:`RslRlMLPModelCfg`."""
    state_normalization: bool = False
    """Whether the state is normalised by its running mean and standard deviation."""
    reward_normalization: bool = False
    """Whether the intrinsic reward is normalised by the running deviation of its discounted sum."""
    weight: NonNegativeFloat = 0.0
    """Weight of the intrinsic reward per second (rsl_rl multiplies it by the duration of a step)."""
    weight_schedule: dict[str, str | int | float] | None = None
    """``{"mode": "constant" | "step" | "linear"}``. ``"step"`` also needs ``final_step`` and ``final_value``,
    ``"linear"`` those two and ``initial_step``."""
    learning_rate: PositiveFloat = 1e-3
    """Learning rate of the predictor."""

    def problems(self) -> Problems:
        yield from layer_widths(self, "predictor_hidden_dims", "target_hidden_dims")
        yield from one_of(self, "activation", ACTIVATIONS)
        needs = {"constant": set(), "step": {"final_step", "final_value"}}
        needs["linear"] = {"initial_step", "final_step", "final_value"}
        if self.weight_schedule is not None:
            mode = self.weight_schedule.get("mode")
            if mode not in needs:
                yield "weight_schedule", f"has mode {mode!r}, must be one of {', '.join(needs)}"
            elif missing := needs[mode] - set(self.weight_schedule):
                yield "weight_schedule", f"of mode '{mode}' lacks {', '.join(sorted(missing))}"


@configclass
class RslRlSymmetryCfg:
    """Symmetry of a task: mirrored samples, or a loss for actions that are not mirrored."""

    data_augmentation_func: Callable[..., object] | CodeName | None = None
    """``func(env, obs, actions) -> (obs, actions)`` returns the original samples followed by the mirrored ones. A
    function or ``module:name``."""
    use_data_augmentation: bool = False
    """Whether mirrored samples are added to every minibatch."""
    use_mirror_loss: bool = False
    """Whether the mirror loss is added to the policy's loss. If not, it is only logged."""
    mirror_loss_coeff: NonNegativeFloat = 0.0
    """Weight of the mirror loss."""

    def problems(self) -> Problems:
        if self.data_augmentation_func is None:
            yield "data_augmentation_func", "is None, must be a function or 'module:name'"


@configclass
class RslRlPpoAlgorithmCfg:
    """Proximal policy optimization (PPO).

    Reference:
        Schulman et al. "Proximal policy optimization algorithms", arXiv:1707.06347 (2017).
    """

    class_name: CodeName = "PPO"
    """Name of the algorithm in rsl_rl, or ``module:Class``."""
    num_learning_epochs: PositiveInt = 5
    """Epochs: how often each sample of an iteration is used."""
    num_mini_batches: PositiveInt = 4
    """Minibatches that the samples of an iteration are divided into."""
    clip_param: PositiveFloat = 0.2
    """Largest distance of the probability ratio from 1."""
    gamma: UnitFloat = 0.99
    """Discount factor of one step."""
    lam: UnitFloat = 0.95
    """Lambda of generalized advantage estimation."""
    value_loss_coef: NonNegativeFloat = 1.0
    """Weight of the value loss."""
    entropy_coef: NonNegativeFloat = 0.01
    """Weight of the entropy bonus."""
    learning_rate: PositiveFloat = 1e-3
    """Learning rate; its initial value if the schedule is adaptive."""
    max_grad_norm: PositiveFloat = 1.0
    """Largest norm of the gradient of a network."""
    optimizer: str = "adam"
    """adam, adamw, sgd or rmsprop."""
    use_clipped_value_loss: bool = True
    """Whether the value loss allows the value to move by at most ``clip_param`` in one update."""
    schedule: str = "adaptive"
    """Schedule of the learning rate: ``"fixed"``, or ``"adaptive"``, which aims at ``desired_kl``."""
    desired_kl: PositiveFloat = 0.01
    """Kullback-Leibler divergence of an update that the adaptive schedule aims at."""
    max_learning_rate: PositiveFloat = 1e-2
    """Upper bound of the adaptive learning rate; the default is rsl_rl's. A policy that sees pictures wants less: at
    first it hardly changes with its parameters, so the rate goes to its bound, where one step can ruin the policy."""
    normalize_advantage_per_mini_batch: bool = False
    """Whether advantages are normalised in each minibatch rather than over the whole iteration."""
    use_mixed_precision: bool = False
    """Whether the networks run in bfloat16 during the update."""
    share_cnn_encoders: bool = False
    """Whether the critic uses the image encoders of the actor."""
    rnd_cfg: RslRlRndCfg | None = None
    """Random network distillation, or ``None`` for none."""
    symmetry_cfg: RslRlSymmetryCfg | None = None
    """Symmetry augmentation, or ``None`` for none."""
    grad_reduce_bucket_mb: PositiveFloat = 25.0
    """Size of the buckets in which several GPUs exchange gradients [MB]."""

    def problems(self) -> Problems:
        yield from one_of(self, "optimizer", OPTIMIZERS)
        yield from one_of(self, "schedule", ("adaptive", "fixed"))
        if self.schedule == "adaptive" and self.learning_rate > self.max_learning_rate:
            yield "learning_rate", f"is {self.learning_rate}, above max_learning_rate, {self.max_learning_rate}"
