# SPDX-License-Identifier: Apache-2.0
"""Training environments for robots on the Newton physics engine.

Importing this package loads nothing heavy: no torch, no Warp, no GPU. Take what you need from its subpackages:

* ``stripe_newton.configclass``: ``@configclass`` and the checks of configs
* ``stripe_newton.sim``, ``.scene``, ``.assets``, ``.actuators``: from a USD stage to a running simulation
* ``stripe_newton.envs``: environments in the direct workflow
* ``stripe_newton.rl``, ``.viewers``, ``.cli``: training, pictures, command line
* ``stripe_newton.math``, ``.noise``: functions that tasks use
"""

from importlib.metadata import PackageNotFoundError, version

from .moved_modules import forward_modules

__all__ = ["__version__"]

try:
    __version__ = version("stripe-newton")
except PackageNotFoundError:  # run from a source tree that is not installed
    __version__ = "0+source"

# Old module paths. What moved in 0.2 goes with 0.3; the CHANGELOG lists each.
forward_modules(
    {
        "stripe_newton.envs.direct_marl_env_cfg": "stripe_newton.envs.direct_marl_env",
        "stripe_newton.envs.direct_rl_env_cfg": "stripe_newton.envs.direct_rl_env",
        "stripe_newton.envs.manager_based_rl_env_cfg": "stripe_newton.envs.manager_based_rl_env",
        "stripe_newton.envs.outputs": "stripe_newton.envs.output_block",
        "stripe_newton.fusion.entity": "stripe_newton.fusion.scene_entity",
        "stripe_newton.fusion.items": "stripe_newton.fusion.stage",
        "stripe_newton.fusion.kernels": "stripe_newton.fusion.fused_kernel",
        "stripe_newton.fusion.log": "stripe_newton.fusion.episode_log",
        "stripe_newton.fusion.single": "stripe_newton.fusion.single_thread",
        "stripe_newton.managers.object_cfg": "stripe_newton.managers.object_pool",
        "stripe_newton.managers.observation_cfg": "stripe_newton.managers",
        "stripe_newton.managers.recorder_cfg": "stripe_newton.managers",
    }
)
