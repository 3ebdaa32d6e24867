# SPDX-License-Identifier: Apache-2.0
"""Terms of Isaac Lab's ``isaaclab.envs.mdp``: Warp terms by its names, classes of actions and commands."""

from . import (
    actions,
    command_terms,
    commands,
    curriculums,
    events,
    fixed_tendons,
    observations,
    operational_space,
    recorders,
    rewards,
    terminations,
)
from .actions import *  # noqa: F403
from .command_terms import *  # noqa: F403
from .commands import *  # noqa: F403
from .curriculums import *  # noqa: F403
from .events import *  # noqa: F403
from .events import _randomize_prop_by_op  # noqa: F401
from .fixed_tendons import *  # noqa: F403
from .observations import *  # noqa: F403
from .operational_space import *  # noqa: F403
from .recorders import *  # noqa: F403
from .rewards import *  # noqa: F403
from .terminations import *  # noqa: F403

_PARTS = (
    actions,
    command_terms,
    commands,
    curriculums,
    events,
    fixed_tendons,
    observations,
    operational_space,
    recorders,
    rewards,
    terminations,
)

__all__ = sorted(name for part in _PARTS for name in part.__all__)
