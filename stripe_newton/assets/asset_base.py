# SPDX-License-Identifier: Apache-2.0
"""Asset bases: of all assets, and of those that have bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar

import newton
import torch

from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.matching import match_names
from stripe_newton.math import combine_frame_transforms
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.scene_context import authored_path, current_scene, is_env_path

from .layout import Layout, select_layout
from .parent_pose import pose_above
from .root_data import RootData
from .root_writer import EnvIds, RootWriter

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["AssetBase", "AssetBaseCfg", "AssetInitialStateCfg", "BoundAsset"]


@configclass
class AssetInitialStateCfg:
    """Pose at the start of an episode, in the frame of the prim above: of the environment, where nothing is between."""

    pos: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    """Position of the root [m]; ``None`` keeps the file's."""
    rot: tuple[float, float, float, float] | None = (0.0, 0.0, 0.0, 1.0)
    """Orientation of the root, quaternion (x, y, z, w); ``None`` keeps the file's."""

    @property
    def rot_xyzw(self) -> tuple[float, float, float, float] | None:
        """:attr:`rot` as the package reads it; a subclass may keep another order in the field."""
        return self.rot

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.rot is not None and not 0.99 < sum(x * x for x in self.rot) ** 0.5 < 1.01:
            yield "rot", f"is {self.rot}, must be a unit quaternion in the order (x, y, z, w)"


@configclass
class AssetBaseCfg:
    """A static asset: ground, light, obstacle. :class:`ArticulationCfg` and :class:`RigidObjectCfg` derive from it."""

    MAY_BE_NONE: ClassVar[bool] = True

    prim_path: str = MISSING
    """Prim path: ``/World/envs/env_.*/Name`` or ``{ENV_REGEX_NS}/Name`` for one in every environment."""
    spawn: SpawnerCfg | None = None
    """Spawner config; ``None`` if the prim is there already."""
    init_state: AssetInitialStateCfg = AssetInitialStateCfg()
    """Pose at the start of an episode."""
    class_type: Callable[..., AssetBase] | None = None
    """Class that the scene makes of this config."""
    collision_group: int = 0
    """Ignored: environments never collide with each other, and shared assets collide with all."""
    debug_vis: bool = False
    """Ignored: assets draw no markers."""

    IGNORED: ClassVar[dict[str, str]] = {
        "collision_group": "environments never collide with each other, and shared assets collide with all",
        "debug_vis": "assets draw no markers",
    }


class AssetBase:
    """An asset of the scene under construction.

    The constructor spawns the prim; :meth:`initialize` binds to the model once it is built. A static asset has
    nothing to bind to.
    """

    cfg: AssetBaseCfg
    """The config."""
    path: str
    """Prim path in the first environment, or in what all share."""

    def __init__(self, cfg: AssetBaseCfg):
        cfg.validate()
        self.cfg = cfg.copy()
        # By the context, not by an argument: so that assets are made as in Isaac Lab, Articulation(cfg).
        scene = self._scene = current_scene()
        self.path = authored_path(self.cfg.prim_path)
        if self.cfg.spawn is not None:
            start = self.cfg.init_state
            self.cfg.spawn.spawn(self.cfg.prim_path, start.pos, start.rot_xyzw)
        elif not scene.stage.GetPrimAtPath(self.path).IsValid():
            raise ValueError(
                f"{type(self).__name__} at '{self.cfg.prim_path}': no prim there and 'spawn' is None; "
                "set spawn or the path of an existing prim"
            )
        scene.register(self)

    @property
    def in_every_env(self) -> bool:
        """Whether each environment has one."""
        return is_env_path(self.path)

    def names_of(self, kind: str) -> list[str] | None:
        """Names among which terms choose joints (``kind="joint"``) or bodies (``"body"``); None if it has no such."""
        return None

    def arrange(self, builder: newton.ModelBuilder) -> None:
        """Change which rows of the builder of one environment things have, before anything refers to them."""

    def prepare(self, layouts: Sequence[Layout], builder: newton.ModelBuilder) -> None:
        """Write the config onto the builder of one environment, before it is replicated.

        Args:
            layouts: Articulations of an environment; a free rigid body is one of them.
            builder: Builder of one environment.
        """

    def initialize(self, sim: Simulation) -> None:
        """Bind to the built model."""

    def reset(self, env_ids: EnvIds = None) -> None:
        """Clear what belongs to the last episode."""

    def write_data_to_sim(self) -> None:
        """Write what was set since the last step to the simulation."""

    def update(self, dt: float) -> None:
        """Do what follows ``dt`` seconds of physics; nothing by default, and a step then does not call it."""


class BoundAsset(RootWriter, AssetBase):
    """An asset with bodies, bound to its rows in the model's arrays."""

    @property
    def data(self) -> RootData:
        """State of the asset."""
        return self._data

    @property
    def native_data(self) -> RootData:
        """State of the asset with quaternions (x, y, z, w), also where a subclass hands out another form as ``data``.

        Code of the package that reads an asset uses this.
        """
        return self._data

    @property
    def num_instances(self) -> int:
        """Number of environments."""
        return self._sim.num_envs

    def names_of(self, kind: str) -> list[str] | None:
        return list(self.layout.joint_names if kind == "joint" else self.layout.body_names)

    def _find_layout(self, layouts: Sequence[Layout], root_path: str | None = None) -> Layout:
        """The one articulation at or below the asset's prim.

        Raises:
            ConfigError: if there is none, or several and ``root_path`` chooses none of them.
        """
        where = f"{type(self).__name__} '{self.cfg.prim_path}'"
        if not (self.in_every_env or self._scene.builder.template_root == "/"):
            raise ConfigError([f"{where}: bodies belong in environments, put it below '/World/envs/env_.*'"])
        return select_layout(layouts, self.path, root_path, where)

    def _place_root(self, builder: newton.ModelBuilder) -> None:
        """Put a free root at the initial pose of the config; a fixed one is where its prim is."""
        start = self.cfg.init_state
        pos, rot = start.pos, start.rot_xyzw
        if pos is not None and rot is not None:
            above = pose_above(self._scene.stage, self.path)
            if above is not None:
                there = combine_frame_transforms(above[:3], above[3:], torch.tensor(pos), torch.tensor(rot))
                pos, rot = tuple(there[0].tolist()), tuple(there[1].tolist())
        self.layout.place_root(builder, pos, rot)

    def initialize(self, sim: Simulation) -> None:
        self._sim = sim
        self._ALL_INDICES = torch.arange(sim.num_envs, device=sim.device)

    # -- bodies

    @property
    def num_bodies(self) -> int:
        """Number of bodies."""
        return len(self.layout.body_names)

    @property
    def body_names(self) -> list[str]:
        """Names of the bodies, root first."""
        return list(self.layout.body_names)

    def find_bodies(self, name_keys: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
        """Indices and names of the bodies that match regular expressions.

        Raises:
            ValueError: if an expression matches nothing.
        """
        return match_names(name_keys, self.layout.body_names, preserve_order, f"body of '{self.cfg.prim_path}'")

    def set_external_force_and_torque(
        self,
        forces: torch.Tensor,
        torques: torch.Tensor,
        positions: torch.Tensor | None = None,
        body_ids: Sequence[int] | slice | None = None,
        env_ids: EnvIds = None,
        is_global: bool = False,
    ) -> None:
        """Set the wrench that acts on bodies from the next step on, until a reset or the next call.

        Args:
            forces: Forces at the centre of mass, or at ``positions`` [N], shape ``(n, bodies, 3)``.
            torques: Torques [N m], same shape.
            positions: Points of attack relative to the centre of mass, in the same frame [m], same shape.
            body_ids: Bodies, default all.
            env_ids: Environments, default all.
            is_global: In the world frame; otherwise in the bodies' frames.
        """
        if positions is not None:  # the wrench is kept about the centre of mass, as Newton's body_f is
            torques = torques + torch.linalg.cross(positions, forces)
        self.write_native_wrench(forces, torques, body_ids, env_ids, is_global)

    def write_native_wrench(
        self,
        forces: torch.Tensor,
        torques: torch.Tensor,
        body_ids: Sequence[int] | slice | None = None,
        env_ids: EnvIds = None,
        is_global: bool = False,
    ) -> None:
        """Set the wrench about the centres of mass, also where a subclass composes it of several.

        Args:
            forces: Forces [N], shape ``(n, bodies, 3)``.
            torques: Torques [N m], same shape.
            body_ids: Bodies, default all.
            env_ids: Environments, default all.
            is_global: In the world frame; otherwise in the bodies' frames.
        """
        sim = self._sim
        sim.enable_external_wrench()
        ids = self.env_indices(env_ids).unsqueeze(1)
        bodies = self.layout.body_rows(body_ids, self.device).unsqueeze(0)
        sim.per_env(sim.external_wrench)[ids, bodies] = torch.cat((forces, torques), dim=-1)
        sim.per_env(sim.wrench_in_world)[ids, bodies] = is_global

    def _clear_wrench(self, ids: torch.Tensor) -> None:
        if self._sim.external_wrench is not None:
            rows = self.layout.body_rows(None, self.device)
            self._sim.per_env(self._sim.external_wrench)[ids.unsqueeze(1), rows] = 0.0
