# SPDX-License-Identifier: Apache-2.0
"""Manager-based velocity tasks: the configs that quadruped and humanoid, flat and rough ground share.

A command is a forward velocity, a sideways velocity and a yaw rate. New ones are drawn every few seconds, and the robot
is rewarded for following them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.assets.asset_base import AssetInitialStateCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import EventTermCfg, SceneEntityCfg, TerminationTermCfg
from stripe_newton.managers.manager_base import terms_of
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sensors import ContactSensorCfg, GridPatternCfg, RayCasterCfg
from stripe_newton.sim import (
    DistantLightCfg,
    DomeLightCfg,
    MuJoCoSolverCfg,
    PreviewSurfaceCfg,
    RigidBodyMaterialCfg,
    SimulationCfg,
)
from stripe_newton.terrains import ROUGH_TERRAINS_CFG, TerrainImporterCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.robot_scene import RobotSceneCfg

from .manager_terms import (
    ActionsCfg,
    CommandsCfg,
    CurriculumCfg,
    EventsCfg,
    ObservationsCfg,
    RewardsCfg,
    RoughEventsCfg,
    RoughObservationsCfg,
    RoughTerminationsCfg,
    TerminationsCfg,
    bodies,
    contacts,
)

__all__ = [
    "RoughSceneCfg",
    "VelocityEnvCfg",
    "VelocityPPORunnerCfg",
    "VelocityRoughEnvCfg",
    "VelocityRoughPPORunnerCfg",
    "VelocitySceneCfg",
]

ROBOT_PATH = "{ENV_REGEX_NS}/Robot"

BodyNames = str | list[str]
"""Bodies by one expression, or by several."""


def names_of(names: BodyNames) -> list[str]:
    """Several expressions, also of one."""
    return [names] if isinstance(names, str) else list(names)


@configclass
class VelocitySceneCfg(RobotSceneCfg):
    """Flat scene: a robot with a contact sensor, on a plane."""

    contact_forces: ContactSensorCfg = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*", track_air_time=True)


@configclass
class RoughSceneCfg(VelocitySceneCfg):
    """Rough scene: ten levels of stairs, blocks, slopes and random ground, and a height scanner on the robot."""

    ground: AssetBaseCfg | None = None  # the terrain is the ground
    terrain: TerrainImporterCfg = TerrainImporterCfg(
        prim_path="/World/ground",
        terrain_type="generator",
        terrain_generator=ROUGH_TERRAINS_CFG.replace(curriculum=True, seed=0, border_width=5.0),
        max_init_terrain_level=5,
        visual_material=PreviewSurfaceCfg(diffuse_color=(0.34, 0.33, 0.29)),
    )
    sky: AssetBaseCfg = AssetBaseCfg(prim_path="/World/Light", spawn=DomeLightCfg(intensity=1000.0))
    sun: AssetBaseCfg = AssetBaseCfg(
        prim_path="/World/Sun",
        spawn=DistantLightCfg(intensity=2300.0),
        init_state=AssetInitialStateCfg(rot=(0.20, 0.56, 0.0, 0.80)),
    )
    height_scanner: RayCasterCfg = RayCasterCfg(
        prim_path=MISSING,
        # from far above, so that no hill is higher than the origin of a ray
        offset=RayCasterCfg.OffsetCfg(pos=(0.0, 0.0, 20.0)),
        ray_alignment="yaw",
        pattern_cfg=GridPatternCfg(resolution=0.1, size=(1.6, 1.0)),
        mesh_prim_paths=["/World/ground"],
    )


@configclass
class VelocityEnvCfg(ManagerBasedRLEnvCfg):
    """Base of the flat velocity tasks: steps of 20 ms with four physics steps, episodes of 20 s.

    The fields ``robot``, ``base``, ``feet``, ``thighs`` and ``falls_on`` make a task of another robot. They set the
    bodies of all terms that do not name others.
    """

    robot: ArticulationCfg | None = None
    """Robot that takes the place of the one in ``scene``, where it is then found; its ``prim_path`` may be missing."""
    base: str = MISSING
    """Body that carries the payload and the height scanner."""
    feet: BodyNames = MISSING
    """Bodies that touch the ground when the robot walks: their air time is rewarded, their friction differs."""
    thighs: BodyNames = []
    """Bodies whose contacts cost reward."""
    falls_on: BodyNames | None = None
    """Bodies whose contact ends an episode; None: the base."""
    decimation: int = 4
    episode_length_s: float = 20.0
    viewer: ViewerCfg = ViewerCfg(
        origin_type="asset_root",
        asset_name="Robot",
        eye=(1.7, -1.9, 0.8),
        lookat=(0.0, 0.0, -0.08),
        num_shown=6,
    )
    sim: SimulationCfg = SimulationCfg(
        dt=0.005,
        solver=MuJoCoSolverCfg(iterations=10, ls_iterations=20, njmax=120, nconmax=30, drive_limits=True),
        # MuJoCo takes the larger friction of two shapes: little on the ground lets the randomised soles decide.
        physics_material=RigidBodyMaterialCfg(static_friction=0.5, dynamic_friction=0.5),
    )
    scene: VelocitySceneCfg = MISSING
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    commands: CommandsCfg = CommandsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()

    def __post_init__(self) -> None:
        self.complete()

    def complete(self) -> None:
        """Set the robot of the scene, and the bodies of terms that have none or those of a former call."""
        super().complete()
        if self.scene is not MISSING and self.scene.scenery_file is not None:
            self._fit_scenery()
        if self.robot is not None:
            self.scene.robot, self.robot = self.robot.replace(prim_path=ROBOT_PATH), None
        if MISSING in (self.base, self.feet):
            return  # which validate() reports
        before = getattr(self, "_completed", {})
        self._completed: dict[str, SceneEntityCfg] = {}
        for path, term, key, names in self._body_terms():
            if term is None or term.params.get(key, MISSING) not in (MISSING, before.get(path, MISSING)):
                continue
            term.params[key] = (bodies if key == "asset_cfg" else contacts)(*names)
            self._completed[path] = term.params[key].copy()
        if not self.thighs and "undesired_contacts" in self._completed:
            self.rewards.undesired_contacts = None  # no body is undesired

    def _fit_scenery(self) -> None:
        """Start where the scenery has room for a robot, and end episodes of robots that have left it."""
        events, ends = terms_of(self.events), terms_of(self.terminations)
        reset = events.get("reset_base")
        bounds = reset.params.get("pose_range", {}) if isinstance(reset, EventTermCfg) else {}
        for axis in ("x", "y"):
            if bounds.get(axis) == (-0.5, 0.5):  # the default: half a metre from a clear place there may be a table
                bounds[axis] = (0.0, 0.0)
        if isinstance(self.terminations, TerminationsCfg) and ends.get("out_of_bounds") is None:
            self.terminations.left_scenery = TerminationTermCfg(
                func=mdp.terrain_out_of_bounds, params={"distance_buffer": 0.0}, time_out=True
            )

    def _body_terms(self) -> Iterator[tuple[str, Any, str, list[str]]]:
        """Parameters of terms that are bodies: a name for them, the term, the parameter and the expressions."""
        feet, trunk = names_of(self.feet), [self.base]
        falls = trunk if self.falls_on is None else names_of(self.falls_on)
        # A caller may have replaced the configs of these managers by dicts, or by None.
        events, rewards, ends = (terms_of(cfg) for cfg in (self.events, self.rewards, self.terminations))
        yield "payload", events.get("payload"), "asset_cfg", trunk
        yield "centre_of_mass", events.get("centre_of_mass"), "asset_cfg", trunk
        yield "soles", events.get("soles"), "asset_cfg", feet
        yield "feet_air_time", rewards.get("feet_air_time"), "sensor_cfg", feet
        yield "feet_slide", rewards.get("feet_slide"), "sensor_cfg", feet  # of robots with two feet
        yield "feet_slide.asset", rewards.get("feet_slide"), "asset_cfg", feet
        yield "undesired_contacts", rewards.get("undesired_contacts"), "sensor_cfg", names_of(self.thighs)
        yield "base_contact", ends.get("base_contact"), "sensor_cfg", falls


@configclass
class VelocityRoughEnvCfg(VelocityEnvCfg):
    """Base of the rough velocity tasks, with a height scan."""

    scene: RoughSceneCfg = MISSING
    observations: RoughObservationsCfg = RoughObservationsCfg()
    terminations: RoughTerminationsCfg = RoughTerminationsCfg()
    events: RoughEventsCfg = RoughEventsCfg()
    curriculum: CurriculumCfg = CurriculumCfg()

    def complete(self) -> None:
        super().complete()
        if self.scene is not MISSING:
            self.scene.height_scanner.prim_path = f"{ROBOT_PATH}/{self.base}"

    def _fit_scenery(self) -> None:
        """As on flat ground; and rays start below the ceiling, and the generated terrain is not made in vain."""
        super()._fit_scenery()
        end = terms_of(self.terminations).get("out_of_bounds")
        if isinstance(end, TerminationTermCfg) and end.params.get("distance_buffer") == 3.0:
            end.params["distance_buffer"] = 0.0  # 3 m from the walls there is no room left
        offset = self.scene.height_scanner.offset
        if offset.pos == (0.0, 0.0, 20.0):
            offset.pos = (0.0, 0.0, 0.3)
        if self.scene.terrain.terrain_type == "generator" and self.scene.scenery_options.ground != "keep":
            self.scene.terrain.terrain_type = "plane"


@configclass
class VelocityPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for walking on flat ground."""

    num_steps_per_env: int = 24
    max_iterations: int = 300
    save_interval: int = 100
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(512, 256, 128),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(512, 256, 128), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.01, learning_rate=1.0e-3)


@configclass
class VelocityRoughPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for walking on rough ground."""

    max_iterations: int = 1500
