# SPDX-License-Identifier: Apache-2.0
"""Task of which one rank dies, fails, or interrupts the launcher during a training.

``DYING_HOW`` is ``kill``, ``raise``, ``exit`` or ``interrupt``; rank 1 does it in the third iteration.
"""

from __future__ import annotations

import os
import signal
import time

import gymnasium

from tests.helpers.fake_env import FakeCartEnv

TASK = "Fake-Dying-v0"
STEP = 2 * 16 + 5


class DyingEnv(FakeCartEnv):
    def step(self, action):
        if os.environ.get("RANK") == "1" and self.steps_taken == STEP:
            how = os.environ.get("DYING_HOW")
            if how == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            elif how == "exit":
                os._exit(7)
            elif how == "raise":
                raise ZeroDivisionError("the wheel fell off")
            elif how == "interrupt":
                os.kill(os.getppid(), signal.SIGINT)
                time.sleep(0.5)
        return super().step(action)


if TASK not in gymnasium.registry:
    gymnasium.register(
        id=TASK,
        vector_entry_point=f"{__name__}:DyingEnv",
        kwargs={
            "env_cfg_entry_point": "tests.helpers.fake_env:FakeCartCfg",
            "rsl_rl_cfg_entry_point": "tests.helpers.fake_env:FakeCartRunnerCfg",
        },
    )
