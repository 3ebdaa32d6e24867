# SPDX-License-Identifier: Apache-2.0
"""Teacher of ``stripe-newton train --teacher``: its network, read from its run, and the check of its observations."""

from __future__ import annotations

from collections.abc import Mapping

from stripe_newton.rl import (
    RslRlCNNModelCfg,
    RslRlDistillationRunnerCfg,
    RslRlMLPModelCfg,
    RslRlRecurrentCNNModelCfg,
    RslRlRNNModelCfg,
    RunFolder,
    find_checkpoint,
)
from stripe_newton.value_types import short

from .field_options import apply_saved
from .run_configs import Configs
from .user_error import UserError

__all__ = ["check_teacher", "use_teacher"]

_NETWORKS: dict[str, type[RslRlMLPModelCfg]] = {
    cfg().class_name: cfg for cfg in (RslRlMLPModelCfg, RslRlRNNModelCfg, RslRlCNNModelCfg, RslRlRecurrentCNNModelCfg)
}
"""Configs of networks by rsl_rl's names of the classes."""
_DISTRIBUTIONS = {
    cfg().class_name: cfg
    for cfg in (
        RslRlMLPModelCfg.GaussianDistributionCfg,
        RslRlMLPModelCfg.HeteroscedasticGaussianDistributionCfg,
        RslRlMLPModelCfg.BetaDistributionCfg,
    )
}
_SETTINGS = ("func", "params", "scale", "clip", "history_length")
"""Fields of an observation term that change what a network is given; noise does not change its meaning."""


def use_teacher(task: str, given: str, configs: Configs) -> None:
    """Let a distillation learn from the policy of a run: its network, weights and observations.

    Args:
        task: The task, for messages.
        given: ``--teacher``: the run folder, or a checkpoint in it.
        configs: Configs of the student's task, of which those of the teacher are set.

    Raises:
        UserError: if the task is not distilled, if the run was none of PPO, or if its policy observed something else
            than the teacher's groups of the task.
        CheckpointError: if there is no such run or checkpoint.
    """
    agent = configs.need_agent()
    if not isinstance(agent, RslRlDistillationRunnerCfg):
        raise UserError(f"--teacher {given}: {task} is trained by PPO; --teacher is for tasks that are distilled")
    file = find_checkpoint(given)
    folder = RunFolder.of_checkpoint(file)
    if folder is None:
        raise UserError(f"--teacher {given}: is in no run folder, whose params say what its network is")
    saved = folder.read_params()
    if not isinstance(saved["agent"].get("actor"), Mapping):
        raise UserError(f"--teacher {given}: is no run of PPO, it has no actor; give the run that trained the teacher")
    agent.teacher = _network(saved["agent"]["actor"], given)
    agent.teacher_checkpoint = str(file.resolve())
    _check_observations(task, given, saved, configs, agent)


def check_teacher(task: str, configs: Configs, resumed: bool) -> None:
    """Check that a distillation has a teacher, before anything is built.

    Raises:
        UserError: if it has none.
    """
    agent = configs.need_agent()
    if isinstance(agent, RslRlDistillationRunnerCfg) and not agent.teacher_checkpoint and not resumed:
        raise UserError(f"{task} learns from a teacher: give --teacher RUN, the run folder of a trained policy")


def _network(actor: Mapping[str, object], given: str) -> RslRlMLPModelCfg:
    """Config of the teacher's network from the saved one of an actor."""
    name, distribution = actor.get("class_name"), actor.get("distribution_cfg")
    if name not in _NETWORKS:
        raise UserError(f"--teacher {given}: its network is {short(name)}, must be one of {', '.join(_NETWORKS)}")
    made = _NETWORKS[str(name)]()
    if isinstance(distribution, Mapping) and distribution.get("class_name") in _DISTRIBUTIONS:
        made.distribution_cfg = _DISTRIBUTIONS[distribution["class_name"]]()
    left = apply_saved(made, actor, "agent.teacher")
    if left:
        raise UserError(f"--teacher {given}: its network cannot be made again:\n" + "\n".join(left))
    return made


def _check_observations(
    task: str, given: str, saved: Mapping[str, dict], configs: Configs, agent: RslRlDistillationRunnerCfg
) -> None:
    """Compare the terms that the teacher's policy observed with those of its groups in the student's task."""
    groups = saved["agent"].get("obs_groups", {}).get("actor", ["policy"])
    before, now = saved["env"].get("observations"), configs.env.to_dict().get("observations")
    if not isinstance(before, Mapping) or not isinstance(now, Mapping):
        return  # environments without terms: sizes are compared when the networks are made
    wanted = _terms(before, groups)
    there = _terms(now, agent.obs_groups["teacher"])
    if list(wanted) != list(there):
        raise UserError(
            f"--teacher {given}: its policy observes {', '.join(wanted)}; "
            f"{', '.join(agent.obs_groups['teacher'])} of {task} has {', '.join(there) or 'nothing'}"
        )
    lines = [
        f"  {name}.{field}: {short(term.get(field))} for the teacher, here {short(there[name].get(field))}"
        for name, term in wanted.items()
        for field in _SETTINGS
        if term.get(field) != there[name].get(field)
    ]
    if lines:
        raise UserError(f"--teacher {given}: its policy was trained with other observations:\n" + "\n".join(lines))


def _terms(observations: Mapping[str, object], groups: list[str]) -> dict[str, Mapping[str, object]]:
    """Terms of some observation groups by name, in the order in which a network gets them."""
    found: dict[str, Mapping[str, object]] = {}
    for group in groups:
        fields = observations.get(group)
        for name, term in fields.items() if isinstance(fields, Mapping) else ():
            if isinstance(term, Mapping) and "func" in term:
                found[name] = term
    return found
