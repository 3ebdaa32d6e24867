# SPDX-License-Identifier: Apache-2.0
"""Events of ``isaaclab.envs.mdp``: Warp events, which torch code calls with an environment and its indices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch

from stripe_kernels import mdp
from stripe_newton.envs import RLEnv
from stripe_newton.isaaclab import math

from ..scene_entity import SceneEntityCfg
from .warp_term import event_of

__all__ = [
    "apply_external_force_torque",
    "push_by_setting_velocity",
    "randomize_actuator_gains",
    "randomize_joint_parameters",
    "randomize_physics_scene_gravity",
    "randomize_rigid_body_collider_offsets",
    "randomize_rigid_body_com",
    "randomize_rigid_body_mass",
    "randomize_rigid_body_material",
    "randomize_visual_color",
    "reset_joints_by_offset",
    "reset_joints_by_scale",
    "reset_root_state_from_terrain",
    "reset_root_state_uniform",
    "reset_root_state_with_random_orientation",
    "reset_scene_to_default",
]

ROBOT = SceneEntityCfg("robot")
Range = tuple[float, float]
Ranges = Mapping[str, Range]

# -- randomisation


@event_of(mdp.randomize_rigid_body_material)
def randomize_rigid_body_material(
    env: RLEnv,
    env_ids: object,
    static_friction_range: Range,
    dynamic_friction_range: Range,
    restitution_range: Range,
    num_buckets: int,
    asset_cfg: SceneEntityCfg,
    make_consistent: bool = False,
) -> None:
    """Randomise friction, by the static range, and restitution of colliders."""


@event_of(mdp.randomize_rigid_body_mass)
def randomize_rigid_body_mass(
    env: RLEnv,
    env_ids: object,
    asset_cfg: SceneEntityCfg,
    mass_distribution_params: Range,
    operation: str,
    distribution: str = "uniform",
    recompute_inertia: bool = True,
    min_mass: float = 1e-6,
) -> None:
    """Randomise masses of bodies [kg]."""


@event_of(mdp.randomize_rigid_body_com)
def randomize_rigid_body_com(env: RLEnv, env_ids: object, com_range: Ranges, asset_cfg: SceneEntityCfg) -> None:
    """Randomise centres of mass of bodies [m]."""


@event_of(mdp.randomize_rigid_body_collider_offsets)
def randomize_rigid_body_collider_offsets(
    env: RLEnv,
    env_ids: object,
    asset_cfg: SceneEntityCfg,
    rest_offset_distribution_params: Range | None = None,
    contact_offset_distribution_params: Range | None = None,
    distribution: str = "uniform",
) -> None:
    """Randomise rest and contact offsets of colliders [m]."""


@event_of(mdp.randomize_physics_scene_gravity)
def randomize_physics_scene_gravity(
    env: RLEnv,
    env_ids: object,
    gravity_distribution_params: tuple[Sequence[float], Sequence[float]],
    operation: str,
    distribution: str = "uniform",
) -> None:
    """Randomise gravity [m/s^2]."""


@event_of(mdp.randomize_actuator_gains)
def randomize_actuator_gains(
    env: RLEnv,
    env_ids: object,
    asset_cfg: SceneEntityCfg,
    stiffness_distribution_params: Range | None = None,
    damping_distribution_params: Range | None = None,
    operation: str = "abs",
    distribution: str = "uniform",
) -> None:
    """Randomise stiffness and damping of drives."""


@event_of(mdp.randomize_joint_parameters)
def randomize_joint_parameters(
    env: RLEnv,
    env_ids: object,
    asset_cfg: SceneEntityCfg,
    friction_distribution_params: Range | None = None,
    armature_distribution_params: Range | None = None,
    lower_limit_distribution_params: Range | None = None,
    upper_limit_distribution_params: Range | None = None,
    operation: str = "abs",
    distribution: str = "uniform",
) -> None:
    """Randomise friction, armature and position limits of joints."""


@event_of(mdp.randomize_visual_color, unused=["event_name", "mesh_name"])
def randomize_visual_color(
    env: RLEnv,
    env_ids: object,
    event_name: str,
    asset_cfg: SceneEntityCfg,
    colors: Ranges,
    mesh_name: str = "",
) -> None:
    """Randomise colours of an asset."""


# -- forces and velocities


@event_of(mdp.apply_external_force_torque)
def apply_external_force_torque(
    env: RLEnv, env_ids: object, force_range: Range, torque_range: Range, asset_cfg: SceneEntityCfg = ROBOT
) -> None:
    """Set random forces [N] and torques [N m] on bodies, which act until they are changed."""


@event_of(mdp.push_by_setting_velocity)
def push_by_setting_velocity(
    env: RLEnv, env_ids: object, velocity_range: Ranges, asset_cfg: SceneEntityCfg = ROBOT
) -> None:
    """Add random velocities to the root's [m/s, rad/s]."""


# -- resets


@event_of(mdp.reset_root_state_uniform)
def reset_root_state_uniform(
    env: RLEnv, env_ids: object, pose_range: Ranges, velocity_range: Ranges, asset_cfg: SceneEntityCfg = ROBOT
) -> None:
    """Reset the root around its default state [m, rad, m/s, rad/s]."""


@event_of(mdp.reset_root_state_with_random_orientation)
def reset_root_state_with_random_orientation(
    env: RLEnv, env_ids: object, pose_range: Ranges, velocity_range: Ranges, asset_cfg: SceneEntityCfg = ROBOT
) -> None:
    """Reset the root around its default position [m], with any orientation."""


@event_of(mdp.reset_root_state_from_terrain)
def reset_root_state_from_terrain(
    env: RLEnv, env_ids: object, pose_range: Ranges, velocity_range: Ranges, asset_cfg: SceneEntityCfg = ROBOT
) -> None:
    """Reset the root to a flat patch ``init_pos`` of its terrain."""


@event_of(mdp.reset_joints_by_scale)
def reset_joints_by_scale(
    env: RLEnv, env_ids: object, position_range: Range, velocity_range: Range, asset_cfg: SceneEntityCfg = ROBOT
) -> None:
    """Reset joints to scaled default positions and velocities, within their limits."""


@event_of(mdp.reset_joints_by_offset)
def reset_joints_by_offset(
    env: RLEnv, env_ids: object, position_range: Range, velocity_range: Range, asset_cfg: SceneEntityCfg = ROBOT
) -> None:
    """Reset joints around their default positions [m or rad] and velocities, within their limits."""


@event_of(mdp.reset_scene_to_default)
def reset_scene_to_default(env: RLEnv, env_ids: object, reset_joint_targets: bool = False) -> None:
    """Reset every asset to its default state."""


# -- a function that projects import, although its name says that it is internal

_SAMPLES = {
    "uniform": math.sample_uniform,
    "log_uniform": math.sample_log_uniform,
    "gaussian": math.sample_gaussian,
}


def _randomize_prop_by_op(
    data: torch.Tensor,
    distribution_parameters: tuple[float | torch.Tensor, float | torch.Tensor],
    dim_0_ids: torch.Tensor | None,
    dim_1_ids: torch.Tensor | slice,
    operation: str,
    distribution: str,
) -> torch.Tensor:
    """Randomise some rows and columns of a tensor, in place.

    Args:
        data: Shape ``(rows, columns)``.
        distribution_parameters: Bounds, or mean and deviation of ``"gaussian"``.
        dim_0_ids: The rows; ``None`` for all.
        dim_1_ids: The columns; a slice means all.
        operation: ``"add"``, ``"scale"`` or ``"abs"``.
        distribution: ``"uniform"``, ``"log_uniform"`` or ``"gaussian"``.

    Raises:
        NotImplementedError: another operation or distribution.
    """
    if distribution not in _SAMPLES:
        raise NotImplementedError(f"distribution: is '{distribution}', must be one of {', '.join(_SAMPLES)}")
    if operation not in ("add", "scale", "abs"):
        raise NotImplementedError(f"operation: is '{operation}', must be 'add', 'scale' or 'abs'")
    rows = torch.arange(len(data), device=data.device) if dim_0_ids is None else dim_0_ids
    columns = torch.arange(data.shape[1], device=data.device)
    columns = columns if isinstance(dim_1_ids, slice) else torch.as_tensor(dim_1_ids, device=data.device).long()
    at = rows[:, None], columns
    drawn = _SAMPLES[distribution](*distribution_parameters, (len(rows), len(columns)), device=data.device)
    data[at] = {"add": data[at] + drawn, "scale": data[at] * drawn, "abs": drawn}[operation]
    return data
