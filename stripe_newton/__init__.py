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

# Old module paths, by the release that moved them. What moved in 0.2 goes with 0.3; CHANGELOG lists each.
forward_modules({})
