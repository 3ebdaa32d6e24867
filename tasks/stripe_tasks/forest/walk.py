# SPDX-License-Identifier: Apache-2.0
"""Forest walk: a quadruped walks as commanded among trunks: ``Stripe-Forest-Walk-Quadruped-v0``.

From level to level woods get denser, hills higher and the ground more cluttered. Commands ignore the trees: the robot
has to avoid them, and in training a touch of the body ends the episode. ``Stripe-Forest-Walk-Quadruped-Play-v0`` is in
ordinary woods that no policy is trained in, where an episode ends when the robot has fallen.
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
from stripe_newton.specifications import SceneSpec, TaskEnvCfg, TileGridSpec, TrainingSpec
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.robots import QUADRUPED_CFG
from stripe_tasks.velocity.manager_based import VelocityRoughPPORunnerCfg
from stripe_tasks.velocity.manager_terms import (
    ActionsCfg,
    CommandsCfg,
    RewardsCfg,
    RoughEventsCfg,
    RoughTerminationsCfg,
    ScanningCfg,
    bodies,
    contacts,
    noise,
)

from .scenes import PLACES, ForestSpec

__all__ = ["LEVELS", "ForestPPORunnerCfg", "ForestWalkPPORunnerCfg", "play_cfg", "training", "walk_cfg", "woods"]

LEVELS = 8
"""Levels of the curriculum."""
TYPES = 4
"""Different tiles of each level."""
TILE = (40.0, 40.0)
"""Size of a tile [m]."""
SCENE_SEED, PLAY_SEED = 0, 1000
"""Seeds of the scenes for training and for play, so that play shows other trees."""
BELLY = 0.13
"""Height of the root over the ground below which the robot lies on its belly [m]; it stands at 0.3 m."""
VIEWER = ViewerCfg(
    origin_type="asset_heading",
    asset_name="Robot",
    eye=(-1.9, -0.4, 0.65),
    lookat=(1.2, 0.0, 0.3),
    fov=52.0,
    near=1.5,
)


def woods() -> TileGridSpec:
    """Scene for training: eight levels of forest, from open woods on level ground to dense woods on rough slopes."""
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
    """Command: more forward than backward velocity, turning to a heading."""

    base_velocity: mdp.UniformVelocityCommandCfg = CommandsCfg().base_velocity.replace(
        ranges=mdp.UniformVelocityCommandCfg.Ranges(
            lin_vel_x=(-0.5, 1.0), lin_vel_y=(-0.5, 0.5), ang_vel_z=(-1.0, 1.0), heading=(-math.pi, math.pi)
        )
    )


@configclass
class WalkPolicyCfg(ScanningCfg):
    """Observations of the robot itself, the heights around it, and the proximity of trunks in 32 directions."""

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
    """Observations: with noise for the policy, without noise for the critic."""

    policy: WalkPolicyCfg = WalkPolicyCfg()
    critic: WalkPolicyCfg = WalkPolicyCfg(enable_corruption=False)


@configclass
class ForestEventsCfg(RoughEventsCfg):
    """Events: episodes start at a place with room for the robot, in any direction."""

    reset_base: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_from_terrain,
        mode="reset",
        params={"pose_range": {"yaw": (-math.pi, math.pi)}, "velocity_range": {}, "move_origin": True},
    )

    def __post_init__(self) -> None:
        for term, names in ((self.payload, "base"), (self.centre_of_mass, "base"), (self.soles, ".*_foot")):
            if term is not None:
                term.params["asset_cfg"] = bodies(names)


@configclass
class ForestTerminationsCfg(RoughTerminationsCfg):
    """An episode ends when the body touches anything, near the edge of the forest, or after its full length."""

    base_contact: TerminationTermCfg | None = RoughTerminationsCfg().base_contact
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
"""Terminations of play: a robot on its side, its back or its belly. Brushing against a tree is no fall."""


@configclass
class ForestRewardsCfg(RewardsCfg):
    """Rewards as on rough ground, with a high cost of running into a tree or falling."""

    flat_orientation_l2: RewardTermCfg | None = None
    fallen: RewardTermCfg | None = RewardTermCfg(
        func=mdp.is_terminated_term, weight=-150.0, params={"term_keys": "base_contact"}
    )

    def __post_init__(self) -> None:
        if self.feet_air_time is not None:
            self.feet_air_time.params["sensor_cfg"] = contacts(".*_foot")
        if self.undesired_contacts is not None:
            self.undesired_contacts.params["sensor_cfg"] = contacts(".*_thigh", ".*_calf")


@configclass
class WalkCurriculumCfg:
    """Curriculum: robots that survive their episodes go on to denser and steeper woods."""

    terrain_levels: CurriculumTermCfg = CurriculumTermCfg(func=mdp.terrain_levels_survival)


def training(scene: SceneSpec | None = None, **changes: Any) -> TrainingSpec:
    """Specification of the task of walking.

    Args:
        scene: Scene to walk in; :func:`woods` by default.
        changes: Other fields of the specification, which override those of this task.
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
            # more room than on open ground: trunks, rocks and logs add contacts
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
    """Scene for play: ordinary woods of 160 m by 160 m with 550 stems/ha; robots start near the middle."""
    places = {name: replace(place, margin=30.0) for name, place in PLACES.items()}
    return ForestSpec((160.0, 160.0), density=550.0, relief=5.0, resolution=0.2, places=places)


def to_play(make: Callable[..., TrainingSpec]) -> TrainingSpec:
    """Change a task of the forest to play: in ordinary woods, where an episode ends when the robot has fallen."""
    spec = make(ordinary_woods(), curriculum=None, num_envs=64)
    # the cost of falling names a termination that play does not have
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
    """PPO for forest walk."""

    experiment_name: str = "forest_walk_quadruped"
