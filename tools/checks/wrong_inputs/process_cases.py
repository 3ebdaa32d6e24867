# SPDX-License-Identifier: Apache-2.0
"""Odd circumstances: options that exclude each other, runs elsewhere, surroundings and ends of commands."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

from case import Case
from command_cases import BENCH, EVAL, EXPORT, PLAY, RUN, TASK, TRAIN

__all__ = ["process_cases"]

OTHER = "Stripe-Cartpole-v0"
RESUME = ["train", TASK, "--resume", "run", "--max-iterations", "4", "--final-video", "False", "--device", "cpu"]


def process_cases(rng: random.Random, count: int) -> list[Case]:
    """About so many cases."""
    share = count // 100
    return [*options_together(rng, share), *runs_elsewhere(rng, 2 * share), *processes(rng, share)]


TOGETHER: tuple[tuple[list[str], list[str], bool], ...] = (
    ([*PLAY, "--agent", "zero"], ["--agent"], False),
    ([*EVAL, "--agent", "zero"], ["--agent"], False),
    ([*RESUME, "--teacher", "run"], ["--teacher"], False),
    ([*RESUME, "--log-dir", "elsewhere"], ["--log-dir"], False),
    ([*RESUME, "--sweep", "run/params/env.yaml"], ["--sweep", "sweep"], False),
    ([*TRAIN, "--jobs", "2"], ["--jobs"], False),
    ([*TRAIN, "--teacher", "run"], ["--teacher"], False),
    ([*TRAIN, "--num-envs", "2", "--env.scene.num-envs", "3"], ["num-envs"], False),
    ([*TRAIN, "--env.scene.num-envs", "3", "--num-envs", "2"], ["num-envs"], False),
    ([*TRAIN, "--seed", "1", "--agent.seed", "2"], ["seed"], False),
    ([*TRAIN, "--agent.max-iterations", "3"], ["max-iterations"], False),
    ([*TRAIN, "--env.sim.device", "cuda:0"], ["device"], False),
    ([*TRAIN, "--runner", "rsl_rl", "--agent.runner", "graph"], ["runner"], False),
    ([*TRAIN, "--num-envs", "2", "--num-envs", "3"], ["--num-envs"], True),
    ([*TRAIN, "--gpus", "2", "--viewer", "none", "--num-envs", "1"], ["--gpus", "num-envs"], False),
    ([*TRAIN, "--gpus", "2", "--device", "cuda:1"], ["--device"], False),
    ([*TRAIN, "--viewer", "viser", "--port", "99999"], ["--port"], False),
    ([*TRAIN, "--viewer", "viser", "--port", "-1"], ["--port"], False),
    ([*TRAIN, "--viewer", "viser", "--host", "999.1.1.1"], ["--host"], False),
    ([*TRAIN, "--viewer", "viser", "--host", ""], ["--host"], False),
    (["compare", "run", "run", "--metric", "Loss/valeu"], ["Loss/valeu"], False),
    (["report", "run", "run"], ["run"], True),
    ([*EXPORT, "--task", OTHER], ["--task", OTHER], False),
    (["inspect", TASK, "--viewer", "viser", "--port", "99999"], ["--port"], False),
)
"""Arguments, words of a clear message, and whether they may go together."""


def options_together(rng: random.Random, count: int) -> Iterator[Case]:
    """Options that exclude each other, or name one thing twice."""
    for _ in range(count):
        argv, names, may = rng.choice(TOGETHER)
        data = {"argv": argv, "files": [RUN]}
        yield Case("options together", "command", " ".join(argv), data, names, may)


PLACES: dict[str, tuple[list[Any], str, bool]] = {
    "moved": (["rename", "run", "other place"], "other place", True),
    "letters": (["rename", "run", "räum 场"], "räum 场", True),
    "spaces": (["rename", "run", " a  b "], " a  b ", True),
    "apostrophe": (["rename", "run", "it's $HOME;x"], "it's $HOME;x", True),
    "symlink": (["symlink", "run", "link"], "link", True),
    "nested": (["rename", "run", "a/b/c/run"], "a/b/c/run", True),
    "checkpoints": (["mkdir", "empty"], "run/checkpoints", True),
    "params": (["mkdir", "empty"], "run/params", False),
    "above": (["rename", "run", "logs/x/run"], "logs", False),
    "no params": (["remove", "run/params"], "run", True),
    "no agent": (["remove", "run/params/agent.yaml"], "run", False),
    "no env": (["remove", "run/params/env.yaml"], "run", False),
    "no task": (["remove", "run/params/run.yaml"], "run", True),
    "no metrics": (["remove", "run/metrics.csv"], "run", True),
    "no checkpoints": (["remove", "run/checkpoints"], "run", True),
    "file alone": (["rename", "run/checkpoints/model_1.pt", "model_1.pt"], "model_1.pt", True),
    "renamed file": (["rename", "run/checkpoints/model_1.pt", "best.pt"], "best.pt", True),
    "other network": (["yaml_set", "run/params/agent.yaml", "actor.hidden_dims", "[7, 7]"], "run", False),
    "other solver": (["yaml_set", "run/params/env.yaml", "sim.solver.iterations", "7"], "run", True),
    "other space": (["yaml_set", "run/params/env.yaml", "observation_space", "9"], "run", False),
    "unknown field": (["yaml_set", "run/params/env.yaml", "scene.num_envz", "9"], "run", True),
    "removed field": (["yaml_set", "run/params/env.yaml", "scene", "{}"], "run", True),
}
"""What happens to a run folder, how it is named then, and whether it may work."""

UNKNOWN = ("no params", "no task", "file alone", "renamed file")
"""Places in which nothing says of which task a checkpoint is."""


def runs_elsewhere(rng: random.Random, count: int) -> Iterator[Case]:
    """Run folders that were moved, renamed, lack a part, or are of another task, network or version."""
    for _ in range(count):
        argv, name = list(rng.choice((EVAL, PLAY, EXPORT, RESUME))), rng.choice(list(PLACES))
        step, target, may = PLACES[name]
        run = [RUN[0], rng.choice((TASK, TASK, TASK, OTHER)), RUN[2]]
        argv[argv.index("run")] = target
        own = argv[0] == "export" or run[1] == TASK or name in UNKNOWN
        data = {"argv": argv, "files": [run, step]}
        names = [target, target.rpartition("/")[2], *map(str, step[1:]), "checkpoint", "env.yaml", "agent.yaml"]
        names += [] if own else [OTHER]
        yield Case("runs elsewhere", "command", f"{argv[0]}: {name}, of {run[1]}", data, names, may and own)


ENVIRONMENTS: tuple[dict[str, str | None], ...] = (
    {"HOME": None}, {"HOME": "/nonexistent"}, {"TMPDIR": "/nonexistent"}, {"LC_ALL": "C", "PYTHONUTF8": "0"},
    {"PYTHONIOENCODING": "ascii"}, {"COLUMNS": "10"}, {"TERM": "dumb"}, {"MPLCONFIGDIR": "/dev/null"},
    {"XDG_CACHE_HOME": "/dev/null"}, {"CUDA_VISIBLE_DEVICES": ""}, {"CUDA_VISIBLE_DEVICES": "abc"},
    {"OMP_NUM_THREADS": "abc"}, {"WORLD_SIZE": "abc"}, {"WORLD_SIZE": "0"}, {"RANK": "3"}, {"LOCAL_RANK": "x"},
    {"WORLD_SIZE": "2"}, {"WARP_CACHE_PATH": "/dev/null/x"}, {"DISPLAY": ":99"}, {"PYTHONHASHSEED": "1"},
    {"MPLBACKEND": "nothing"}, {"PYTHONOPTIMIZE": "2"}, {"USER": None, "LOGNAME": None}, {"WARP_CACHE_PATH": "/proc"},
    {"HOME": "/proc/1/x"}, {"HOME": "/dev/null"}, {"XDG_CACHE_HOME": "/proc/x"}, {"MATPLOTLIBRC": "/dev/null/x"},
    {"PYTHONWARNINGS": "error"}, {"NO_COLOR": "1"}, {"LC_ALL": "xx_YY"}, {"CUBLAS_WORKSPACE_CONFIG": "x"},
    {"PYTHONHASHSEED": "abc"}, {"LANG": "tr_TR.UTF-8"}, {"TZ": "Nonsense/Zone"}, {"COLUMNS": "1"}, {"COLUMNS": "abc"},
    {"COLUMNS": "-5"}, {"HOME": "relative"}, {"HOME": ""}, {"TMPDIR": "/dev/null"}, {"PYTHONOPTIMIZE": "1"},
    {"OMP_NUM_THREADS": "-3"}, {"OMP_NUM_THREADS": "999999999"}, {"PYTHONPYCACHEPREFIX": "/dev/null/x"},
    {"STRIPE_NEWTON_PROCESSES": "abc"}, {"STRIPE_NEWTON_STREAMS": "x"}, {"STRIPE_NEWTON_TRITON": "x"},
    {"STRIPE_NEWTON_SWEEP_PIPE": "x"}, {"STRIPE_NEWTON_SWEEP_PIPE": "99"}, {"STRIPE_NEWTON_LAUNCHER": "x"},
    {"MENAGERIE_ROOT": "/dev/null"}, {"PXR_PLUGINPATH_NAME": "/dev/null"}, {"LOCAL_WORLD_SIZE": "x"},
    {"XDG_CACHE_HOME": "relative/x"}, {"TORCHINDUCTOR_CACHE_DIR": "/dev/null/x"}, {"TORCH_LOGS": "nonsense"},
    {"SOURCE_DATE_EPOCH": "abc"}, {"WARP_CACHE_PATH": "a b{}%s"},
)  # fmt: skip
OUTPUTS = ("head", "closed", "full", "closed input")
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


def processes(rng: random.Random, count: int) -> Iterator[Case]:
    """Commands in processes of their own: environment variables, standard output, and signals at any moment."""
    for _ in range(count):
        argv = rng.choice((TRAIN, TRAIN, EVAL, BENCH, ["list"], ["compare", "run", "--metric", "Loss/value"]))
        kind = rng.choice(("environment", "output", "signal"))
        data: dict[str, Any] = {"argv": argv, "files": [RUN]}
        if kind == "environment":
            data["environ"] = chosen = rng.choice(ENVIRONMENTS)
            names, what = [*chosen], " ".join(f"{name}={value}" for name, value in chosen.items())
        elif kind == "output":
            data["output"] = what = rng.choice(OUTPUTS)
            names = []
        else:
            argv = data["argv"] = [*TRAIN, "--max-iterations", "1000000"] if argv == TRAIN else argv
            data["signal"], data["after"] = rng.choice(SIGNALS), rng.uniform(0.0, 15.0)
            names, what = [], f"{data['signal']} after {data['after']:.1f} s"
        yield Case("processes", "process", f"{argv[0]}: {what}", data, names, may_pass=True)
