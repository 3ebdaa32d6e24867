# SPDX-License-Identifier: Apache-2.0
"""Configuration of a training run with rsl_rl 5.5: runner, networks, PPO and its extensions.

The class names are those that users of Isaac Lab know; the fields are rsl_rl's own. Nothing here imports torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from stripe_newton.configclass import configclass

__all__ = [
    "RslRlBaseRunnerCfg",
    "RslRlCNNModelCfg",
    "RslRlMLPModelCfg",
    "RslRlOnPolicyRunnerCfg",
    "RslRlPpoAlgorithmCfg",
    "RslRlRNNModelCfg",
    "RslRlRndCfg",
    "RslRlSymmetryCfg",
]

Problems = Iterator[tuple[str, str]]

ACTIVATIONS = (
    "elu",
    "selu",
    "relu",
    "crelu",
    "lrelu",
    "tanh",
    "sigmoid",
    "softplus",
    "gelu",
    "swish",
    "mish",
    "identity",
)
OPTIMIZERS = ("adam", "adamw", "sgd", "rmsprop")
COMPILE_MODES = ("default", "max-autotune-no-cudagraphs")


def one_of(cfg: Any, field: str, choices: tuple[str, ...]) -> Problems:
    value = getattr(cfg, field)
    if not isinstance(value, str) or value.lower() not in choices:
        yield field, f"is {value!r}, must be one of {', '.join(choices)}"


def at_least(cfg: Any, low: float, *fields: str) -> Problems:
    for field in fields:
        value = getattr(cfg, field)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= low:
            yield field, f"is {value!r}, must be a number of at least {low}"


def positive(cfg: Any, *fields: str) -> Problems:
    for field in fields:
        value = getattr(cfg, field)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0.0:
            yield field, f"is {value!r}, must be a number above 0"


def _in_unit(cfg: Any, *fields: str) -> Problems:
    for field in fields:
        value = getattr(cfg, field)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value <= 1.0:
            yield field, f"is {value!r}, must lie in [0, 1]"


def _layers(cfg: Any, *fields: str) -> Problems:
    for field in fields:
        value = getattr(cfg, field)
        if not isinstance(value, (tuple, list)) or not all(isinstance(n, int) and (n > 0 or n == -1) for n in value):
            yield field, f"is {value!r}, must be a sequence of positive widths (-1: the width of the input)"


@configclass
class RslRlMLPModelCfg:
    """A multilayer perceptron over flat observation groups."""

    @configclass
    class GaussianDistributionCfg:
        """Gaussian actions with one standard deviation for each action, the same in every state."""

        class_name: str = "GaussianDistribution"
        """Name of the distribution in rsl_rl, or ``module:Class``."""
        init_std: float = 1.0
        """Standard deviation at the start, in action units."""
        std_range: tuple[float, float] = (1e-6, 1e6)
        """Smallest and largest standard deviation."""
        std_type: str = "scalar"
        """What is learned: the deviation itself (``"scalar"``) or its logarithm (``"log"``)."""
        learn_std: bool = True
        """Whether the standard deviation is learned; it stays ``init_std`` otherwise."""

        def problems(self) -> Problems:
            yield from positive(self, "init_std")
            yield from one_of(self, "std_type", ("scalar", "log"))
            if len(self.std_range) != 2 or not self.std_range[0] <= self.std_range[1]:
                yield "std_range", f"is {self.std_range!r}, must be (smallest, largest)"

    @configclass
    class HeteroscedasticGaussianDistributionCfg:
        """Gaussian actions whose standard deviation is a second output of the network."""

        class_name: str = "HeteroscedasticGaussianDistribution"
        """Name of the distribution in rsl_rl, or ``module:Class``."""
        init_std: float = 1.0
        """Standard deviation at the start, in action units."""
        std_range: tuple[float, float] = (1e-6, 1e6)
        """Smallest and largest standard deviation."""
        std_type: str = "scalar"
        """What the network outputs: the deviation itself (``"scalar"``) or its logarithm (``"log"``)."""

        def problems(self) -> Problems:
            yield from positive(self, "init_std")
            yield from one_of(self, "std_type", ("scalar", "log"))

    @configclass
    class BetaDistributionCfg:
        """Beta actions, for action spaces with bounds."""

        class_name: str = "BetaDistribution"
        """Name of the distribution in rsl_rl, or ``module:Class``."""
        action_range: tuple[float, float] = (-1.0, 1.0)
        """Lower and upper bound of every action."""

        def problems(self) -> Problems:
            if len(self.action_range) != 2 or not self.action_range[0] < self.action_range[1]:
                yield "action_range", f"is {self.action_range!r}, must be (low, high) with low < high"

    class_name: str = "MLPModel"
    """Name of the model in rsl_rl, or ``module:Class``."""
    hidden_dims: tuple[int, ...] = (256, 128, 64)
    """Width of each hidden layer; -1 is the width of the input."""
    activation: str = "elu"
    """elu, selu, relu, crelu, lrelu, tanh, sigmoid, softplus, gelu, swish, mish or identity."""
    obs_normalization: bool = False
    """Whether observations are shifted and scaled by their running mean and standard deviation."""
    distribution_cfg: GaussianDistributionCfg | HeteroscedasticGaussianDistributionCfg | BetaDistributionCfg | None = (
        None
    )
    """How actions are drawn from the output; ``None`` for a plain output, as a critic has."""

    def problems(self) -> Problems:
        yield from _layers(self, "hidden_dims")
        yield from one_of(self, "activation", ACTIVATIONS)


@configclass
class RslRlRNNModelCfg(RslRlMLPModelCfg):
    """A recurrent layer in front of a multilayer perceptron."""

    class_name: str = "RNNModel"
    """Name of the model in rsl_rl, or ``module:Class``."""
    rnn_type: str = "lstm"
    """Kind of recurrent layer: ``"lstm"`` or ``"gru"``."""
    rnn_hidden_dim: int = 256
    """Width of the recurrent state."""
    rnn_num_layers: int = 1
    """Number of recurrent layers on top of each other."""

    def problems(self) -> Problems:
        yield from RslRlMLPModelCfg.problems(self)
        yield from one_of(self, "rnn_type", ("lstm", "gru"))
        yield from at_least(self, 1, "rnn_hidden_dim", "rnn_num_layers")


@configclass
class RslRlCNNModelCfg(RslRlMLPModelCfg):
    """Convolutional encoders for image groups (channels, height, width), joined with flat groups before an MLP."""

    @configclass
    class CNNCfg:
        """One encoder; a value given once holds for every layer."""

        output_channels: tuple[int, ...] = (16, 32, 32)
        """Output channels of each layer."""
        kernel_size: int | tuple[int, ...] = 3
        """Kernel size in pixels."""
        stride: int | tuple[int, ...] = 1
        """Stride in pixels."""
        dilation: int | tuple[int, ...] = 1
        """Dilation in pixels."""
        padding: str = "none"
        """Padding: none, zeros, reflect, replicate or circular."""
        norm: str | tuple[str, ...] = "none"
        """Normalization after each layer: none, batch or layer."""
        activation: str = "elu"
        """Activation after each layer, as in :class:`RslRlMLPModelCfg`."""
        max_pool: bool | tuple[bool, ...] = False
        """Whether max pooling follows each layer."""
        global_pool: str = "none"
        """Pooling over the whole picture at the end: none, max or avg."""
        flatten: bool = True
        """Whether the output is flattened; the MLP needs it to be."""

        def problems(self) -> Problems:
            yield from _layers(self, "output_channels")
            yield from one_of(self, "padding", ("none", "zeros", "reflect", "replicate", "circular"))
            yield from one_of(self, "activation", ACTIVATIONS)
            yield from one_of(self, "global_pool", ("none", "max", "avg"))

    class_name: str = "CNNModel"
    """Name of the model in rsl_rl, or ``module:Class``."""
    cnn_cfg: CNNCfg | dict[str, CNNCfg] = CNNCfg()
    """The encoder of every image group, or one for each group by its name."""


@configclass
class RslRlRndCfg:
    """Random network distillation: a reward for reaching states that the predictor does not know yet."""

    num_outputs: int = 1
    """Width of the embedding."""
    predictor_hidden_dims: tuple[int, ...] = (-1,)
    """Hidden layers of the predictor; -1 is the width of the input."""
    target_hidden_dims: tuple[int, ...] = (-1,)
    """Hidden layers of the fixed target; -1 is the width of the input."""
    activation: str = "elu"
    """Activation between layers, as in :class:`RslRlMLPModelCfg`."""
    state_normalization: bool = False
    """Whether the state is normalized by its running statistics."""
    reward_normalization: bool = False
    """Whether the intrinsic reward is normalized by the running deviation of its discounted sum."""
    weight: float = 0.0
    """Weight of the intrinsic reward, a second (rsl_rl multiplies it by the step's duration)."""
    weight_schedule: dict[str, Any] | None = None
    """``{"mode": "constant" | "step" | "linear"}`` with initial_step, final_step and final_value as the mode needs."""
    learning_rate: float = 1e-3
    """Learning rate of the predictor."""

    def problems(self) -> Problems:
        yield from at_least(self, 1, "num_outputs")
        yield from _layers(self, "predictor_hidden_dims", "target_hidden_dims")
        yield from one_of(self, "activation", ACTIVATIONS)
        yield from at_least(self, 0.0, "weight")
        yield from positive(self, "learning_rate")
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
    """Use of a task's symmetry: mirrored samples, or a loss for actions that are not mirrored."""

    data_augmentation_func: Callable[..., Any] | str | None = None
    """``func(env, obs, actions) -> (obs, actions)``, the originals first and then the mirrored; or ``module:name``."""
    use_data_augmentation: bool = False
    """Whether mirrored samples are added to every mini-batch."""
    use_mirror_loss: bool = False
    """Whether the mirror loss is added to the policy's loss; it is only logged otherwise."""
    mirror_loss_coeff: float = 0.0
    """Weight of the mirror loss."""

    def problems(self) -> Problems:
        if self.data_augmentation_func is None:
            yield "data_augmentation_func", "is None, must be a function or 'module:name'"
        yield from at_least(self, 0.0, "mirror_loss_coeff")


@configclass
class RslRlPpoAlgorithmCfg:
    """Proximal policy optimization (Schulman et al. 2017, arXiv:1707.06347)."""

    class_name: str = "PPO"
    """Name of the algorithm in rsl_rl, or ``module:Class``."""
    num_learning_epochs: int = 5
    """How often the samples of an iteration are used."""
    num_mini_batches: int = 4
    """Into how many mini-batches they are divided."""
    clip_param: float = 0.2
    """How far the probability ratio may leave 1."""
    gamma: float = 0.99
    """Discount of one step."""
    lam: float = 0.95
    """Decay of the generalized advantage estimate."""
    value_loss_coef: float = 1.0
    """Weight of the value loss."""
    entropy_coef: float = 0.01
    """Weight of the entropy bonus."""
    learning_rate: float = 1e-3
    """Learning rate, at the start if the schedule is adaptive."""
    max_grad_norm: float = 1.0
    """Largest norm of the gradient."""
    optimizer: str = "adam"
    """adam, adamw, sgd or rmsprop."""
    use_clipped_value_loss: bool = True
    """Whether the value may not move further than ``clip_param`` in one update."""
    schedule: str = "adaptive"
    """Learning rate: ``"fixed"``, or ``"adaptive"`` so that an update moves the policy by ``desired_kl``."""
    desired_kl: float = 0.01
    """Kullback-Leibler divergence that the adaptive schedule aims at."""
    normalize_advantage_per_mini_batch: bool = False
    """Whether advantages are normalized in each mini-batch, rather than over the whole iteration."""
    use_mixed_precision: bool = False
    """Whether networks run in bfloat16 during the update."""
    share_cnn_encoders: bool = False
    """Whether the critic uses the actor's image encoders."""
    rnd_cfg: RslRlRndCfg | None = None
    """Random network distillation, if wanted."""
    symmetry_cfg: RslRlSymmetryCfg | None = None
    """Symmetry augmentation, if wanted."""
    grad_reduce_bucket_mb: float = 25.0
    """Size of the buckets in which several GPUs exchange gradients (MB)."""

    def problems(self) -> Problems:
        yield from at_least(self, 1, "num_learning_epochs", "num_mini_batches")
        yield from positive(self, "clip_param", "learning_rate", "max_grad_norm", "desired_kl", "grad_reduce_bucket_mb")
        yield from _in_unit(self, "gamma", "lam")
        yield from at_least(self, 0.0, "value_loss_coef", "entropy_coef")
        yield from one_of(self, "optimizer", OPTIMIZERS)
        yield from one_of(self, "schedule", ("adaptive", "fixed"))


@configclass
class RslRlBaseRunnerCfg:
    """What all kinds of runs have in common."""

    seed: int = 42
    """Seed of Python, NumPy, torch and, unless it has its own, of the environment."""
    num_steps_per_env: int = 24
    """Environment steps in an iteration."""
    max_iterations: int = 1500
    """Iterations of the whole run; a resumed run counts those that were done before."""
    save_interval: int = 50
    """Iterations between checkpoints."""
    regenerate_interval: int = 0
    """Iterations after which training goes on in another scene of the environment's specification, whose seed is the
    one of its config and the number of scenes before it; 0 for never."""
    init_at_random_ep_len: bool = True
    """Whether episodes start at random lengths, so that their ends do not fall together."""
    experiment_name: str = ""
    """Folder of the runs of this experiment; empty for the task's name."""
    run_name: str = ""
    """Text at the end of the run folder's name."""
    obs_groups: dict[str, list[str]] = {}
    """Which observation groups each network reads, joined in this order."""
    clip_actions: float | None = None
    """Bound of every action, or ``None`` for none."""
    check_for_nan: bool = True
    """Whether an environment that returns NaN ends the run with an error."""
    runner: str = "graph"
    """``"graph"``: rollout and update are CUDA graphs where they can be, and rsl_rl's own where not, which is said;
    ``"rsl_rl"``: rsl_rl's loop and algorithm, untouched."""
    matmul_precision: str = "highest"
    """Of float32 matrix products, as ``torch.set_float32_matmul_precision``: ``"highest"``, ``"high"`` (TF32) or
    ``"medium"`` (bfloat16)."""
    torch_compile_mode: str | None = None
    """``torch.compile`` mode of the networks (``"default"`` or ``"max-autotune-no-cudagraphs"``), or ``None``."""
    logger: str | dict[str, Any] = "tensorboard"
    """``"tensorboard"``, or ``{"class_name": "WandbLogWriter", "project_name": ...}`` for a second writer beside it."""

    def problems(self) -> Problems:
        yield from at_least(self, 1, "num_steps_per_env", "max_iterations", "save_interval")
        if not isinstance(self.regenerate_interval, int) or self.regenerate_interval < 0:
            yield "regenerate_interval", f"is {self.regenerate_interval!r}, must be a whole number, 0 or more"
        if self.clip_actions is not None:
            yield from positive(self, "clip_actions")
        yield from one_of(self, "runner", ("graph", "rsl_rl"))
        yield from one_of(self, "matmul_precision", ("highest", "high", "medium"))
        if self.torch_compile_mode is not None:
            yield from one_of(self, "torch_compile_mode", COMPILE_MODES)
        for name, groups in self.obs_groups.items():
            if not isinstance(groups, (list, tuple)) or not groups:
                yield f"obs_groups.{name}", f"is {groups!r}, must be a list of observation groups"
        if self.logger != "tensorboard" and not (isinstance(self.logger, dict) and "class_name" in self.logger):
            yield "logger", f"is {self.logger!r}, must be 'tensorboard' or a dict with a 'class_name'"

    def to_rsl_rl(self) -> dict[str, Any]:
        """The nested dict that rsl_rl's runner takes; functions and classes are named as ``module:name``."""
        cfg = self.to_dict()
        for name in _OURS:
            cfg.pop(name, None)
        return cfg


_OURS = (
    "experiment_name",
    "max_iterations",
    "init_at_random_ep_len",
    "regenerate_interval",
    "runner",
    "matmul_precision",
    "teacher_checkpoint",
)
"""Fields of a run that rsl_rl does not know."""


@configclass
class RslRlOnPolicyRunnerCfg(RslRlBaseRunnerCfg):
    """A training run with PPO: how long, on which observations, with which networks and algorithm."""

    obs_groups: dict[str, list[str]] = {"actor": ["policy"], "critic": ["policy"]}
    """Which observation groups the actor and the critic (and ``rnd_state``) read, joined in this order."""
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg())
    """The policy's network."""
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg()
    """The value function's network."""
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg()
    """The algorithm."""

    def problems(self) -> Problems:
        yield from super().problems()
        if self.actor.distribution_cfg is None:
            yield "actor.distribution_cfg", "is None, must be a distribution: PPO draws its actions from it"
        if self.critic.distribution_cfg is not None:
            yield "critic.distribution_cfg", "must be None: a value is not drawn from a distribution"
        if self.algorithm.symmetry_cfg is not None:
            for name in ("actor", "critic"):
                if isinstance(getattr(self, name), RslRlRNNModelCfg):
                    yield name, "is recurrent, which does not go with algorithm.symmetry_cfg"
