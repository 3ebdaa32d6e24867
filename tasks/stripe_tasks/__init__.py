# SPDX-License-Identifier: Apache-2.0
"""Environments built on stripe_newton. Importing it registers them with gymnasium and imports nothing heavy."""

from stripe_newton.registration import register_task

_TASKS = {
    "Stripe-Ant-Direct-v0": ("ant", "Ant"),
    "Stripe-CartDoublePole-Direct-v0": ("cart_double_pole", "CartDoublePole"),
    "Stripe-Cartpole-Direct-v0": ("cartpole", "Cartpole"),
    "Stripe-Humanoid-Direct-v0": ("humanoid", "Humanoid"),
}

for _id, (_module, _name) in _TASKS.items():
    register_task(
        _id,
        env=f"stripe_tasks.{_module}:{_name}Env",
        env_cfg=f"stripe_tasks.{_module}:{_name}EnvCfg",
        rsl_rl_cfg=f"stripe_tasks.{_module}:{_name}PPORunnerCfg",
    )
