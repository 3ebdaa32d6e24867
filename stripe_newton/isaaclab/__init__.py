# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab dialect: files written for Isaac Lab 2.3 run as they are, without Isaac Sim.

``install()`` makes imports of ``isaaclab``, ``isaaclab_assets``, ``isaaclab_rl``, ``isaaclab_tasks``, ``isaacsim``,
``omni`` and ``carb`` work where the real packages are not installed. On the command line the option is ``--isaaclab``.

The package only translates. What a name stands for is in the tables of :mod:`stripe_newton.isaaclab.names`; most names
are classes of stripe_newton itself. Quaternions are (w, x, y, z) in everything that has an orientation
(:mod:`stripe_newton.isaaclab.quaternions`), as in Isaac Lab 2, and nowhere else in stripe_newton.
"""

from .import_hook import install, is_installed, uninstall

__all__ = ["install", "is_installed", "uninstall"]
