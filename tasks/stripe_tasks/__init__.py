# SPDX-License-Identifier: Apache-2.0
"""Stripe tasks: registers the tasks and scenes of this package by name.

Importing it loads nothing heavy: no torch, no Warp.
"""

from stripe_newton.moved_modules import forward_modules
from stripe_newton.registration import register_scene, register_task

MANAGER_BASED = "stripe_newton.envs:ManagerBasedRLEnv"

TASKS = {
    "Stripe-Ant-Direct-Warp-v0": (
        "stripe_tasks.locomotion.direct_warp:AntWarpEnv",
        "stripe_tasks.locomotion:AntEnvCfg",
        "stripe_tasks.locomotion.direct_warp:AntWarpPPORunnerCfg",
    ),
    "Stripe-Ant-Direct-v0": (
        "stripe_tasks.locomotion:AntEnv",
        "stripe_tasks.locomotion:AntEnvCfg",
        "stripe_tasks.locomotion:AntPPORunnerCfg",
    ),
    "Stripe-Ant-v0": (
        MANAGER_BASED,
        "stripe_tasks.locomotion.manager_based:AntManagerEnvCfg",
        "stripe_tasks.locomotion.manager_based:AntManagerPPORunnerCfg",
    ),
    "Stripe-CartDoublePole-Direct-v0": (
        "stripe_tasks.cart_double_pole:CartDoublePoleEnv",
        "stripe_tasks.cart_double_pole:CartDoublePoleEnvCfg",
        "stripe_tasks.cart_double_pole:CartDoublePolePPORunnerCfg",
    ),
    "Stripe-CartDoublePole-MARL-Direct-v0": (
        "stripe_tasks.cart_double_pole.multi_agent:CartDoublePoleMARLEnv",
        "stripe_tasks.cart_double_pole.multi_agent:CartDoublePoleMARLEnvCfg",
        "stripe_tasks.cart_double_pole.multi_agent:CartDoublePoleMARLPPORunnerCfg",
    ),
    "Stripe-Cartpole-Camera-Direct-v0": (
        "stripe_tasks.cartpole.camera:CartpoleCameraEnv",
        "stripe_tasks.cartpole.camera:CartpoleCameraEnvCfg",
        "stripe_tasks.cartpole.camera:CartpoleCameraPPORunnerCfg",
    ),
    "Stripe-Cartpole-Direct-Warp-v0": (
        "stripe_tasks.cartpole.direct_warp:CartpoleWarpEnv",
        "stripe_tasks.cartpole:CartpoleEnvCfg",
        "stripe_tasks.cartpole.direct_warp:CartpoleWarpPPORunnerCfg",
    ),
    "Stripe-Cartpole-Direct-v0": (
        "stripe_tasks.cartpole:CartpoleEnv",
        "stripe_tasks.cartpole:CartpoleEnvCfg",
        "stripe_tasks.cartpole:CartpolePPORunnerCfg",
    ),
    "Stripe-Cartpole-v0": (
        MANAGER_BASED,
        "stripe_tasks.cartpole.manager_based:CartpoleManagerEnvCfg",
        "stripe_tasks.cartpole.manager_based:CartpoleManagerPPORunnerCfg",
    ),
    "Stripe-Forest-Reach-Quadruped-Play-v0": (
        "stripe_tasks.forest.reach:ForestReachEnv",
        "stripe_tasks.forest.reach:play_cfg",
        "stripe_tasks.forest.reach:ForestReachPPORunnerCfg",
    ),
    "Stripe-Forest-Reach-Quadruped-v0": (
        "stripe_tasks.forest.reach:ForestReachEnv",
        "stripe_tasks.forest.reach:reach_cfg",
        "stripe_tasks.forest.reach:ForestReachPPORunnerCfg",
    ),
    "Stripe-Forest-Walk-Quadruped-Depth-Play-v0": (
        MANAGER_BASED,
        "stripe_tasks.forest.walk_depth:play_cfg",
        "stripe_tasks.forest.walk_depth:ForestWalkDepthRunnerCfg",
    ),
    "Stripe-Forest-Walk-Quadruped-Depth-v0": (
        MANAGER_BASED,
        "stripe_tasks.forest.walk_depth:walk_cfg",
        "stripe_tasks.forest.walk_depth:ForestWalkDepthRunnerCfg",
    ),
    "Stripe-Forest-Walk-Quadruped-Play-v0": (
        MANAGER_BASED,
        "stripe_tasks.forest.walk:play_cfg",
        "stripe_tasks.forest.walk:ForestWalkPPORunnerCfg",
    ),
    "Stripe-Forest-Walk-Quadruped-v0": (
        MANAGER_BASED,
        "stripe_tasks.forest.walk:walk_cfg",
        "stripe_tasks.forest.walk:ForestWalkPPORunnerCfg",
    ),
    "Stripe-Getup-Flat-G1-v0": (
        "stripe_tasks.success:SuccessEnv",
        "stripe_tasks.getup.g1:GetupEnvCfg",
        "stripe_tasks.getup.g1:GetupPPORunnerCfg",
    ),
    "Stripe-Humanoid-Direct-Warp-v0": (
        "stripe_tasks.locomotion.direct_warp:HumanoidWarpEnv",
        "stripe_tasks.locomotion:HumanoidEnvCfg",
        "stripe_tasks.locomotion.direct_warp:HumanoidWarpPPORunnerCfg",
    ),
    "Stripe-Humanoid-Direct-v0": (
        "stripe_tasks.locomotion:HumanoidEnv",
        "stripe_tasks.locomotion:HumanoidEnvCfg",
        "stripe_tasks.locomotion:HumanoidPPORunnerCfg",
    ),
    "Stripe-Humanoid-v0": (
        MANAGER_BASED,
        "stripe_tasks.locomotion.manager_based:HumanoidManagerEnvCfg",
        "stripe_tasks.locomotion.manager_based:HumanoidManagerPPORunnerCfg",
    ),
    "Stripe-Lift-Cube-Panda-Camera-v0": (
        "stripe_tasks.manipulation.lift:LiftEnv",
        "stripe_tasks.manipulation.lift_camera:LiftCameraEnvCfg",
        "stripe_tasks.manipulation.lift_camera:LiftCameraPPORunnerCfg",
    ),
    "Stripe-Lift-Cube-Panda-v0": (
        "stripe_tasks.manipulation.lift:LiftEnv",
        "stripe_tasks.manipulation.lift:LiftEnvCfg",
        "stripe_tasks.manipulation.lift:LiftPPORunnerCfg",
    ),
    "Stripe-Open-Cabinet-Panda-v0": (
        "stripe_tasks.success:SuccessEnv",
        "stripe_tasks.manipulation.cabinet:CabinetEnvCfg",
        "stripe_tasks.manipulation.cabinet:CabinetPPORunnerCfg",
    ),
    "Stripe-PushBall-Ant-v0": (
        "stripe_tasks.push_ball:PushBallEnv",
        "stripe_tasks.push_ball:PushBallEnvCfg",
        "stripe_tasks.push_ball:PushBallPPORunnerCfg",
    ),
    "Stripe-Quadcopter-Direct-v0": (
        "stripe_tasks.quadcopter:QuadcopterEnv",
        "stripe_tasks.quadcopter:QuadcopterEnvCfg",
        "stripe_tasks.quadcopter:QuadcopterPPORunnerCfg",
    ),
    "Stripe-Reach-Panda-IK-Rel-v0": (
        "stripe_tasks.manipulation.reach:PandaReachEnv",
        "stripe_tasks.manipulation.reach:PandaReachIKEnvCfg",
        "stripe_tasks.manipulation.reach:PandaReachPPORunnerCfg",
    ),
    "Stripe-Reach-Panda-OSC-v0": (
        "stripe_tasks.manipulation.reach:PandaReachEnv",
        "stripe_tasks.manipulation.reach:PandaReachOSCEnvCfg",
        "stripe_tasks.manipulation.reach:PandaReachOSCPPORunnerCfg",
    ),
    "Stripe-Reach-Panda-v0": (
        "stripe_tasks.manipulation.reach:PandaReachEnv",
        "stripe_tasks.manipulation.reach:PandaReachEnvCfg",
        "stripe_tasks.manipulation.reach:PandaReachPPORunnerCfg",
    ),
    "Stripe-Reach-v0": (
        "stripe_tasks.reach:ReachEnv",
        "stripe_tasks.reach:ReachEnvCfg",
        "stripe_tasks.reach:ReachPPORunnerCfg",
    ),
    "Stripe-Repose-Cube-Allegro-Direct-v0": (
        "stripe_tasks.manipulation.repose:ReposeEnv",
        "stripe_tasks.manipulation.repose:ReposeEnvCfg",
        "stripe_tasks.manipulation.repose:ReposePPORunnerCfg",
    ),
    "Stripe-Tracking-Flat-G1-Play-v0": (
        MANAGER_BASED,
        "stripe_tasks.tracking.g1:TrackingPlayEnvCfg",
        "stripe_tasks.tracking.g1:TrackingPPORunnerCfg",
    ),
    "Stripe-Tracking-Flat-G1-v0": (
        MANAGER_BASED,
        "stripe_tasks.tracking.g1:TrackingEnvCfg",
        "stripe_tasks.tracking.g1:TrackingPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-AnymalC-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.published_quadrupeds:AnymalCFlatEnvCfg",
        "stripe_tasks.velocity.published_quadrupeds:AnymalCFlatPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-G1-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.g1:G1FlatEnvCfg",
        "stripe_tasks.velocity.g1:G1FlatPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-Go1-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.published_quadrupeds:Go1FlatEnvCfg",
        "stripe_tasks.velocity.published_quadrupeds:Go1FlatPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-Go2-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.published_quadrupeds:Go2FlatEnvCfg",
        "stripe_tasks.velocity.published_quadrupeds:Go2FlatPPORunnerCfg",
    ),
    "Stripe-Velocity-Rough-AnymalC-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.published_quadrupeds:AnymalCRoughEnvCfg",
        "stripe_tasks.velocity.published_quadrupeds:AnymalCRoughPPORunnerCfg",
    ),
    "Stripe-Velocity-Rough-G1-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.g1:G1RoughEnvCfg",
        "stripe_tasks.velocity.g1:G1RoughPPORunnerCfg",
    ),
    "Stripe-Velocity-Rough-Go1-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.published_quadrupeds:Go1RoughEnvCfg",
        "stripe_tasks.velocity.published_quadrupeds:Go1RoughPPORunnerCfg",
    ),
    "Stripe-Velocity-Rough-Go2-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.published_quadrupeds:Go2RoughEnvCfg",
        "stripe_tasks.velocity.published_quadrupeds:Go2RoughPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-Humanoid-Direct-Warp-v0": (
        "stripe_tasks.velocity.humanoid_direct_warp:HumanoidFlatWarpEnv",
        "stripe_tasks.velocity.humanoid_direct_warp:HumanoidFlatWarpEnvCfg",
        "stripe_tasks.velocity.humanoid_direct_warp:HumanoidFlatWarpPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-Humanoid-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.humanoid:HumanoidFlatEnvCfg",
        "stripe_tasks.velocity.humanoid:HumanoidFlatPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-Quadruped-Direct-Warp-v0": (
        "stripe_tasks.velocity.quadruped_direct_warp:QuadrupedFlatWarpEnv",
        "stripe_tasks.velocity.quadruped_direct_warp:QuadrupedFlatWarpEnvCfg",
        "stripe_tasks.velocity.quadruped_direct_warp:QuadrupedFlatWarpPPORunnerCfg",
    ),
    "Stripe-Velocity-Flat-Quadruped-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.quadruped:QuadrupedFlatEnvCfg",
        "stripe_tasks.velocity.quadruped:QuadrupedFlatPPORunnerCfg",
    ),
    "Stripe-Velocity-Rough-Humanoid-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.humanoid:HumanoidRoughEnvCfg",
        "stripe_tasks.velocity.humanoid:HumanoidRoughPPORunnerCfg",
    ),
    "Stripe-Velocity-Rough-Quadruped-Depth-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.quadruped_depth:QuadrupedDepthEnvCfg",
        "stripe_tasks.velocity.quadruped_depth:QuadrupedDepthRunnerCfg",
    ),
    "Stripe-Velocity-Rough-Quadruped-v0": (
        MANAGER_BASED,
        "stripe_tasks.velocity.quadruped:QuadrupedRoughEnvCfg",
        "stripe_tasks.velocity.quadruped:QuadrupedRoughPPORunnerCfg",
    ),
}
"""By task id: environment, its config, and the config of its training with rsl_rl; loaded when the task is made."""

SCENES = {
    "clearing": "stripe_tasks.forest:ClearingSpec",
    "forest": "stripe_tasks.forest:ForestSpec",
    "path": "stripe_tasks.forest:PathSpec",
    "ravine": "stripe_tasks.forest:RavineSpec",
    "rubble": "stripe_tasks.rubble:RubbleSpec",
}
"""Specifications of scenes by name."""

WHAT = {
    "Ant": "an ant runs toward a goal far away",
    "CartDoublePole": "a cart keeps up two poles, one on the other",
    "Cartpole-Camera": "a cart keeps up a pole, by a camera",
    "Cartpole": "a cart keeps up a pole",
    "Forest-Reach-Quadruped": "a quadruped gets to a goal 10 to 20 m away, between trees",
    "Forest-Walk-Quadruped": "a quadruped follows velocity commands between trees",
    "Forest-Walk-Quadruped-Depth": "a quadruped follows velocity commands between trees, by a depth camera",
    "Getup-Flat-G1": "Unitree's G1, a humanoid, gets up from any fall",
    "Humanoid": "a humanoid runs toward a goal far away",
    "Lift-Cube-Panda": "a Panda lifts a cube to a place",
    "Lift-Cube-Panda-Camera": "a Panda lifts a cube to a place, by a camera",
    "Open-Cabinet-Panda": "a Panda opens a drawer",
    "PushBall-Ant": "an ant pushes a ball to a goal",
    "Quadcopter": "a quadcopter flies to a goal",
    "Reach-Panda": "a Panda reaches poses with its hand",
    "Reach-Panda-IK-Rel": "a Panda reaches poses by inverse kinematics",
    "Reach-Panda-OSC": "a Panda reaches poses by operational space control",
    "Reach": "an arm reaches poses with its hand",
    "Repose-Cube-Allegro": "an Allegro hand turns a cube to goals",
    "Tracking-Flat-G1": "Unitree's G1, a humanoid, moves as recorded motions do",
    "Velocity-Flat-AnymalC": "ANYbotics' ANYmal C follows velocity commands on a plane",
    "Velocity-Flat-G1": "Unitree's G1, a humanoid, follows velocity commands on a plane",
    "Velocity-Flat-Go1": "Unitree's Go1 follows velocity commands on a plane",
    "Velocity-Flat-Go2": "Unitree's Go2 follows velocity commands on a plane",
    "Velocity-Rough-AnymalC": "ANYbotics' ANYmal C follows velocity commands on stairs, slopes and blocks",
    "Velocity-Rough-G1": "Unitree's G1, a humanoid, follows velocity commands on stairs, slopes and blocks",
    "Velocity-Rough-Go1": "Unitree's Go1 follows velocity commands on stairs, slopes and blocks",
    "Velocity-Rough-Go2": "Unitree's Go2 follows velocity commands on stairs, slopes and blocks",
    "Velocity-Flat-Humanoid": "a humanoid follows velocity commands on a plane",
    "Velocity-Flat-Quadruped": "a quadruped follows velocity commands on a plane",
    "Velocity-Rough-Humanoid": "a humanoid follows velocity commands on stairs, slopes and blocks",
    "Velocity-Rough-Quadruped-Depth": "a quadruped follows velocity commands on rough ground, by a depth camera",
    "Velocity-Rough-Quadruped": "a quadruped follows velocity commands on stairs, slopes and blocks",
}
"""Descriptions by the part of a task's name that says what it is about."""

FORMS = {
    "-MARL-Direct": "torch hooks, two agents",
    "-Direct-Warp": "Warp hooks",
    "-Direct": "torch hooks",
    "-Play": "terms",
    "": "terms",
}
"""Forms of a task by the rest of its name, the longest first."""

PLAY = {
    "Forest": "in woods that it was not trained in",
    "Tracking": "from their start to their end, without noise and pushes",
}
"""Differences of the ``-Play-`` form of a task, by the first word of its name."""

WARP_HOOKS = ("Cartpole-Camera", "Quadcopter", "Repose-Cube-Allegro")
"""Direct tasks that have Warp hooks alone, without saying so in their names."""


def describe(task_id: str) -> str:
    """Description of a task, such as ``"a cart keeps up a pole (terms)"``."""
    name = task_id.removeprefix("Stripe-").removesuffix("-v0")
    end = next(end for end in FORMS if name.endswith(end))
    what = name.removesuffix(end)
    form = FORMS["-Direct-Warp" if what in WARP_HOOKS else end]
    return f"{WHAT[what]} ({form}, {PLAY[what.partition('-')[0]]})" if end == "-Play" else f"{WHAT[what]} ({form})"


POLICIES = {
    "Stripe-Cartpole-v0": "stripe_tasks:policies/cartpole.onnx",
    "Stripe-Velocity-Flat-Quadruped-v0": "stripe_tasks:policies/velocity_flat_quadruped.onnx",
}
"""Trained policies that come with the package, for ``stripe-newton demo``."""

for _id, (_env, _env_cfg, _rsl_rl_cfg) in TASKS.items():
    register_task(
        _id, env=_env, env_cfg=_env_cfg, rsl_rl_cfg=_rsl_rl_cfg, description=describe(_id), policy=POLICIES.get(_id)
    )
for _name, _spec in SCENES.items():
    register_scene(_name, _spec)

# Old module paths. Those that moved in 0.2 goes with 0.3; CHANGELOG lists each.
forward_modules(
    {
        "stripe_tasks.ant": "stripe_tasks.locomotion",
        "stripe_tasks.cart_double_pole_marl": "stripe_tasks.cart_double_pole.multi_agent",
        "stripe_tasks.cartpole_manager": "stripe_tasks.cartpole.manager_based",
        "stripe_tasks.cartpole_warp": "stripe_tasks.cartpole.direct_warp",
        "stripe_tasks.humanoid": "stripe_tasks.locomotion",
        "stripe_tasks.locomotion_manager": "stripe_tasks.locomotion.manager_based",
        "stripe_tasks.locomotion_terms": "stripe_tasks.locomotion.terms",
        "stripe_tasks.locomotion_warp": "stripe_tasks.locomotion.direct_warp",
        "stripe_tasks.push_ball_object": "stripe_tasks.push_ball.rolling_ball",
        "stripe_tasks.push_ball_terms": "stripe_tasks.push_ball.terms",
        "stripe_tasks.quadcopter_robot": "stripe_tasks.quadcopter.crazyflie",
        "stripe_tasks.reach_robot": "stripe_tasks.reach.arm",
        "stripe_tasks.scene_cfg": "stripe_tasks.robot_scene",
        "stripe_tasks.scenery": "stripe_tasks.robot_scene",
        "stripe_tasks.velocity_humanoid": "stripe_tasks.velocity.humanoid",
        "stripe_tasks.velocity_humanoid_warp": "stripe_tasks.velocity.humanoid_direct_warp",
        "stripe_tasks.velocity_quadruped": "stripe_tasks.velocity.quadruped",
        "stripe_tasks.velocity_quadruped_warp": "stripe_tasks.velocity.quadruped_direct_warp",
        "stripe_tasks.velocity_warp": "stripe_tasks.velocity.direct_warp",
    }
)
