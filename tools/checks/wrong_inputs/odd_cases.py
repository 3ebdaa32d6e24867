# SPDX-License-Identifier: Apache-2.0
"""Odd inputs: unusual forms of YAML, names of folders, expressions without end, data in stages, other tasks' runs."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator

from case import Case
from command_cases import BENCH, EVAL, EXPORT, PLAY, RUN, TASK, TRAIN
from process_cases import OTHER, RESUME

__all__ = ["odd_cases"]


def odd_cases(rng: random.Random, count: int) -> list[Case]:
    """About so many cases."""
    share = count // 100
    cases = list(yaml_forms(rng, 2 * share))
    cases += expressions(rng, share)
    cases += stage_data(rng, 2 * share)
    cases += odd_folders(rng, share)
    return cases + list(other_tasks(rng, share))


DT = "dt: 0.008333333333333333"
NUMBERS = {
    "010": False, "1:30:00.5": False, "0:30": False, "!!float 0.01": True, "!!float 'nan'": False, "!!float ''": False,
    "!!int ''": False, "!!int 0x10": False, "!!str 0.01": False, "!!null x": False, "!!timestamp x": False,
    "!local 0.01": False, "!!python/name:os.system": False, "!!python/object/new:os.system ['touch pwned']": False,
    "*nothing": False, "&a 0.01": True, "1e-2": False, ".1": True, "1_0.0e-3": True, "0x1": True, "yes": False,
    "~": False, "|\n    0.01": False, "-0.0": False, "1e400": False, "9223372036854775808": False, "1" * 5000: False,
    "2020-13-45": False, "0.01\0": False, "'0.01'": False, "!!set {0.01}": False, "!!omap [a: 1]": False,
    "\uff10.\uff11": False, "Infinity": False, ".NaN": False, "=": False, "0.01\n  dt: 0.02": False,
}  # fmt: skip
"""Time steps as YAML, and whether they are right."""
FORMS: dict[str, tuple[str, str, bool]] = {
    "key twice": ("seed: 42", "seed: 42\nseed: 43", False),
    "key twice, nested": ("  class_name: MLPModel", "  class_name: MLPModel\n  class_name: MLPModel", False),
    "merged scalar": ("actor:\n", "actor:\n  <<: 3\n", False),
    "merged list": ("actor:\n", "actor:\n  <<: [1, 2]\n", False),
    "two documents": ("seed: 42", "--- {}\n---\nseed: 42", False),
    "mark of byte order": ("seed: 42", "\ufeffseed: 42", True),
    "ends of Windows": ("\n", "\r\n", True),
    "tabs": ("  ", "\t", False),
    "version": ("seed: 42", "%YAML 1.2\n---\nseed: 42", True),
    "no version": ("seed: 42", "%YAML 9.9\n---\nseed: 42", False),
    "end": ("seed: 42", "seed: 42\n...\n", False),
    "key that is a list": ("seed: 42", "seed: 42\n? [a, b]\n: 3", False),
    "key that is a number": ("seed: 42", "seed: 42\n3: 4", False),
    "key that is none": ("seed: 42", "seed: 42\n~: 4", False),
    "private": ("seed: 42", "seed: 42\n__class__: 4\n_x: 3\n__init__: {x: 1}", False),
    "methods": ("seed: 42", "seed: 42\nvalidate: 3\nto_dict: null\nreplace: []", False),
    "dotted": ("seed: 42", "seed: 42\nactor.activation: relu", False),
    "escape": ("seed: 42", "seed: 42\x1b[31m", False),
    "null": ("seed: 42", "seed: 42\0", False),
    "long key": ("seed: 42", "seed: 42\n? " + "k" * 5000 + "\n: 1", False),
    "surrogate": ("run_name: ''", 'run_name: "\\ud800"', False),
    "control in a name": ("run_name: ''", 'run_name: "a\\x1b[2Jb"', False),
    "other letters": ("run_name: ''", "run_name: 机器人", True),
    "other sign": ("run_name: ''", "run_name: 🤖", False),
}
"""What is replaced in ``agent.yaml``, by what, and whether the result is right."""


def yaml_forms(rng: random.Random, count: int) -> Iterator[Case]:
    """Run folders whose YAML has anchors, tags, directives, other spellings of numbers, keys twice."""
    for _ in range(count):
        argv = rng.choice((EVAL, PLAY, EXPORT, RESUME))
        if rng.random() < 0.5:
            value = rng.choice(list(NUMBERS))
            step, may = ["text", "run/params/env.yaml", DT, f"dt: {value}"], NUMBERS[value]
            names, what = ["dt", "env.yaml"], f"dt: {value[:40]!r}"
        else:
            what = rng.choice(list(FORMS))
            old, new, may = FORMS[what]
            step, names = ["text", "run/params/agent.yaml", old, new], ["agent"]
        data = {"argv": argv, "files": [RUN, step], "forbidden": ["pwned"]}
        yield Case("forms of YAML", "command", f"{argv[0]}: {what}", data, names, may)


SLOW = ("(.|.|.|.|.|.)*Q", "([a-z_]+)*Q", "(?:.?){40}Q", "(?=(.|.)*Q).*", "(.*)*(.*)*Q", "((.|.){8}|x){16}Q",
        ".*" * 30 + "Q", "(.|.)" * 60)  # fmt: skip
"""Expressions that would take hours for names of some twenty letters."""
NO_EXPRESSIONS = ("(", "[", "*", "a{99999999999}", "(" * 3000 + ")" * 3000, "(?P<1>a)", "\\", "(?<=a*)b")
EXPRESSION_PLACES = (
    ("joint_names_expr: [slider_to_cart]", "joint_names_expr: ['{}']"),
    ("    joint_names: [slider_to_cart]", "    joint_names: ['{}']"),
)


def expressions(rng: random.Random, count: int) -> Iterator[Case]:
    """Run folders with regular expressions that are none, or that take hours to match."""
    for _ in range(count):
        task = rng.choice((OTHER, TASK))
        old, new = EXPRESSION_PLACES[0] if task == TASK else rng.choice(EXPRESSION_PLACES)
        text = rng.choice(SLOW if rng.random() < 0.7 else NO_EXPRESSIONS)
        argv = [task if word == TASK else word for word in rng.choice((EVAL, PLAY, EXPORT, RESUME))]
        files = [["copy_run", task, "run"], ["text", "run/params/env.yaml", old, new.replace("{}", text)]]
        names = ["expression", "joint", "env.yaml"]
        yield Case("expressions", "command", f"{argv[0]}: {text[:40]}", {"argv": argv, "files": files}, names)


GOOD = {"format": "urdf", "path": "robot.urdf", "floating": True}
FILE_DATA = (
    "{", "[1]", "3", "null", "[" * 100_000, {"path": "robot.urdf"}, {"format": "urdf"}, {**GOOD, "format": "sdf"},
    {**GOOD, "format": 3}, {**GOOD, "path": 3}, {**GOOD, "path": "/no/robot.urdf"}, {**GOOD, "path": "/dev/zero"},
    {**GOOD, "path": "fifo"}, {**GOOD, "path": "http://127.0.0.1:9/x.urdf"}, {**GOOD, "format": "mjcf"},
    {**GOOD, "builder": 1}, {**GOOD, "func": "os:system"}, {**GOOD, "floating": "x"}, {**GOOD, "scale": "x"},
    {**GOOD, "scale": float("nan")}, {**GOOD, "packages": {"a": 3}}, {**GOOD, "joint_stiffness": {"(": 1.0}},
    {**GOOD, "mesh_maxhullvert": 2},
)  # fmt: skip
NAMES_DATA = (
    "{", "[1]", "3", {"bodies": [1]}, {"bodies": {"a": 3}}, {"bodies": {"(": "x"}}, {"nothing": {}},
    {"bodies": {"(a|aa)*Q": "x"}}, {"bodies": {".*": r"\9"}}, {"bodies": {".*": "../x"}}, {"bodies": {".*": ""}},
    {"links": {".*": 3}}, {"links": {".*": ["foot", "(.|.)*Q"]}}, {"links": {"(.|.)*Q": ["foot", ".*"]}},
    {"links": {".*": ["foot", "("]}}, {"joints": {"x": "y"}},
)  # fmt: skip
URDF = (
    f'<robot name="r"><link name="{"a" * 64}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
    'ixz="0" iyz="0"/></inertial><collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>'
)
STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World"
{
    def Xform "thing" (
        customData = {
            dictionary stripeNewton = {
                %s
            }
        }
    )
    {
    }
}
"""
OPEN = (
    "from stripe_newton.scene import InteractiveScene\nfrom stripe_newton.sim import SimulationCfg\n"
    "InteractiveScene.from_usd('scene.usda', sim_cfg=SimulationCfg(device='cpu'))"
)


def stage_data(rng: random.Random, count: int) -> Iterator[Case]:
    """Stages of somebody else's with data that this project keeps with prims."""
    for _ in range(count):
        if rng.random() < 0.6:
            data = {"file": rng.choice(FILE_DATA)}
        else:
            data = {"file": GOOD, "names": rng.choice(NAMES_DATA)}
        lines = [_custom_data(key, value, rng) for key, value in data.items()]
        files = [["write", "scene.usda", STAGE % "\n".join(lines)], ["write", "robot.urdf", URDF], ["mkfifo", "fifo"]]
        what = f"custom data: {' '.join(lines)[:100]}"
        call = {"env": "", "prepare": "", "code": OPEN, "files": files}
        yield Case("data in stages", "call", what, call, ["/World/thing"])


def _custom_data(key: str, value: object, rng: random.Random) -> str:
    """A line of USD: the value as JSON in a text, or seldom something that is no text."""
    if value is not GOOD and rng.random() < 0.1:
        return rng.choice((f"int {key} = 3", f"double {key} = 1.5", f"dictionary {key} = {{ int a = 1 }}"))
    text = value if isinstance(value, str) else json.dumps(value)
    return f"string {key} = {json.dumps(text)}"


FOLDERS = ("a b", "a%sb", "{x}", "{}", "a'b", 'a"b', "a\nb", "a\tb", "räum 场", "🤖", "a\\b", "--help", "~", "*", "[x]",
           "a;b", "$HOME", "#x", "a:b", "a,b", " ", "\u202eabc", "a\x1b[31m", "x" * 255, "...",
           "a/" * 200 + "a")  # fmt: skip
NEW = ["new", "own_package"]
LOCAL = (TRAIN, EVAL, PLAY, EXPORT, RESUME, [*BENCH, "--json", "x.json"], ["report", "run"], ["inspect", TASK],
         ["compare", "run", "--metric", "Loss/value"], NEW)  # fmt: skip


def odd_folders(rng: random.Random, count: int) -> Iterator[Case]:
    """Working directories with unusual names, and one that was deleted."""
    for _ in range(count):
        argv = rng.choice(LOCAL)
        if rng.random() < 0.25:
            data = {"argv": argv, "files": [["go_nowhere"]]}
            yield Case("odd folders", "command", f"{argv[0]}: in a deleted folder", data, ["working directory", "run"])
            continue
        name = rng.choice(FOLDERS)
        data = {"argv": argv, "files": [["go", name], RUN]}
        yield Case("odd folders", "command", f"{argv[0]}: in {name[:40]!r}", data, ["name", name[:20]], may_pass=True)


TASKS = ("Stripe-Ant-v0", "Stripe-Humanoid-v0", "Stripe-Velocity-Flat-Quadruped-v0")


def other_tasks(rng: random.Random, count: int) -> Iterator[Case]:
    """Runs, checkpoints and exported policies in tasks of other robots; resumed trainings with other settings."""
    bare = ["remove", "run/params"]
    for _ in range(count):
        task = rng.choice(TASKS)
        rest = ["--device", "cpu", "--num-envs", "2"]
        train = [*rest, "--final-video", "False", "--max-iterations", "4"]
        model, onnx = "run/checkpoints/model_1.pt", "run/exported/policy.onnx"
        argv, files = rng.choice(
            (
                (["eval", task, "--checkpoint", "run", *rest], [RUN]),
                (["eval", task, "--checkpoint", model, *rest], [RUN, bare]),
                (["play", task, "--checkpoint", onnx, "--viewer", "none", "--steps", "2", *rest], [RUN]),
                (["train", task, "--resume", "run", *train], [RUN]),
                (["train", task, "--resume", model, "--allow-changes", *train], [RUN, bare]),
                (["train", task, "--teacher", "run", *train], [RUN]),
                (["export", model, "--task", task, "--device", "cpu"], [RUN, bare]),
                ([*RESUME, "--num-envs", rng.choice(("1", "3", "1000"))], [RUN]),
                ([*RESUME, "--agent.num-steps-per-env", "16"], [RUN]),
                (["train", TASK, "--resume", onnx, "--device", "cpu"], [RUN]),
            )
        )
        names = ["run", TASK, "checkpoint", "policy", "teacher", "num-envs", "num_steps", "environments"]
        yield Case("other tasks", "command", " ".join(argv), {"argv": argv, "files": files}, names)
