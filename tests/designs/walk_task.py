# SPDX-License-Identifier: Apache-2.0
"""A task as a user writes it: an ant follows velocity commands beside a ball, with a term of each kind."""

from __future__ import annotations

import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import LabSceneCfg, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    ActionManagerCfg,
    CommandManagerCfg,
    CurriculumManagerCfg,
    CurriculumTermCfg,
    EventManagerCfg,
    EventTermCfg,
    ObjectManagerCfg,
    ObjectPoolCfg,
    ObservationGroupCfg,
    ObservationManagerCfg,
    ObservationTermCfg,
    RewardManagerCfg,
    RewardTermCfg,
    RunningNormCfg,
    TerminationManagerCfg,
    TerminationTermCfg,
)
from stripe_newton.noise import UniformNoiseCfg
from stripe_newton.sensors import ContactSensorCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    CuboidCfg,
    MassPropertiesCfg,
    MuJoCoSolverCfg,
    RigidBodyPropertiesCfg,
    SimulationCfg,
    SphereCfg,
)
from stripe_newton.terrains import TerrainImporterCfg
from stripe_tasks.energy import EnergyManagerCfg, cost_of_transport, energy_left
from stripe_tasks.robots import ANT_CFG


def solid(name: str, shape: type[SphereCfg] | type[CuboidCfg], pos: tuple[float, float, float], **size: object):
    """A rigid body of 0.2 kg."""
    spawn = shape(
        **size,
        rigid_props=RigidBodyPropertiesCfg(),
        collision_props=CollisionPropertiesCfg(),
        mass_props=MassPropertiesCfg(mass=0.2),
    )
    state = RigidObjectCfg.InitialStateCfg(pos=pos)
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=spawn, init_state=state)


@wp.func
def forward_velocity(env: int, robot: ArticulationData) -> float:
    """Speed of the root along the world's x axis [m/s]."""
    return robot.root_vel[env][0]


@wp.func
def spin(env: int, robot: ArticulationData, rng: wp.array[wp.uint32], rate: float):
    """Turn the root at up to ``rate`` [rad/s], as a disturbance."""
    turn = mdp.random.uniform_range(env, rng, wp.vec2(-rate, rate))
    robot.root_vel[env] = robot.root_vel[env] + wp.spatial_vector(0.0, 0.0, 0.0, 0.0, 0.0, turn)


COMMAND = {"command_name": "base_velocity"}


@configclass
class WalkCfg(ManagerBasedRLEnvCfg):
    """An ant walks as it is told."""

    decimation: int = 2
    episode_length_s: float = 1.0
    sim: SimulationCfg = SimulationCfg(dt=1 / 120, device="cpu", solver=MuJoCoSolverCfg(njmax=200, nconmax=50))
    seed: int = 1
    scene: LabSceneCfg = LabSceneCfg(
        num_envs=4,
        env_spacing=4.0,
        terrain=TerrainImporterCfg(prim_path="/World/ground", terrain_type="plane"),
        robot=ANT_CFG,
        sensors={"contacts": ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*")},
        objects={"crate": solid("Crate", CuboidCfg, (1.5, 0.0, 0.1), size=(0.2, 0.2, 0.2))},
    )
    observations: ObservationManagerCfg = ObservationManagerCfg(
        policy=ObservationGroupCfg(
            base_lin_vel=ObservationTermCfg(func=mdp.base_lin_vel, noise=UniformNoiseCfg(n_min=-0.1, n_max=0.1)),
            joint_pos=ObservationTermCfg(func=mdp.joint_pos, scale=1.0),
            command=ObservationTermCfg(func=mdp.generated_commands, params=COMMAND),
            energy_left=ObservationTermCfg(func=energy_left),
            enable_corruption=True,
        ),
        critic=ObservationGroupCfg(
            base_pos=ObservationTermCfg(func=mdp.root_pos_w),
            base_lin_vel=ObservationTermCfg(func=mdp.base_lin_vel),
            joint_pos=ObservationTermCfg(func=mdp.joint_pos),
            joint_vel=ObservationTermCfg(func=mdp.joint_vel, scale=0.1),
            balls=ObservationTermCfg(func=mdp.object_positions_b, params={"pool_name": "balls"}),
        ),
        normalized=ObservationGroupCfg(
            base_pos=ObservationTermCfg(func=mdp.root_pos_w), normalization=RunningNormCfg()
        ),
    )
    actions: ActionManagerCfg = ActionManagerCfg(
        legs=mdp.JointEffortActionCfg(joint_names=[".*"], scale=2.0, clip={".*": (-1.0, 1.0)})
    )
    commands: CommandManagerCfg = CommandManagerCfg(
        base_velocity=mdp.UniformVelocityCommandCfg(
            resampling_time_range=(10.0, 10.0),
            ranges=mdp.UniformVelocityCommandCfg.Ranges(
                lin_vel_x=(0.5, 1.0), lin_vel_y=(0.0, 0.0), ang_vel_z=(-1.0, 1.0)
            ),
        )
    )
    rewards: RewardManagerCfg = RewardManagerCfg(
        track=RewardTermCfg(func=mdp.track_lin_vel_xy_exp, weight=1.0, params={**COMMAND, "std": 0.5}),
        forward_velocity=RewardTermCfg(func=forward_velocity, weight=0.5, clip=(-1.0, 1.0)),
        energy_penalty=RewardTermCfg(func=cost_of_transport, weight=-0.01),
        ball_moved=RewardTermCfg(func=mdp.object_moved_to_goal, weight=0.1, params={"pool_name": "balls", "std": 1.0}),
    )
    terminations: TerminationManagerCfg = TerminationManagerCfg(
        time_out=TerminationTermCfg(func=mdp.time_out, time_out=True),
        fallen=TerminationTermCfg(func=mdp.bad_orientation, params={"limit_angle": 1.2}),
        too_low=TerminationTermCfg(func=mdp.root_height_below_minimum, params={"minimum_height": 0.1}),
        lost=TerminationTermCfg(
            func=mdp.object_out_of_bounds,
            params={"pool_name": "balls", "lower": (-9.0, -9.0, -1.0), "upper": (9.0, 9.0, 9.0)},
        ),
    )
    curriculum: CurriculumManagerCfg = CurriculumManagerCfg(
        disturbance=CurriculumTermCfg(
            func=mdp.modify_term_cfg, params={"address": "events.spin.rate", "value": 2.0, "num_steps": 3}
        )
    )
    events: EventManagerCfg = EventManagerCfg(
        mass=EventTermCfg(
            func=mdp.randomize_rigid_body_mass,
            mode="reset",
            params={"mass_distribution_params": (0.8, 1.2), "operation": "scale"},
        ),
        start=EventTermCfg(
            func=mdp.reset_root_state_uniform,
            mode="reset",
            params={"pose_range": {"yaw": (-0.5, 0.5)}, "velocity_range": {}},
        ),
        spin=EventTermCfg(func=spin, mode="interval", interval_range_s=(0.2, 0.4), params={"rate": 0.5}),
    )
    objects: ObjectManagerCfg = ObjectManagerCfg(
        balls=ObjectPoolCfg(
            objects=solid("Ball", SphereCfg, (0.0, 0.0, 0.1), radius=0.1),
            count=2,
            pose_range={"x": (1.0, 2.0), "y": (-1.0, 1.0)},
            target_range={"x": (2.0, 3.0)},
        )
    )
    managers = {"energy": EnergyManagerCfg(budget=50.0)}
