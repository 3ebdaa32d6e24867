# SPDX-License-Identifier: Apache-2.0
"""Live viewer: a running simulation in the browser, with panels for its time, camera and environments."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import torch
import warp as wp

from stripe_newton.viewers.token_server import TokenServer
from stripe_newton.viewers.viewer_cfg import ViewerCfg

from .backdrop import Backdrop
from .browser_pace import BrowserPace
from .camera_control import CameraControl
from .camera_pictures import CameraPictures
from .checkpoint_panel import CheckpointPanel, Checkpoints
from .command_panel import CommandPanel
from .env_choice import EnvChoice
from .inbox import Inbox
from .joint_panel import JointPanel
from .live_scene import LiveScene
from .local_server import LOOPBACK, free_port, quiet, serve
from .overlays import Overlays
from .plot_panel import PlotPanel
from .pushes import Pushes
from .status_panel import StatusPanel
from .time_control import TimeControl
from .viewed_env import ViewedEnv, viewer_cfg_of, what_is_viewed

if TYPE_CHECKING:
    import viser

__all__ = ["LiveViewer"]

_MOST_PORT = 65535
_MOST_AT_FIRST = 16
"""Environments that are shown unless the caller names others."""


class LiveViewer:
    """Serves a view of chosen environments to a browser, with panels to act on them.

    A loop over :meth:`steps` is paced, paused and stepped from the page::

        with LiveViewer(env) as viewer:
            print(viewer.url)
            for _ in viewer.steps():
                env.step(policy(env.obs_buf))

    A loop of one's own calls :meth:`update` instead, which returns only when time goes on. Nothing is read from the
    device while no browser is connected.

    Args:
        subject: An environment, a scene or a simulation; its state is read at each picture.
        env_ids: Environments to show at first, the chosen one in front. Default: the first 16.
        cfg: Camera. Default: ``viewer`` of the environment's config.
        title: Name of what is shown.
        port: Port of the web server; the next free one is taken if it is in use.
        host: Address that the server listens on; ``"0.0.0.0"`` also accepts other machines. Beyond this machine a
            browser needs the token that :attr:`url` has.
        reset: Begins new episodes, for the button. Default: the environment's ``reset``. False: there is no button.
        checkpoints: Policies to switch between.
        step_dt: Duration of a step [s]. Default: the environment's, else a 60th of a second.
        is_paced: Keep to real time, or to the speed that is chosen. Without, steps are taken as fast as possible.
        fps: Most pictures per second.

    Raises:
        ImportError: viser is not installed.
        TypeError: ``subject`` has no simulation.
        OSError: This machine has no such address, or no port is free.
        ValueError: There is no such port.
        IndexError: An environment that the simulation does not have.
        ConfigError: ``cfg`` has a problem.
    """

    def __init__(
        self,
        subject: object,
        env_ids: Sequence[int] | None = None,
        *,
        cfg: ViewerCfg | None = None,
        title: str = "",
        port: int = 8080,
        host: str = "127.0.0.1",
        reset: Callable[[], object] | bool = True,
        checkpoints: Checkpoints | None = None,
        step_dt: float | None = None,
        is_paced: bool = True,
        fps: float = 30.0,
    ):
        if importlib.util.find_spec("viser") is None:
            raise ImportError('the live viewer needs viser: pip install "stripe-newton[viser]"')
        if not 1 <= port <= _MOST_PORT:  # viser would wait for its server without end
            raise ValueError(f"port: is {port}, must be from 1 to {_MOST_PORT}")
        self._env, self._sim = what_is_viewed(subject)
        self._cfg = viewer_cfg_of(self._env) if cfg is None else cfg
        self._cfg.validate()
        shown = range(min(self._sim.num_envs, _MOST_AT_FIRST)) if env_ids is None else env_ids
        self._interval, self._next_look = 1.0 / fps, 0.0
        self._is_seen = False
        """Whether a browser has been connected since before the last picture."""
        self._outside: TokenServer | None = None
        # The port that was asked for is the token server's, where there is one.
        self._server = serve(port if host in LOOPBACK else free_port(), title or "stripe-newton")
        try:
            self._step_dt = step_dt or (1.0 / 60.0 if self._env is None else self._env.step_dt)
            self._build([int(i) for i in shown], title, reset, is_paced, checkpoints)
            self._url = self._listen(host, port)
        except BaseException:
            self.close()
            raise

    def _build(
        self,
        env_ids: list[int],
        title: str,
        reset: Callable[[], object] | bool,
        is_paced: bool,
        checkpoints: Checkpoints | None,
    ) -> None:
        """Make scene and panels."""
        server, env, sim = self.server, self._env, self._sim
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        self.inbox = Inbox()
        begin = reset if callable(reset) else env.reset if reset and env is not None else None
        self.time = TimeControl(
            gui, self.inbox, self._step_dt, None if begin is None else lambda: self._reset(begin), is_paced
        )
        name = title or type(env if env is not None else sim).__name__
        self.status = StatusPanel(gui, name, self.time, env)
        with wp.ScopedDevice(sim.device):
            self.scene = LiveScene(server, sim, env_ids)
        tabs = self._tabs = gui.add_tab_group()
        with tabs.add_tab("View"):
            self.envs = EnvChoice(gui, self.inbox, sim.env_origins, env_ids, self._show_chosen)
            self.camera = CameraControl(server, gui, self.inbox, sim, self._cfg)
            self.overlays = Overlays(server, gui, self.inbox, sim, env, self.camera.view_frame)
            self.pictures = None if env is None else CameraPictures(server, gui, self.inbox, env)
        self.camera.look_at(self.scene, self.envs.chosen)
        self._backdrop = Backdrop(server, sim.lights, self.camera.radius, self.camera.azimuth)
        self._backdrop.set_grounds(self.scene.grounds)
        self.commands: CommandPanel | None = None
        self.joints: JointPanel | None = None
        self.pushes: Pushes | None = None
        self.plots: PlotPanel | None = None
        if env is not None:
            self._build_panels(env, tabs)
        self.policy: CheckpointPanel | None = None
        if checkpoints is not None:
            with tabs.add_tab("Policy"):
                self.policy = CheckpointPanel(gui, self.inbox, checkpoints, self._begin_returns)
        self._broken = set[str]()
        self._pace = BrowserPace(server)
        self._panels = self._make_updates()
        self._draw()

    def _build_panels(self, env: ViewedEnv, tabs: viser.GuiTabGroupHandle) -> None:
        """Make the panels that an environment has beyond a scene."""
        gui, inbox = self.server.gui, self.inbox
        with tabs.add_tab("Act"):
            self.commands = CommandPanel(gui, inbox, env, lambda: self.envs.chosen)
            if hasattr(env.sim, "enable_external_wrench"):
                self.pushes = Pushes(gui, inbox, env, self.camera, lambda: self.envs.chosen)
                self.pushes.attach(self.scene)
        self.plots = PlotPanel(gui, tabs.add_tab("Plots"), inbox, env, lambda: self.envs.chosen)
        self.plots.add(self.plots.names[0])
        self.plots.add()

    def _listen(self, host: str, port: int) -> str:
        """The address for browsers, after opening it to other machines if ``host`` says so."""
        own = f"http://{LOOPBACK[1]}:{self.server.get_port()}"
        if host in LOOPBACK:
            return own
        self._outside = TokenServer(host, port, self.server.get_port())
        name = socket.gethostname() if host in ("", "0.0.0.0", "::") else host
        return f"http://{name}:{self._outside.port}/?token={self._outside.token}"

    # -- for the caller

    @property
    def url(self) -> str:
        """Address to open in a browser; with the token where other machines can reach it."""
        return self._url

    @property
    def server(self) -> viser.ViserServer:
        """The web server, for widgets and shapes of one's own.

        Raises:
            RuntimeError: The viewer is closed.
        """
        if self._server is None:
            raise RuntimeError("LiveViewer: the viewer is closed; make a new one")
        return self._server

    def is_running(self) -> bool:
        """Whether the viewer is still open."""
        return self._server is not None

    def has_clients(self) -> bool:
        """Whether a browser shows the page."""
        return self._server is not None and bool(self._server.get_clients())

    def steps(self, limit: int | None = None) -> Iterator[int]:
        """Count the steps that the caller takes, each when it is due.

        Between two of them the page is served: clicks are acted on, pictures are drawn. While time is paused it does
        only that.

        Args:
            limit: End after so many steps. Default: when the viewer is closed.

        Yields:
            Numbers from 0; the caller takes a step for each.
        """
        taken = 0
        while self.is_running() and (limit is None or taken < limit):
            self._serve_page()
            if not self.is_running():  # a panel may have closed it
                return
            if not self.time.takes_step():
                self.time.wait()
                continue
            yield taken
            taken += 1
            self.after_step()

    def after_step(self) -> None:
        """Count a step that was taken; only loops without :meth:`steps` call it, before :meth:`update`."""
        self.time.count_step()
        if self.status.meter is not None:
            self.status.meter.after_step()
        if self.commands is not None:
            self.commands.after_step()
        if self.pushes is not None:
            self.pushes.before_step()
        if self.plots is not None:
            self.plots.after_step()

    def update(self, dt: float | None = None) -> None:
        """Show the present state, and return when time goes on: while it is paused, this serves the page.

        Args:
            dt: Not used; kept for callers of earlier versions.

        Raises:
            RuntimeError: The viewer is closed.
        """
        _ = self.server  # raises if it is closed
        self._serve_page(at_once=True)
        self._wait_while_paused()

    def serve(self) -> None:
        """As :meth:`update`, with a picture only where one is due: for loops that do not wait for the page."""
        self._serve_page()
        self._wait_while_paused()

    def hold(self) -> None:
        """Show the present state until the viewer is closed, for what does not move but by sliders of its joints."""
        self.time.hide()
        self.status.hide()
        if self._env is None and hasattr(self._sim, "forward") and self._sim.template.joint_count:
            with self._tabs.add_tab("Joints"):
                self.joints = JointPanel(self.server.gui, self.inbox, self._sim)
        while self.is_running():
            self._serve_page()
            self.time.wait()

    def _wait_while_paused(self) -> None:
        while self.is_running() and self.time.is_paused and not self.time.takes_step():
            self.time.wait()
            self._serve_page()

    def set_status(self, lines: Mapping[str, str]) -> None:
        """Show further lines of text above the panels, by name, such as the iteration of a training."""
        self.status.set_lines(lines)

    def close(self) -> None:
        """Stop the server. A second call does nothing."""
        if self._outside is not None:
            self._outside.close()
            self._outside = None
        if self._server is not None:
            server, self._server = self._server, None
            with quiet():
                server.stop()

    def __enter__(self) -> LiveViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- parts

    def _serve_page(self, at_once: bool = False) -> None:
        """Act on clicks, and draw a picture if one is due and somebody looks."""
        self.inbox.run()
        self._tell_problems()
        now = time.monotonic()
        self._is_seen &= self.has_clients()
        if not self.has_clients() or (now < self._next_look and not at_once):
            return
        self._next_look = now + self._interval
        if not self._is_seen and self.plots is not None:
            self.plots.clear()  # nothing was read while nobody looked: a line across that time would be wrong
        self._is_seen = True
        if at_once or self._pace.is_ready():
            self._draw()
        elif (plots := self.plots) is not None:  # a slow browser gets few pictures, but whole curves
            with wp.ScopedDevice(self._sim.device), torch.no_grad():
                self._try("plots", lambda: plots.sample(self.time.steps * self._step_dt))

    @torch.no_grad()
    def _draw(self) -> None:
        with wp.ScopedDevice(self._sim.device), self.server.atomic():
            chosen = self.envs.chosen
            if (env := self._env) is not None:
                self._try("markers", lambda: env.update_debug_vis())
            self.scene.read()
            drags = self.pushes is not None and self.pushes.is_dragging
            self.camera.update(self.scene, chosen, stands=drags)
            frame = self.camera.view_frame
            self.scene.place(frame)
            self._backdrop.update(frame)
            self.camera.look_through(self.scene)
            for name, update in self._panels.items():
                self._try(name, update)
        self._pace.count_picture(self.camera.fov_rad)

    def _make_updates(self) -> dict[str, Callable[[], None]]:
        """Functions that bring each panel up to date at a picture, by the panel's name."""
        updates: dict[str, Callable[[], None]] = {
            "status": lambda: self.status.update(self.envs.chosen),
        }
        for name in self.overlays.layers:
            updates[f"drawing {name}"] = partial(self._draw_layer, name)
        if (pictures := self.pictures) is not None:
            updates["cameras"] = lambda: pictures.update(self.envs.chosen)
        if (commands := self.commands) is not None:
            updates["commands"] = commands.update
        if (policy := self.policy) is not None:
            updates["policy"] = policy.update
        if (plots := self.plots) is not None:
            updates["plots"] = lambda: plots.update(self.time.steps * self._step_dt)
        return updates

    def _draw_layer(self, name: str) -> None:
        self.overlays.draw(name, self.scene.env_ids, self.envs.chosen)

    def _try(self, name: str, update: Callable[[], None]) -> None:
        """Update a panel; one that fails is left out from then on, as what it shows must not end by it."""
        if name in self._broken:
            return
        try:
            update()
        except Exception as error:  # of whatever kind: an environment may have anything in it
            self._broken.add(name)
            self.inbox.tell(f"{name}: no longer updated", error)

    def _show_chosen(self) -> None:
        """Show the environments that the inputs say."""
        shown, chosen = self.envs.shown, self.envs.chosen
        if shown != self.scene.env_ids:
            with wp.ScopedDevice(self._sim.device), self.server.atomic():
                self.scene.remove()
                self.scene = LiveScene(self.server, self._sim, shown)
                self._backdrop.set_grounds(self.scene.grounds)
                if self.pushes is not None:
                    self.pushes.attach(self.scene)
        self.camera.jump(self.scene, chosen)
        if self.commands is not None:
            self.commands.follow_choice()
        if self.plots is not None:
            self.plots.clear()
        self._draw()

    def _reset(self, begin: Callable[[], object]) -> None:
        begin()
        self._begin_returns()
        self._draw()

    def _begin_returns(self) -> None:
        """Count returns anew, as those before are of cut episodes or of another policy."""
        if self.status.meter is not None:
            self.status.meter.clear()

    def _tell_problems(self) -> None:
        """Show errors of panels on the page."""
        if not self.has_clients():
            return
        problems, self.inbox.problems = self.inbox.problems, []
        for problem in problems:
            for client in self.server.get_clients().values():
                with contextlib.suppress(OSError, RuntimeError):  # of a browser that has just gone
                    client.add_notification("This did not work", problem, color="red")
