# SPDX-License-Identifier: Apache-2.0
"""Wrong values of config fields: set in Python, in a run folder, on the command line, in the file of a sweep."""

from __future__ import annotations

import functools
import random
import sys
from collections.abc import Iterator

import yaml
from case import Case
from values import Field, all_config_classes, fields_of, nonfinite_value, wrong_value

from stripe_newton.assets import RobotNotFoundError
from stripe_newton.cli.field_options import _docs
from stripe_newton.cli.tasks import load_cfg
from stripe_newton.configclass import is_config

__all__ = ["config_cases"]

TASKS = ("Stripe-Cartpole-Direct-v0", "Stripe-Cartpole-v0")
"""Tasks that the command line trains: quickly built."""
EXTREMES = ("0", "-1", "-5", "1e300", "-1e300", "1e-300", "1e38", "2147483648", "9223372036854775808", "1e9", "0.5", "")
WORDS = ("nan", "inf", "-inf", "abc", "1e999", "[1]", "True", "None", "", "0x10", "1,2", "--", "'", "\u0660", "1_000",
         "1e400", "-0.0", "+3", " 3", "9223372036854775808", "0b1", "1,5")  # fmt: skip


def config_cases(rng: random.Random, count: int) -> list[Case]:
    """About so many cases."""
    share = count // 100
    cases = list(python_cases(rng, 42 * share, nonfinite=False))
    cases += python_cases(rng, 20 * share, nonfinite=True)
    cases += yaml_cases(rng, 6 * share)
    cases += field_options(rng, 6 * share)
    cases += extremes(rng, 3 * share)
    return cases + list(sweep_cases(rng, 5 * share))


def python_cases(rng: random.Random, count: int, nonfinite: bool) -> Iterator[Case]:
    """Fields of all config classes."""
    classes = [cls for cls in all_config_classes("stripe_newton", "stripe_tasks") if _can_be_made(cls)]
    group = "config in Python: not finite" if nonfinite else "config in Python: wrong type"
    made = 0
    while made < count:
        cls = rng.choice(classes)
        fields = fields_of(cls, _docs(cls))
        if not fields:
            continue
        field = rng.choice(fields)
        value = nonfinite_value(field, rng) if nonfinite else wrong_value(field, rng)
        if value is None:
            continue
        made += 1
        data = {"cls": field.path, "field": field.name, "value": value}
        yield Case(group, "config", f"{cls.__name__}.{field.name} = {value}", data, [field.name])


@functools.cache  # each looks for the files again, also where there is a network
def _can_be_made(cls: type) -> bool:
    """Whether this machine has what the defaults of a config class need: some are of robots that others publish."""
    try:
        cls()
    except RobotNotFoundError as error:
        print(f"left out: {cls.__name__}: {str(error).partition(':')[0]} is not on this machine", file=sys.stderr)
        return False
    return True


def _leaves(task: str) -> list[tuple[str, Field]]:
    """Fields with plain values of the configs of a task, by dotted path."""
    found: list[tuple[str, Field]] = []

    def walk(cfg: object, path: str) -> None:
        if not is_config(cfg):
            return
        for field in fields_of(type(cfg), _docs(type(cfg))):
            value = getattr(cfg, field.name)
            if is_config(value):
                walk(value, f"{path}.{field.name}")
            elif value is None or isinstance(value, (bool, int, float, str, tuple, list)):
                found.append((f"{path}.{field.name}", field))

    walk(load_cfg(task, "env"), "env")
    walk(load_cfg(task, "agent"), "agent")
    return found


def _option(path: str) -> str:
    return "--" + path.replace("_", "-")


def yaml_cases(rng: random.Random, count: int) -> Iterator[Case]:
    """Values in ``params`` of a run folder, read by play, eval and resume."""
    leaves = {task: _leaves(task) for task in TASKS}
    made = 0
    while made < count:
        task = rng.choice(TASKS)
        path, field = rng.choice(leaves[task])
        value = wrong_value(field, rng) if rng.random() < 0.6 else nonfinite_value(field, rng)
        if value is None:
            continue
        plain = eval(value)
        try:
            yaml.safe_dump(plain)
        except yaml.YAMLError:
            continue
        made += 1
        root, _, inner = path.partition(".")
        files = [["copy_run", task, "run"], ["yaml_set", f"run/params/{root}.yaml", inner, value]]
        command = rng.choice(
            (
                ["eval", task, "--checkpoint", "run", "--episodes", "2", "--num-envs", "2", "--device", "cpu"],
                ["play", task, "--checkpoint", "run", "--viewer", "none", "--steps", "3", "--device", "cpu"],
                ["train", task, "--resume", "run", "--max-iterations", "4", "--final-video", "False"],
            )
        )
        names = [field.name]
        data = {"argv": command, "files": files}
        # A field that the command sets itself, or that the task of a run no longer has, may have any value.
        yield Case("config in a run folder", "command", f"{path} = {value} ({command[0]})", data, names)


def field_options(rng: random.Random, count: int) -> Iterator[Case]:
    """Words for the fields on the command line."""
    leaves = {task: _leaves(task) for task in TASKS}
    for _ in range(count):
        task = rng.choice(TASKS)
        path, field = rng.choice(leaves[task])
        name, word = _option(path), rng.choice(WORDS)
        if rng.random() < 0.15:
            name = rng.choice(
                (
                    name + "x",
                    name[:-1],
                    name.replace("-", "", 3),
                    name + "." + field.name,
                    name + ".__class__",
                    "--agent.__dict__.seed",
                    "--env.validate",
                )
            )
        is_text = "str" in str(field.hint)
        argv = ["train", task, "--max-iterations", "1", "--num-envs", "2", "--final-video", "False", "--device", "cpu"]
        argv += [f"{name}={word}"] if rng.random() < 0.5 else [name, word]
        wrong_number = word in ("nan", "inf", "-inf", "1e999")
        may = (is_text and name == _option(path)) or not wrong_number
        # A text may be taken, and refused later by what it should name: "joint 'nan' matches nothing".
        names = [field.name, name.strip("-"), "Required", repr(word)] + ([word] if name != _option(path) else [])
        yield Case("fields on the command line", "command", f"{name} {word!r}", {"argv": argv}, names, may)


def extremes(rng: random.Random, count: int) -> Iterator[Case]:
    """Numbers at the end of what can be, which must be refused or give finite results."""
    leaves = {
        task: [item for item in _leaves(task) if ("float" in str(item[1].hint) or "int" in str(item[1].hint))]
        for task in TASKS
    }
    for _ in range(count):
        task = rng.choice(TASKS)
        path, field = rng.choice(leaves[task])
        word = rng.choice(EXTREMES[:-1])
        argv = ["train", task, "--max-iterations", "2", "--num-envs", "2", "--final-video", "False", "--device", "cpu"]
        argv += ["--agent.num-steps-per-env", "8", "--agent.algorithm.num-mini-batches", "2", _option(path), word]
        if path in ("env.scene.num_envs", "agent.num_steps_per_env", "agent.algorithm.num_mini_batches"):
            argv = argv[:2] + argv[-2:] + ["--max-iterations", "2", "--final-video", "False", "--device", "cpu"]
        names = [field.name, path.rpartition(".")[2], "memory", "diverged"]
        data = {"argv": argv, "finite": "logs"}
        yield Case("extreme numbers", "command", f"{_option(path)} {word}", data, names, may_pass=True)


SWEEPS = (
    ("agent.algorithm.gamma: {value}", ("gamma",)),
    ("agent.algorithm.gamma: [0.9, {value}]", ("gamma",)),
    ("agent.algorithm.gamma: {{low: {value}, high: 0.99}}", ("gamma", "trials")),
    ("agent.algorithm.gamma: {{low: 0.1, high: 0.99, step: {value}}}", ("gamma", "trials")),
    ("agent.algorithm.gamma: {{choices: {value}}}", ("gamma",)),
    ("agent.algorithm.learning-rate: {{low: {value}, high: 1.0, log: true}}", ("learning-rate", "trials")),
    ("env.sim.dt: [0.01, {value}]", ("dt",)),
    ("agent.actor.hidden-dims: [[{value}]]", ("hidden-dims",)),
    ("agent.actor.activation: [{value}]", ("activation",)),
    ("agent.algorithm.gamma: [0.9]\nseeds: {value}", ("seeds",)),
    ("agent.algorithm.gamma: [0.9]\nseeds: [1, {value}]", ("seeds",)),
    ("agent.algorithm.gamma: [0.9]\ntrials: {value}", ("trials",)),
    ("agent.algorithm.gamma: [0.9]\nsampler: {value}", ("sampler",)),
    ("agent.algorithm.gamma: [0.9]\nobjective: {value}", ("objective",)),
    ("agent.algorithm.gamma: [0.9]\nlast: {value}", ("last",)),
    ("agent.algorithm.gamma: [0.9]\nmaximize: {value}", ("maximize",)),
    ("agent.algorithm.gamma: [0.9]\npruner: {value}", ("pruner",)),
    ("agent.algorithm.gamma: [0.9]\npruner: {{startup_trials: {value}}}", ("pruner", "startup_trials")),
    ("agent.algorithm.gamma: [0.9]\nmax_iterations: {value}", ("max_iterations",)),
    ("agent.algorithm.gamma: [0.9]\nnum_envs: {value}", ("num_envs",)),
    ("agent.algorithm.gamma: [0.9]\nname: {value}", ("name",)),
    ("env.nothing.here: {value}", ("nothing",)),
    ("{value}: [1]", ("sweep.yaml",)),
    ("{value}", ("sweep.yaml",)),
)
SWEEP_VALUES = (
    ".nan", ".inf", "-.inf", "text", "''", "null", "[]", "{}", "[[]]", "-1", "1.5e300", "true", "2020-01-01",
    "!!binary aGk=", "{a: 1}", "99999999999999999999", "../../x", "a;b", "[nan]", "0", "!!set {a}", "'$(touch pwned)'",
    "1e400", "-5",
)  # fmt: skip


def sweep_cases(rng: random.Random, count: int) -> Iterator[Case]:
    """Entries of the file of a sweep."""
    for _ in range(count):
        (text, names), value = rng.choice(SWEEPS), rng.choice(SWEEP_VALUES)
        content = text.format(value=value)
        data = {
            "argv": ["train", TASKS[0], "--sweep", "sweep.yaml", "--device", "cpu"],
            "files": [["write", "sweep.yaml", content]],
            "no_sweep": True,
        }
        yield Case("file of a sweep", "command", content.replace("\n", "; "), data, [*names, "valid YAML"], True)
