# SPDX-License-Identifier: Apache-2.0
"""Live view of a command: opens the viewer on the address that the options say, and prints where it is."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING

from .user_error import UserError

if TYPE_CHECKING:
    from stripe_newton.viewers import LiveViewer, ViewerCfg
    from stripe_newton.viewers.live.checkpoint_panel import Checkpoints

__all__ = ["FPS", "check_address", "check_installed", "open_viewer"]

FPS = 30.0
"""Most pictures per second."""
_MOST_PORT = 65535


def check_installed() -> None:
    """Refuse ``--viewer viser`` where viser is missing, before anything is built.

    Raises:
        UserError: with what to install.
    """
    if importlib.util.find_spec("viser") is None:
        raise UserError('--viewer viser: is not installed; pip install "stripe-newton[viser]", or another --viewer')


def check_address(host: str, port: int) -> None:
    """Refuse what is no address to listen on.

    Raises:
        UserError: for a port beyond those that there are, or an empty address, which would mean all interfaces.
    """
    if not host.strip():
        raise UserError(f"--host {host!r}: is empty; an address of this machine, or 0.0.0.0 for all of them")
    if not 1 <= port <= _MOST_PORT:
        raise UserError(f"--port {port}: must be from 1 to {_MOST_PORT}")


def open_viewer(
    subject: object,
    title: str,
    host: str,
    port: int,
    *,
    cfg: ViewerCfg | None = None,
    reset: Callable[[], object] | bool = True,
    checkpoints: Checkpoints | None = None,
    step_dt: float | None = None,
    is_paced: bool = True,
    fps: float = FPS,
) -> LiveViewer:
    """Open the viewer and print its address.

    Args:
        subject: An environment, a scene or a simulation.
        title: What is shown.
        host: Address to listen on.
        port: Port.
        cfg: Camera.
        reset: As :class:`LiveViewer` has it; so are the other arguments.
        checkpoints: Policies to switch between.
        step_dt: Duration of a step.
        is_paced: Keep to real time.
        fps: Most pictures per second.

    Raises:
        UserError: viser is not installed, the address is none of this machine's, or no port is free.
    """
    check_address(host, port)
    from stripe_newton.viewers import LiveViewer  # here, as it needs viser, which need not be installed

    try:
        viewer = LiveViewer(
            subject,
            cfg=cfg,
            title=title,
            host=host,
            port=port,
            reset=reset,
            checkpoints=checkpoints,
            step_dt=step_dt,
            is_paced=is_paced,
            fps=fps,
        )
    except ImportError as error:
        raise UserError(str(error)) from None
    except OSError as error:
        raise UserError(f"--host {host} --port {port}: {error.strerror or error}") from None
    print(f"{viewer.url}  (Ctrl-C to stop)", flush=True)
    return viewer
