# SPDX-License-Identifier: Apache-2.0
"""A quadruped walks as commanded among trunks: ``Stripe-Forest-Walk-Quadruped-v0``.

Woods get denser, hills higher and the ground more cluttered from level to level. The robot is told a velocity that
knows nothing of the trees: it has to give way to them, and in training to touch none. ``-Play-v0`` is ordinary woods
that it was not trained in, where an episode ends when it has fallen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from stripe_newton.configclass import configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import (
    CurriculumTermCfg,
    EventTermCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.rl import RslRlPpoAlgorithmCfg
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.sensors import ContactSensorCfg, GridPatternCfg, RayCasterCfg
from stripe_newton.sim import MuJoCoSolverCfg, RigidBodyMaterialCfg, SimulationCfg
from stripe_newton.spec import SceneSpec, TaskEnvCfg, TileGridSpec, TrainingSpec
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.robots import QUADRUPED_CFG
from stripe_tasks.velocity.manager_based import (
    ActionsCfg,
    CommandsCfg,
    RoughEventsCfg,
    RoughTerminationsCfg,
    ScanningCfg,
    VelocityRoughPPORunnerCfg,
    contacts,
    noise,
    randomize,
)
from stripe_tasks.velocity.quadruped import QuadrupedRewardsCfg

from .scenes import PLACES, ForestSpec

__all__ = ["LEVELS", "ForestPPORunnerCfg", "ForestWalkPPORunnerCfg", "play_cfg", "training", "walk_cfg", "woods"]

LEVELS = 8
"""Levels of the curriculum."""
TYPES = 4
TILE = (40.0, 40.0)
SCENE_SEED, PLAY_SEED = 0, 1000
BELLY = 0.13
"""Height of the root over the ground at which the robot lies on it [m]; it stands at 0.3 m."""
VIEWER = ViewerCfg(
    origin_type="asset_heading",
    asset_name="Robot",
    eye=(-1.9, -0.4, 0.65),
    lookat=(1.2, 0.0, 0.3),
    fov=52.0,
    near=1.5,
    resolution=(960, 540),
)


def woods() -> TileGridSpec:
    """Eight levels of forest, from an open one on level ground to a dense one on rough slopes; four of each."""
    specs = []
    for level in range(LEVELS):
        share = level / (LEVELS - 1)
        specs.append(
            ForestSpec(
                TILE,
                density=100.0 + 800.0 * share,
                relief=1.0 + 6.0 * share,
                micro=0.04 + 0.10 * share,
                resolution=0.2,
                clutter=0.2 + 1.0 * share,
                undergrowth=0.35,
            )
        )
    return TileGridSpec(specs, TYPES, max_init_level=3)


@configclass
class WalkCommandsCfg(CommandsCfg):
    """Ahead more than back, turning to a heading."""

    base_velocity: mdp.UniformVelocityCommandCfg = CommandsCfg().base_velocity.replace(
        ranges=mdp.UniformVelocityCommandCfg.Ranges(
            lin_vel_x=(-0.5, 1.0), lin_vel_y=(-0.5, 0.5), ang_vel_z=(-1.0, 1.0), heading=(-math.pi, math.pi)
        )
    )


@configclass
class WalkPolicyCfg(ScanningCfg):
    """Itself, the heights around it, and how near trunks are in 32 directions."""

    height_scan: ObservationTermCfg = ObservationTermCfg(
        func=mdp.height_scan_over,
        params={"sensor": SceneEntityCfg("height_scanner"), "obstacles": SceneEntityCfg("obstacles")},
        noise=noise(0.1),
        clip=(-1.0, 1.0),
    )
    trunks: ObservationTermCfg = ObservationTermCfg(
        func=mdp.obstacle_proximity, params={"below": 0.1}, noise=noise(0.02)
    )


@configclass
class WalkObservationsCfg:
    """The policy sees noisy sensors, the critic the truth."""

    policy: WalkPolicyCfg = WalkPolicyCfg()
    critic: WalkPolicyCfg = WalkPolicyCfg(enable_corruption=False)


@configclass
class ForestEventsCfg(RoughEventsCfg):
    """Episodes start where there is room, in any direction."""

    reset_base: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_from_terrain,
        mode="reset",
        params={"pose_range": {"yaw": (-math.pi, math.pi)}, "velocity_range": {}, "move_origin": True},
    )

    def __post_init__(self) -> None:
        randomize(self, "base", ".*_foot")


@configclass
class ForestTerminationsCfg(RoughTerminationsCfg):
    """An episode ends when the body touches anything, where the forest ends, or after its full length."""

    base_contact: Any = RoughTerminationsCfg().base_contact
    bad_orientation: TerminationTermCfg | None = None
    on_belly: TerminationTermCfg | None = None

    def __post_init__(self) -> None:
        if self.base_contact is not None:
            self.base_contact.params["sensor_cfg"] = contacts("base")


FALLS = {
    "base_contact": None,
    "bad_orientation": TerminationTermCfg(func=mdp.bad_orientation, params={"limit_angle": 1.0}),
    "on_belly": TerminationTermCfg(func=mdp.root_height_over_ground_below_minimum, params={"minimum_height": BELLY}),
}
"""What ends an episode of play: a robot on its side, its back or its belly. To brush against a tree is no fall."""


@configclass
class ForestRewardsCfg(QuadrupedRewardsCfg):
    """As on rough ground, and nothing is worse than to run into a tree or to fall."""

    flat_orientation_l2: Any = None
    fallen: RewardTermCfg | None = RewardTermCfg(
        func=mdp.is_terminated_term, weight=-150.0, params={"term_keys": "base_contact"}
    )


@configclass
class WalkCurriculumCfg:
    """Who lasts goes on to denser and steeper woods."""

    terrain_levels: CurriculumTermCfg = CurriculumTermCfg(func=mdp.terrain_levels_survival)


def training(scene: SceneSpec | None = None, **changes: Any) -> TrainingSpec:
    """The task of walking, in a scene; :func:`woods` by default.

    Args:
        scene: Where.
        changes: Other fields of the specification.
    """
    fields: dict[str, Any] = {
        "observations": WalkObservationsCfg(),
        "actions": ActionsCfg(),
        "rewards": ForestRewardsCfg(),
        "terminations": ForestTerminationsCfg(),
        "events": ForestEventsCfg(),
        "commands": WalkCommandsCfg(),
        "curriculum": WalkCurriculumCfg(),
        "obstacles": ObstaclesCfg(slots=8, reach=0.9, sight=3.0),
        "sensors": {
            "contact_forces": ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*", track_air_time=True),
            "height_scanner": RayCasterCfg(
                prim_path="{ENV_REGEX_NS}/Robot/base",
                offset=RayCasterCfg.OffsetCfg(pos=(0.0, 0.0, 20.0)),
                ray_alignment="yaw",
                pattern_cfg=GridPatternCfg(resolution=0.1, size=(1.6, 1.0)),
                mesh_prim_paths=["/World/ground"],
            ),
        },
        "sim": SimulationCfg(
            dt=0.005,
            solver=MuJoCoSolverCfg(iterations=10, ls_iterations=20, njmax=180, nconmax=48, drive_limits=True),
            physics_material=RigidBodyMaterialCfg(static_friction=0.5, dynamic_friction=0.5),
        ),
        **changes,
    }
    return TrainingSpec(scene=scene or woods(), robot=QUADRUPED_CFG, **fields)


def walk_cfg() -> TaskEnvCfg:
    """Config of ``Stripe-Forest-Walk-Quadruped-v0``."""
    return training().to_env_cfg(VIEWER, seed=SCENE_SEED)


def ordinary_woods() -> ForestSpec:
    """Ordinary woods, 160 m by 160 m of 550 stems/ha, not trained in by any robot; they start in the middle."""
    places = {name: replace(place, margin=30.0) for name, place in PLACES.items()}
    return ForestSpec((160.0, 160.0), density=550.0, relief=5.0, resolution=0.2, places=places)


def to_play(make: Callable[..., TrainingSpec]) -> TrainingSpec:
    """A task of the forest in ordinary woods, where an episode ends when the robot has fallen."""
    spec = make(ordinary_woods(), curriculum=None, num_envs=64)
    rewards, terminations = spec.rewards.replace(fallen=None), spec.terminations.replace(**FALLS)
    return replace(spec, rewards=rewards, terminations=terminations)


def play_cfg() -> TaskEnvCfg:
    """Config of ``Stripe-Forest-Walk-Quadruped-Play-v0``."""
    return to_play(training).to_env_cfg(VIEWER, seed=PLAY_SEED)


@configclass
class ForestPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO for the forest."""

    max_iterations: int = 1200
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.006, learning_rate=1.0e-3)


@configclass
class ForestWalkPPORunnerCfg(ForestPPORunnerCfg):
    """PPO that makes it walk there."""

    experiment_name: str = "forest_walk_quadruped"
