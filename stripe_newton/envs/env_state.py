# SPDX-License-Identifier: Apache-2.0
"""Environment state: everything that the next step depends on, saved and restored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import newton
import torch
import warp as wp

if TYPE_CHECKING:
    from .scene_access import SceneAccess

__all__ = ["EnvState", "repeats", "restore_state", "save_state", "state_arrays"]

EnvState = dict[str, object]
"""A saved state: plain values, tensors, and dicts and lists of them, as ``torch.save`` takes them."""


def save_state(env: SceneAccess) -> EnvState:
    """State of an environment: joints, targets, the solver's warm start, counters, and every tensor that the subclass
    keeps as an attribute."""
    moved = env.scene.scenery_seed != env.scene.first_scenery_seed
    state: EnvState = {"scenery_seed": env.scene.scenery_seed} if moved else {}
    return state | {
        "step": env.common_step_counter,
        "arrays": {k: wp.to_torch(v).clone() for k, v in state_arrays(env).items()},
        "buffers": {k: v.clone() for k, v in _buffers(env).items()},
        "parts": [{k: v.clone() for k, v in _tensors(part).items()} for part in env.state_parts()],
    }


def restore_state(env: SceneAccess, state: EnvState) -> None:
    """Restore a state of :func:`save_state` in an environment whose scenery has the seed of the state already.

    Raises:
        ValueError: if it is the state of another environment.
    """
    saved: dict[str, torch.Tensor] = state["arrays"]  # type: ignore[assignment]
    if "external_wrench" in saved:
        env.sim.enable_external_wrench()
    dynamics = [name.removeprefix("model.") for name in saved if name.startswith("model.")]
    # Randomised quantities are written below. Their defaults must be remembered before, or they would be lost.
    for name in dynamics:
        env.scene.controller.track(name)
    arrays = state_arrays(env)
    for name, value in saved.items():
        mine = wp.to_torch(arrays[name]) if name in arrays else None
        if mine is None or mine.shape != value.shape:
            here = tuple(mine.shape) if mine is not None else "none"
            raise ValueError(
                f"the state has '{name}' of shape {tuple(value.shape)}, the environment {here}: "
                "it is of another task or size"
            )
    parts: list[dict[str, torch.Tensor]] = state["parts"]  # type: ignore[assignment]
    env.common_step_counter = state["step"]  # type: ignore[assignment]
    for name, value in saved.items():
        wp.to_torch(arrays[name]).copy_(value)
    _restore_buffers(env, state["buffers"])  # type: ignore[arg-type]
    # An environment of other terms or noise may take the state, too; what it does not have is left out.
    for mine, part in zip(env.state_parts(), parts, strict=False):
        _restore_tensors(mine, part, env.device)
    # The solver has not seen these writes: floating roots were moved, and randomised parts of the model may have been.
    env.sim.roots_moved = True
    if dynamics:
        env.sim.refresh_drives()
        env.sim.notify(newton.ModelFlags.ALL)
    env.sim.forward()


def state_arrays(env: SceneAccess) -> dict[str, wp.array]:
    """Arrays of the simulation and of the managers that last from step to step, by name."""
    sim = env.sim
    found = {
        "joint_q": sim.state.joint_q,
        "joint_qd": sim.state.joint_qd,
        "previous_joint_qd": sim.previous_joint_qd,
    }
    found |= {k: getattr(sim.control, k) for k in ("joint_target_q", "joint_target_qd", "joint_act")}
    found["joint_X_p"] = sim.model.joint_X_p
    found |= {f"model.{k}": getattr(sim.model, k) for k in env.scene.controller.randomized}
    if sim.external_wrench is not None:
        found |= {"external_wrench": sim.external_wrench, "wrench_in_world": sim.wrench_in_world}
    data = getattr(sim.solver, "mjw_data", None)  # MuJoCo Warp's, which other solvers do not have
    if data is not None:
        found["qacc_warmstart"] = data.qacc_warmstart
    found |= {f"context.{k}": v for k, v in env.context.arrays.items()}
    return {k: v for k, v in found.items() if v is not None and v.size}


def _buffers(env: SceneAccess) -> dict[str, torch.Tensor]:
    """Tensors that a subclass keeps as attributes, without those that share memory with the simulation."""
    shared = [*state_arrays(env).values(), env.sim.state.body_q, env.sim.state.body_qd]
    places = {wp.to_torch(array).untyped_storage().data_ptr() for array in shared}
    return {k: v for k, v in _tensors(vars(env)).items() if v.untyped_storage().data_ptr() not in places}


def _restore_buffers(env: SceneAccess, saved: dict[str, torch.Tensor]) -> None:
    buffers = _buffers(env)
    for name, value in saved.items():
        mine = buffers.get(name)
        if mine is not None and mine.shape == value.shape and not repeats(mine) and not mine.is_inference():
            mine.copy_(value)  # in place, as a recorded hook reads it there
        else:  # a hook that makes it has not run here yet, or it cannot be written in place
            setattr(env, name, value.to(env.device).clone())


def _restore_tensors(mine: dict[str, torch.Tensor], saved: Mapping[str, torch.Tensor], device: str) -> None:
    """Restore the tensors of a dict: in place where they can be written, as others may hold views of them."""
    for name, value in saved.items():
        there = mine.get(name)
        if there is not None and there.shape == value.shape and not repeats(there) and not there.is_inference():
            there.copy_(value)
        else:
            mine[name] = value.to(device).clone()


def repeats(tensor: torch.Tensor) -> bool:
    """Whether entries share memory, as those of an expanded tensor do."""
    return any(stride == 0 and size > 1 for stride, size in zip(tensor.stride(), tensor.shape, strict=True))


def _tensors(values: Mapping[str, object]) -> dict[str, torch.Tensor]:
    return {k: v for k, v in values.items() if isinstance(v, torch.Tensor)}
