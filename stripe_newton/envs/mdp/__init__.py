# SPDX-License-Identifier: Apache-2.0
"""Terms for manager-based environments: all functions of ``stripe_kernels.mdp``, and configs of actions and commands.

Users write them with one prefix: ``mdp.track_lin_vel_xy_exp``, ``mdp.reach_object``, ``mdp.JointPositionActionCfg``.
"""

from typing import TYPE_CHECKING

from stripe_kernels import mdp as _terms
from stripe_kernels.mdp import *  # noqa: F403
from stripe_kernels.mdp.objects import events as _object_events
from stripe_kernels.mdp.objects import observations as _object_observations
from stripe_kernels.mdp.objects import rewards as _object_rewards
from stripe_kernels.mdp.objects import terminations as _object_terminations
from stripe_kernels.mdp.objects.events import *  # noqa: F403
from stripe_kernels.mdp.objects.observations import *  # noqa: F403
from stripe_kernels.mdp.objects.rewards import *  # noqa: F403
from stripe_kernels.mdp.objects.terminations import *  # noqa: F403
from stripe_kernels.removed_tables import forward_tables as _forward_tables
from stripe_newton.managers import actions_cfg as _actions
from stripe_newton.managers import commands_cfg as _commands
from stripe_newton.managers import operational_space_action as _operational_space
from stripe_newton.managers.actions_cfg import *  # noqa: F403
from stripe_newton.managers.commands_cfg import *  # noqa: F403
from stripe_newton.managers.image import image
from stripe_newton.managers.operational_space_action import *  # noqa: F403

__all__ = [
    *_terms.__all__,
    *_object_events.__all__,
    *_object_observations.__all__,
    *_object_rewards.__all__,
    *_object_terminations.__all__,
    *_actions.__all__,
    *_commands.__all__,
    *_operational_space.__all__,
    "image",
]

if not TYPE_CHECKING:
    __getattr__ = _forward_tables(
        __name__,
        sizes={
            "OBSERVATION_SIZES": f"{_terms.__name__}.observations",
            "OBJECT_OBSERVATION_SIZES": _object_observations.__name__,
        },
    )
