# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton demo``: shows a trained policy that comes with its task, in the browser, and how long that took."""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from typing import TYPE_CHECKING

import tyro

from . import BEGAN
from .device import set_device, set_seeds
from .env_and_policy import build_policy
from .options import DemoArgs
from .packaged_policy import packaged_policy, tasks_with_policy
from .play import roll, watch
from .run_configs import check, load_configs
from .user_error import UserError, check_count

if TYPE_CHECKING:
    from stripe_newton.viewers import LiveViewer

__all__ = ["DemoArgs", "run"]

_FIRST_CHOICE = "Stripe-Velocity-Flat-Quadruped-v0"


def run(argv: list[str]) -> int:
    """Run the command."""
    imported = time.perf_counter()
    args = tyro.cli(DemoArgs, args=argv, prog="stripe-newton demo", config=(tyro.conf.FlagConversionOff,))
    check_count("--steps", args.steps)
    task = args.task or _default_task()
    policy_file = packaged_policy(task)
    configs = load_configs(task, None, agent=False)
    configs.env.scene.num_envs = args.num_envs
    configs.env.seed = args.seed
    set_device(configs.env, args.device)
    check(configs)
    set_seeds(args.seed or 0)
    env, policy = build_policy(task, configs, policy_file)
    built = time.perf_counter()

    def tell(viewer: LiveViewer) -> None:
        ready = time.perf_counter()
        parts = ("imports", imported - BEGAN), ("environment", built - imported), ("page and first step", ready - built)
        print(
            f"ready after {ready - BEGAN:.1f} s: {', '.join(f'{name} {took:.1f} s' for name, took in parts)}",
            flush=True,
        )
        if args.browser and _has_screen():
            webbrowser.open(viewer.url)

    try:
        if args.viewer == "viser":
            watch(task, env, policy, configs.env, args, tell)
        else:
            roll(env, policy, args.steps or int(env.max_episode_length), args.seed)
    finally:
        env.close()
    return 0


def _default_task() -> str:
    """The quadruped, or the first task that has a policy.

    Raises:
        UserError: if none has.
    """
    there = tasks_with_policy()
    if not there:
        raise UserError("no installed task has a policy of its own: register_task(..., policy='package:path.onnx')")
    return _FIRST_CHOICE if _FIRST_CHOICE in there else there[0]


def _has_screen() -> bool:
    """Whether a browser can open a window: without one, some open in the terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
