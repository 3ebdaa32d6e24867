# SPDX-License-Identifier: Apache-2.0
"""Environments built on stripe_newton. Importing it registers them with gymnasium and imports nothing heavy."""

from stripe_newton.registration import register_scene, register_task

_DIRECT = {
    "Stripe-Ant-Direct-v0": ("ant", "Ant"),
    "Stripe-CartDoublePole-Direct-v0": ("cart_double_pole", "CartDoublePole"),
    "Stripe-CartDoublePole-MARL-Direct-v0": ("cart_double_pole_marl", "CartDoublePoleMARL"),
    "Stripe-Cartpole-Direct-v0": ("cartpole", "Cartpole"),
    "Stripe-Humanoid-Direct-v0": ("humanoid", "Humanoid"),
    "Stripe-Quadcopter-Direct-v0": ("quadcopter", "Quadcopter"),
    "Stripe-Velocity-Flat-Humanoid-Direct-Warp-v0": ("velocity_humanoid_warp", "HumanoidFlatWarp"),
    "Stripe-Velocity-Flat-Quadruped-Direct-Warp-v0": ("velocity_quadruped_warp", "QuadrupedFlatWarp"),
}
_DIRECT_WARP = {
    "Stripe-Ant-Direct-Warp-v0": ("locomotion_warp", "ant", "Ant"),
    "Stripe-Cartpole-Direct-Warp-v0": ("cartpole_warp", "cartpole", "Cartpole"),
    "Stripe-Humanoid-Direct-Warp-v0": ("locomotion_warp", "humanoid", "Humanoid"),
}
_MANAGER_BASED = {
    "Stripe-Ant-v0": ("locomotion_manager", "Ant"),
    "Stripe-Cartpole-v0": ("cartpole_manager", "Cartpole"),
    "Stripe-Humanoid-v0": ("locomotion_manager", "Humanoid"),
}
_GOALS = {
    "Stripe-PushBall-Ant-v0": ("push_ball", "PushBall"),
    "Stripe-Reach-v0": ("reach", "Reach"),
}
_VELOCITY = {
    "Stripe-Velocity-Flat-Humanoid-v0": ("velocity_humanoid", "HumanoidFlat"),
    "Stripe-Velocity-Flat-Quadruped-v0": ("velocity_quadruped", "QuadrupedFlat"),
    "Stripe-Velocity-Rough-Humanoid-v0": ("velocity_humanoid", "HumanoidRough"),
    "Stripe-Velocity-Rough-Quadruped-v0": ("velocity_quadruped", "QuadrupedRough"),
}

_FOREST = {
    "Stripe-Forest-Reach-Quadruped-v0": ("reach:reach_cfg", "reach:ForestReachEnv", "reach:ForestReach"),
    "Stripe-Forest-Reach-Quadruped-Play-v0": ("reach:play_cfg", "reach:ForestReachEnv", "reach:ForestReach"),
    "Stripe-Forest-Walk-Quadruped-v0": ("walk:walk_cfg", None, "walk:ForestWalk"),
    "Stripe-Forest-Walk-Quadruped-Play-v0": ("walk:play_cfg", None, "walk:ForestWalk"),
}

for _id, (_module, _name) in (_DIRECT | _GOALS).items():
    register_task(
        _id,
        env=f"stripe_tasks.{_module}:{_name}Env",
        env_cfg=f"stripe_tasks.{_module}:{_name}EnvCfg",
        rsl_rl_cfg=f"stripe_tasks.{_module}:{_name}PPORunnerCfg",
    )
for _id, (_module, _config, _name) in _DIRECT_WARP.items():
    register_task(
        _id,
        env=f"stripe_tasks.{_module}:{_name}WarpEnv",
        env_cfg=f"stripe_tasks.{_config}:{_name}EnvCfg",
        rsl_rl_cfg=f"stripe_tasks.{_module}:{_name}WarpPPORunnerCfg",
    )
for _id, (_module, _name) in _MANAGER_BASED.items():
    register_task(
        _id,
        env="stripe_newton.envs:ManagerBasedRLEnv",
        env_cfg=f"stripe_tasks.{_module}:{_name}ManagerEnvCfg",
        rsl_rl_cfg=f"stripe_tasks.{_module}:{_name}ManagerPPORunnerCfg",
    )
for _id, (_module, _name) in _VELOCITY.items():
    register_task(
        _id,
        env="stripe_newton.envs:ManagerBasedRLEnv",
        env_cfg=f"stripe_tasks.{_module}:{_name}EnvCfg",
        rsl_rl_cfg=f"stripe_tasks.{_module}:{_name}PPORunnerCfg",
    )
for _id, (_config, _env, _name) in _FOREST.items():
    register_task(
        _id,
        env=f"stripe_tasks.forest.{_env}" if _env else "stripe_newton.envs:ManagerBasedRLEnv",
        env_cfg=f"stripe_tasks.forest.{_config}",
        rsl_rl_cfg=f"stripe_tasks.forest.{_name}PPORunnerCfg",
    )

register_scene("forest", "stripe_tasks.forest:ForestSpec")
register_scene("clearing", "stripe_tasks.forest:ClearingSpec")
register_scene("path", "stripe_tasks.forest:PathSpec")
register_scene("ravine", "stripe_tasks.forest:RavineSpec")
register_scene("rubble", "stripe_tasks.rubble:RubbleSpec")
