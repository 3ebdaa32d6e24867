# SPDX-License-Identifier: Apache-2.0
"""Configs of rsl_rl's networks: multilayer perceptron, recurrent network, convolutional encoders, distributions."""

from __future__ import annotations

from stripe_newton.configclass import configclass
from stripe_newton.value_types import CodeName, PositiveFloat, PositiveInt

from .field_checks import Problems, layer_widths, one_of

__all__ = [
    "ACTIVATIONS",
    "RslRlCNNModelCfg",
    "RslRlMLPModelCfg",
    "RslRlRNNModelCfg",
    "RslRlRecurrentCNNModelCfg",
]

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
"""Names of the activation functions that rsl_rl knows."""


@configclass
class RslRlMLPModelCfg:
    """A multilayer perceptron (MLP) over flat observation groups."""

    @configclass
    class GaussianDistributionCfg:
        """Gaussian actions with one standard deviation for each action, independent of the state."""

        class_name: CodeName = "GaussianDistribution"
        """Name of the distribution in rsl_rl, or ``module:Class``."""
        init_std: PositiveFloat = 1.0
        """Initial standard deviation, in units of the action."""
        std_range: tuple[PositiveFloat, PositiveFloat] = (1e-6, 1e6)
        """Bounds of the standard deviation: smallest, largest."""
        std_type: str = "scalar"
        """Parameter that is learned: the deviation itself (``"scalar"``) or its logarithm (``"log"``)."""
        learn_std: bool = True
        """Whether the standard deviation is learned. If not, it stays ``init_std``."""

        def problems(self) -> Problems:
            yield from one_of(self, "std_type", ("scalar", "log"))
            if not self.std_range[0] <= self.std_range[1]:
                yield "std_range", f"is {self.std_range!r}, must be (smallest, largest)"

    @configclass
    class HeteroscedasticGaussianDistributionCfg:
        """Gaussian actions whose standard deviation is a second output of the network."""

        class_name: CodeName = "HeteroscedasticGaussianDistribution"
        """Name of the distribution in rsl_rl, or ``module:Class``."""
        init_std: PositiveFloat = 1.0
        """Initial standard deviation, in units of the action."""
        std_range: tuple[PositiveFloat, PositiveFloat] = (1e-6, 1e6)
        """Bounds of the standard deviation: smallest, largest."""
        std_type: str = "scalar"
        """Output of the network: the deviation itself (``"scalar"``) or its logarithm (``"log"``)."""

        def problems(self) -> Problems:
            yield from one_of(self, "std_type", ("scalar", "log"))

    @configclass
    class BetaDistributionCfg:
        """Beta actions, for action spaces with bounds."""

        class_name: CodeName = "BetaDistribution"
        """Name of the distribution in rsl_rl, or ``module:Class``."""
        action_range: tuple[float, float] = (-1.0, 1.0)
        """Lower and upper bound of every action."""

        def problems(self) -> Problems:
            if not self.action_range[0] < self.action_range[1]:
                yield "action_range", f"is {self.action_range!r}, must be (low, high) with low < high"

    class_name: CodeName = "MLPModel"
    """Name of the model in rsl_rl, or ``module:Class``."""
    hidden_dims: tuple[int, ...] = (256, 128, 64)
    """Widths of the hidden layers; -1 is the width of the input."""
    activation: str = "elu"
    """elu, selu, relu, crelu, lrelu, tanh, sigmoid, softplus, gelu, swish, mish or identity."""
    obs_normalization: bool = False
    """Whether observations are normalised by their running mean and standard deviation."""
    distribution_cfg: GaussianDistributionCfg | HeteroscedasticGaussianDistributionCfg | BetaDistributionCfg | None = (
        None
    )
    """Distribution that actions are drawn from; ``None`` for a plain output, as a critic has."""

    def problems(self) -> Problems:
        yield from layer_widths(self, "hidden_dims")
        yield from one_of(self, "activation", ACTIVATIONS)


@configclass
class RslRlRNNModelCfg(RslRlMLPModelCfg):
    """A recurrent network (LSTM or GRU) followed by a multilayer perceptron."""

    class_name: CodeName = "RNNModel"
    """Name of the model in rsl_rl, or ``module:Class``."""
    rnn_type: str = "lstm"
    """Kind of recurrent layer: ``"lstm"`` or ``"gru"``."""
    rnn_hidden_dim: PositiveInt = 256
    """Width of the recurrent state."""
    rnn_num_layers: PositiveInt = 1
    """Number of stacked recurrent layers."""

    def problems(self) -> Problems:
        yield from super().problems()
        yield from one_of(self, "rnn_type", ("lstm", "gru"))


@configclass
class RslRlCNNModelCfg(RslRlMLPModelCfg):
    """Convolutional encoders for image groups (channels, height, width), joined with flat groups before an MLP."""

    @configclass
    class CNNCfg:
        """One convolutional encoder. A single value, rather than a tuple, applies to every layer."""

        output_channels: tuple[PositiveInt, ...] = (16, 32, 32)
        """Output channels of each layer."""
        kernel_size: PositiveInt | tuple[PositiveInt, ...] = 3
        """Kernel size in pixels."""
        stride: PositiveInt | tuple[PositiveInt, ...] = 1
        """Stride in pixels."""
        dilation: PositiveInt | tuple[PositiveInt, ...] = 1
        """Dilation in pixels."""
        padding: str = "none"
        """Padding: none, zeros, reflect, replicate or circular."""
        norm: str | tuple[str, ...] = "none"
        """Normalisation after each layer: none, batch or layer."""
        activation: str = "elu"
        """Activation function after each layer, as in :class:`RslRlMLPModelCfg`."""
        max_pool: bool | tuple[bool, ...] = False
        """Whether max pooling follows each layer."""
        global_pool: str = "none"
        """Pooling over the whole image at the end: none, max or avg."""
        flatten: bool = True
        """Whether the output is flattened; the MLP that follows needs a flat input."""

        def problems(self) -> Problems:
            yield from one_of(self, "padding", ("none", "zeros", "reflect", "replicate", "circular"))
            yield from one_of(self, "activation", ACTIVATIONS)
            yield from one_of(self, "global_pool", ("none", "max", "avg"))

    class_name: CodeName = "CNNModel"
    """Name of the model in rsl_rl, or ``module:Class``."""
    cnn_cfg: CNNCfg | dict[str, CNNCfg] = CNNCfg()
    """The encoder of every image group, or a dict with one encoder for each group."""


@configclass
class RslRlRecurrentCNNModelCfg(RslRlCNNModelCfg, RslRlRNNModelCfg):
    """Convolutional encoders as in :class:`RslRlCNNModelCfg`, then a recurrent network over all observations."""

    class_name: CodeName = "stripe_newton.rl.recurrent_cnn:RecurrentCNNModel"
    """Name of the model in rsl_rl, or ``module:Class``."""
    rnn_type: str = "gru"
    """Kind of recurrent layer: ``"lstm"`` or ``"gru"``."""
