# SPDX-License-Identifier: Apache-2.0
"""Call checks: seeds, reset masks, environments by index, functions and saved states that callers give."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import TypedDict

import torch
import warp as wp

from stripe_newton.value_types import NonNegativeInt, mismatches, short

__all__ = [
    "check_finite_actions",
    "check_state",
    "checked_env_ids",
    "checked_function",
    "checked_lengths",
    "checked_mask",
    "checked_seed",
    "described",
    "reset_mask_of",
    "to_tensor",
]

_MOST_SEED = 2**63 - 1
"""Largest seed that torch takes."""


class _State(TypedDict):
    """Parts of a saved state."""

    step: NonNegativeInt
    arrays: dict[str, torch.Tensor]
    buffers: dict[str, torch.Tensor]
    parts: list[dict[str, torch.Tensor]]


def described(value: object) -> str:
    """A value for a message: of a tensor its type and shape."""
    if not isinstance(value, torch.Tensor):
        return short(value)
    kind = "" if value.layout == torch.strided else f"{value.layout} ".replace("torch.", "")
    on = " on 'meta', without values" if value.is_meta else ""
    return f"{kind}{value.dtype} of shape {tuple(value.shape)}{on}"


def to_tensor(name: str, value: object, must: str, device: str, dtype: torch.dtype | None = None) -> torch.Tensor:
    """A value as a tensor of real numbers.

    Args:
        name: What it is, for the message.
        value: The value.
        must: What it must be, for the message.
        device: Device of the tensor.
        dtype: Type of the tensor; by default that of the value.

    Raises:
        ValueError: if it cannot be one.
    """
    try:
        if isinstance(value, torch.Tensor) and str(value.device) == device:  # quicker, as this is asked in every step
            found = value
        else:
            found = torch.as_tensor(value, device=device)
        # Only where nothing is lost: torch would drop the imaginary part with a warning.
        if not found.is_complex() and found.layout == torch.strided:
            return found if dtype is None else found.to(dtype)
    except (TypeError, ValueError, RuntimeError, OverflowError):  # texts, objects, lists of different lengths
        pass
    raise ValueError(f"{name}: is {described(value)}, must be {must}")


def checked_seed(seed: object) -> int:
    """A seed as a plain number.

    Raises:
        ValueError: if it is no whole number from 0 to 2**63 - 1.
    """
    try:
        number = -1 if isinstance(seed, bool) else operator.index(seed)  # type: ignore[arg-type]  # it raises
    except TypeError:
        number = -1
    if not 0 <= number <= _MOST_SEED:
        raise ValueError(f"seed: is {described(seed)}, must be a whole number from 0 to 2**63 - 1")
    return number


def reset_mask_of(options: object) -> object:
    """The mask in the options of a reset; None if there is none.

    Raises:
        ValueError: if they are no mapping, or have something else in them.
    """
    if options is None:
        return None
    if not isinstance(options, Mapping):
        raise ValueError(f"options: is {described(options)}, must be None or {{'reset_mask': mask}}")
    unknown = [str(name) for name in options if name != "reset_mask"]
    if unknown:
        raise ValueError(f"options: has {', '.join(map(repr, unknown))}, but a reset knows 'reset_mask' alone")
    return options.get("reset_mask")


def checked_mask(mask: object, num_envs: int, device: str) -> torch.Tensor:
    """A reset mask as a tensor.

    Raises:
        ValueError: if it is not bool, or not of one value for each environment.
    """
    must = f"bool of shape ({num_envs},)"
    found = to_tensor("reset_mask", mask, must, device)
    if found.dtype != torch.bool or tuple(found.shape) != (num_envs,):
        cure = f"for indices: mask = torch.zeros({num_envs}, dtype=torch.bool); mask[indices] = True"
        raise ValueError(f"reset_mask: is {described(found)}, must be {must}; {cure}")
    return found


def checked_env_ids(env_ids: object, num_envs: int, device: str) -> torch.Tensor:
    """Environments by index as a tensor, int64, shape ``(n,)``; a slice takes a part of all.

    Raises:
        ValueError: if they are not whole numbers from 0 to ``num_envs`` - 1.
    """
    if isinstance(env_ids, slice):
        return torch.arange(num_envs, device=device)[env_ids]
    must = f"whole numbers from 0 to {num_envs - 1}"
    found = to_tensor("env_ids", env_ids, must, device)
    if found.dtype == torch.bool:
        raise ValueError(f"env_ids: is {described(found)}, must be {must}; for a mask: mask.nonzero().flatten()")
    if (found.is_floating_point() and found.numel()) or ((found < 0) | (found >= num_envs)).any():
        raise ValueError(f"env_ids: is {described(env_ids)}, must be {must}")
    return found.long().flatten()


def checked_function(function: object, what: str) -> wp.Function:
    """A Warp function.

    Raises:
        TypeError: if it is none.
    """
    if not isinstance(function, wp.Function):
        raise TypeError(f"{what}: is {short(function)}, must be a Warp function, such as mdp.joint_pos_rel")
    return function


def checked_lengths(value: object, num_envs: int, device: str) -> torch.Tensor:
    """Lengths of episodes as a tensor that can be copied into a buffer of shape ``(num_envs,)``.

    Raises:
        ValueError: if they are not whole numbers, or of another shape.
    """
    must = f"a whole number, or whole numbers of shape ({num_envs},)"
    found = to_tensor("episode_length_buf", value, must, device)
    is_whole = not found.is_complex() and bool((found == found.long()).all())  # numbers of any type may be whole
    if not is_whole or tuple(found.shape) not in ((), (1,), (num_envs,)):
        raise ValueError(f"episode_length_buf: is {described(value)}, must be {must}")
    return found


def check_finite_actions(action: torch.Tensor) -> None:
    """Raise if actions are not finite; it waits for the device.

    Raises:
        ValueError: with the number of environments, and the first of them.
    """
    bad = ~torch.isfinite(action).flatten(1).all(dim=1)
    if bad.any():
        where = ", ".join(map(str, bad.nonzero().flatten()[:5].tolist()))
        raise ValueError(
            f"actions of {int(bad.sum())} environments are not finite (environments {where}); look at the policy, or "
            "set nonfinite_actions='clamp'"
        )


def check_state(state: object) -> None:
    """Check the parts of a saved state, and their types.

    Raises:
        ValueError: if it is no state of an environment.
    """
    if not isinstance(state, Mapping):
        raise ValueError(f"state: is {described(state)}, must be what get_state() returned")
    wrong = list(mismatches(dict(state), _State, "state"))
    if wrong:
        raise ValueError(f"{'; '.join(wrong[:3])}; a state is what get_state() returned")
