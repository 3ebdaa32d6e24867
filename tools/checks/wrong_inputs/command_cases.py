# SPDX-License-Identifier: Apache-2.0
"""Wrong command lines: options of the commands, broken modules, places that cannot be written, foreign code."""

from __future__ import annotations

import random
from collections.abc import Iterator

from case import Case

__all__ = ["ABSOLUTE", "command_cases"]

ABSOLUTE = "/tmp/wrong-inputs-absolute"
"""A place that no run may write to."""
TASK = "Stripe-Cartpole-Direct-v0"
TRAIN = ["train", TASK, "--device", "cpu", "--num-envs", "2", "--max-iterations", "2", "--final-video", "False"]
EVAL = ["eval", TASK, "--checkpoint", "run", "--device", "cpu", "--num-envs", "2", "--episodes", "2"]
PLAY = ["play", TASK, "--checkpoint", "run", "--device", "cpu", "--viewer", "none", "--steps", "3"]
BENCH = ["bench", TASK, "--device", "cpu", "--num-envs", "2", "--steps", "4"]
EXPORT = ["export", "run", "--device", "cpu"]
COMMANDS = {"train": TRAIN, "eval": EVAL, "play": PLAY, "bench": BENCH}
RUN = ["copy_run", TASK, "run"]


def command_cases(rng: random.Random, count: int) -> list[Case]:
    """About so many cases."""
    share = count // 100
    cases = list(own_options(rng, 4 * share))
    cases += written_places(rng, 3 * share)
    cases += broken_modules(rng, 2 * share)
    return cases + list(foreign_code(rng, 2 * share))


NUMBERS = (
    "0",
    "-1",
    "-2147483649",
    "99999999999999999999",
    "1000000000",
    "abc",
    "",
    "1.5",
    "nan",
    "None",
    "0x3",
    "2 3",
)
OPTIONS = {
    "train": ("--num-envs", "--max-iterations", "--seed", "--video-interval", "--gpus", "--jobs"),
    "eval": ("--num-envs", "--episodes", "--seed"),
    "play": ("--num-envs", "--steps", "--seed"),
    "bench": ("--num-envs", "--steps", "--seed"),
}
LENGTHS = ("--steps", "--episodes", "--max-iterations")
TEXTS = {
    "train": ("--device", "--runner", "--resume", "--final-video", "--allow-changes", "--sweep"),
    "eval": ("--device", "--checkpoint"),
    "play": ("--device", "--checkpoint", "--agent", "--viewer"),
    "bench": ("--device",),
}
WORDS = ("", "cuda:99", "cuda:-1", "gpu", "\n", "nan", "/", "/dev/null", "..", "~nobody/x", "a\u0000b", "x" * 5000, "0")


def own_options(rng: random.Random, count: int) -> Iterator[Case]:
    """Values of the commands' own options."""
    for _ in range(count):
        command = rng.choice(list(COMMANDS))
        number = rng.random() < 0.6
        option = rng.choice(OPTIONS[command] if number else TEXTS[command])
        word = rng.choice(NUMBERS if number else WORDS)
        if option in LENGTHS and word.isdecimal() and int(word) > 1000:
            word = "1.5"  # a large number is no error, but a long wait
        argv = list(COMMANDS[command])
        if option in argv:
            del argv[argv.index(option) : argv.index(option) + 2]
        argv = [*argv, option, word]
        fine = word in ("0", "-1", "-2147483649", "1000000000", "99999999999999999999") and option == "--seed"
        may = fine or (option, word) in {("--video-interval", "0"), ("--video-interval", "1000000000")}
        may = may or (option == "--max-iterations" and command != "train")
        names = [option, option.strip("-"), "memory", *([word] if word.strip() else [])]
        text = f"{command} {option} {word[:20]!r}"
        yield Case("options of commands", "command", text, {"argv": argv, "files": [RUN]}, names, may)


PLACES = (
    "/dev/full",
    "/proc/x",
    "file/below",
    "folder",
    "fifo",
    "n" * 300,
    "a\u0000b",
    "",
    "/sys/x.json",
    "dangling",
    "loop",
    "read_only/x",
)


def written_places(rng: random.Random, count: int) -> Iterator[Case]:
    """Files and folders that cannot be written, in every option that names one."""
    options = (
        (EVAL, "--json", []),
        (BENCH, "--json", []),
        (EXPORT, "--out", []),
        (TRAIN, "--log-dir", []),
        (["compare", "run", "--metric", "Loss/value"], "--out", []),
        (["inspect", TASK], "--out", []),
        (["scene", "build", "stripe_tasks.rubble.scenes:RubbleSpec"], "--out", []),
    )
    files = [RUN, ["write", "file", "x"], ["mkdir", "folder"], ["mkfifo", "fifo"], ["symlink", "nowhere/x", "dangling"]]
    files += [["symlink", "loop", "loop"]]
    for _ in range(count):
        argv, option, _ = rng.choice(options)
        place = rng.choice(PLACES)
        data = {"argv": [*argv, option, place], "files": files}
        if rng.random() < 0.3:
            data["file_size_limit"], place = rng.choice((0, 100)), "place"
            data["argv"] = [*argv, option, place]
        folder = option in ("--out", "--log-dir") and argv[0] != "scene"
        may = "file_size_limit" not in data and (
            (folder and place in ("folder", "", "dangling")) or place == "dangling"
        )
        may = may or ("file_size_limit" not in data and place == "read_only/x")
        names = [place[:40] or option, option, "written"]
        yield Case("written places", "command", f"{argv[0]} {option} {place[:20]!r}", data, names, may)


NO_MODULES = ("folder", "own.txt", "", "..", "1abc", "own;x", "/", "./folder", "/dev/zero", "fifo/", "folder/own")
MODULES = {
    "syntax": "def f(:\n",
    "name": "undefined_name\n",
    "import": "import no_such_package_at_all\n",
    "exit": "import sys; sys.exit(3)\n",
    "exit text": "import sys; sys.exit('bye')\n",
    "system exit 0": "raise SystemExit\n",
    "recursion": "def f(): f()\nf()\n",
    "base": "class Odd(BaseException): pass\nraise Odd('odd')\n",
    "null": "x = 1\0\n",
    "latin": None,
    "empty message": "raise ValueError\n",
    "many lines": "raise ValueError('a\\n' * 100)\n",
    "memory": "x = bytearray(10 ** 15)\n",
    "os": "open('/no/such/file')\n",
    "registers nothing": "x = 1\n",
    "bad config": (
        "import gymnasium\ngymnasium.register('Own-v0', entry_point='nowhere:Env', vector_entry_point='nowhere:Env', "
        "kwargs={'env_cfg_entry_point': 'nowhere:Cfg', 'rsl_rl_cfg_entry_point': 'nowhere:Cfg'})\n"
    ),
    "config raises": (
        "import gymnasium\ndef cfg(): raise KeyError('x')\n"
        "gymnasium.register('Own-v0', vector_entry_point=cfg, kwargs={'env_cfg_entry_point': cfg})\n"
    ),
    "config is none": (
        "import gymnasium\ndef cfg(): return None\n"
        "gymnasium.register('Own-v0', vector_entry_point=cfg, "
        "kwargs={'env_cfg_entry_point': cfg, 'rsl_rl_cfg_entry_point': cfg})\n"
    ),
    "group exception": "raise ExceptionGroup('g', [ValueError('a')])\n",
    "stop": "raise StopIteration\n",
    "class without arguments": "class Model: pass\n",
    "class raises": "class Model:\n    def __init__(self, *args, **fields): self.x\n",
    "class is no network": "class Model:\n    def __init__(self, *args, **fields): pass\n",
    "class is a function": "def Model(*args, **fields): return None\n",
}


def broken_modules(rng: random.Random, count: int) -> Iterator[Case]:
    """Modules for ``--import`` that cannot be imported, or that register what cannot be used."""
    for _ in range(count):
        name, command = rng.choice(list(MODULES)), rng.choice(("list", "train", "eval", "play", "bench"))
        text = MODULES[name]
        file = ["write", "own.py", text] if text is not None else ["write_bytes", "own.py", "efbbbf27ff2227"]
        argv = [command] if command == "list" else list(COMMANDS[command])
        if "Own-v0" in (text or "") and command != "list":
            argv[1] = "Own-v0"
        if name.startswith("class"):
            argv = [*TRAIN, "--agent.actor.class-name", "own:Model"]
        target = rng.choice(("own.py", "own", "./own.py"))
        if target == "own" and name == "registers nothing":
            target = rng.choice(NO_MODULES)
        data = {"argv": [*argv, "--import", target], "files": [RUN, file, ["mkdir", "folder"]]}
        may = name == "registers nothing" or (command == "list" and "Own-v0" in (text or ""))
        names = ["own", target, "Own-v0"] if target else ["--import"]
        yield Case("broken modules", "command", f"{argv[0]} --import {target} ({name})", data, names, may)


CLASSES = (
    "evilmod:Model",
    "evilmod.Model",
    "os:system",
    "subprocess:Popen",
    "rsl_rl.models:os.system",
    "evilmod:",
    ":x",
)
CLASS_FIELDS = (
    "agent:actor.class_name",
    "agent:critic.class_name",
    "agent:algorithm.class_name",
    "agent:actor.distribution_cfg.class_name",
    "agent:logger",
    "agent:actor.activation",
    "agent:algorithm.optimizer",
)
FOLDERS = (
    "a/../../b",
    "../up",
    ABSOLUTE,
    "a;touch pwned",
    "$(touch pwned)",
    "`x`",
    "~",
    "a\nb",
    "-rf",
    "a\u0000b",
    ".",
    "n" * 300,
)


OPTION_FIELDS = ("agent.actor.class-name", "agent.critic.class-name", "agent.algorithm.class-name")
SWEPT_PLACES = ("../elsewhere.xml", ABSOLUTE, "logs/x.xml")


def foreign_code(rng: random.Random, count: int) -> Iterator[Case]:
    """Foreign classes in run folders, sweeps and options, and names of folders that lead out of the log folder."""
    evil = ["write", "evilmod.py", "open('pwned', 'w').write('x')\nclass Model: pass\n"]
    for _ in range(count):
        if rng.random() < 0.6:
            place, value = rng.choice(CLASS_FIELDS), rng.choice(CLASSES)
            root, _, path = place.partition(":")
            text = repr({"class_name": value, "args": "touch pwned", "shell": True} if path == "logger" else value)
            files = [RUN, evil, ["yaml_set", f"run/params/{root}.yaml", path, text]]
            resume = ["train", TASK, "--resume", "run", "--max-iterations", "4", "--final-video", "False"]
            argv = rng.choice((EVAL, PLAY, EXPORT, resume))
            names, what = [value, path.rpartition(".")[2]], f"{argv[0]}: {path} = {value}"
        elif rng.random() < 0.5:
            field, value = rng.choice(OPTION_FIELDS), rng.choice(CLASSES)
            if rng.random() < 0.3:
                field, value = "env.sim.solver.save-to-mjcf", rng.choice(SWEPT_PLACES)
            sweeps = rng.random() < 0.5 or field.startswith("env.")
            files = [RUN, evil, ["write", "sweep.yaml", f"{field}: ['{value}']\n"]]
            argv = [*TRAIN, "--sweep", "sweep.yaml"] if sweeps else [*TRAIN, f"--{field}={value}"]
            names, what = [value, field], f"{'sweep' if sweeps else 'option'}: {field} = {value}"
        else:
            option, value = rng.choice(("--agent.experiment-name", "--agent.run-name")), rng.choice(FOLDERS)
            argv, files = [*TRAIN, f"{option}={value}"], [RUN]
            names, what = [option.strip("-"), "experiment_name", "run_name"], f"{option} {value[:20]!r}"
        data = {"argv": argv, "files": files, "forbidden": ["pwned"], "only_below": ["logs", "run", "sweep.yaml"]}
        yield Case("foreign code and paths", "command", what, data, names)
