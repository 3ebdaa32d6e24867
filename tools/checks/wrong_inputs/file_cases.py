# SPDX-License-Identifier: Apache-2.0
"""Wrong files: checkpoints, configs and logs of runs, exported policies, recorded episodes, diverged policies."""

from __future__ import annotations

import random
from collections.abc import Iterator

from case import Case
from command_cases import EVAL, EXPORT, PLAY, RUN, TASK

__all__ = ["file_cases"]

RESUME = ["train", TASK, "--resume", "run", "--max-iterations", "4", "--final-video", "False", "--device", "cpu"]
ONNX = "run/exported/policy.onnx"
BY_ONNX = (
    ["eval", TASK, "--checkpoint", ONNX, "--episodes", "2", "--num-envs", "2", "--device", "cpu"],
    ["play", TASK, "--checkpoint", ONNX, "--viewer", "none", "--steps", "3", "--device", "cpu"],
)
READERS = (EVAL, PLAY, EXPORT, RESUME)
DAMAGE = ("cut", "flip", "zero", "insert", "random", "double")


def file_cases(rng: random.Random, count: int) -> list[Case]:
    """About so many cases."""
    share = count // 100
    cases = list(checkpoints(rng, 4 * share))
    cases += run_files(rng, 3 * share)
    cases += exported(rng, 3 * share)
    cases += episodes(rng, 2 * share)
    return cases + list(diverged(rng, share))


VALUES = (
    "float('nan')", "float('inf')", "-5", "'text'", "None", "[]", "{}", "10**30", "True", "torch.zeros(3)", "DELETE",
    "torch.full((2, 2), float('nan'))", "[1, 2]", "{'a': 1}", "2.5", "torch.zeros(0)", "(None,) * 5", "-10**30", "''",
    "torch.zeros(3, dtype=torch.complex64)", "{'x': torch.zeros(1)}", "b'abc'",
)  # fmt: skip
PLACES: tuple[tuple[object, ...], ...] = (
    ("iter",),
    ("actor_state_dict",),
    ("critic_state_dict",),
    ("optimizer_state_dict",),
    ("optimizer_state_dict", "param_groups"),
    ("optimizer_state_dict", "state"),
    ("actor_state_dict", "mlp.0.weight"),
    ("actor_state_dict", "distribution.std_param"),
    ("infos",),
    ("stripe_newton",),
    ("stripe_newton", "env"),
    ("stripe_newton", "env", "env"),
    ("stripe_newton", "env", "env", "arrays"),
    ("stripe_newton", "env", "env", "arrays", "joint_q"),
    ("stripe_newton", "env", "env", "buffers"),
    ("stripe_newton", "env", "env", "parts"),
    ("stripe_newton", "env", "env", "step"),
    ("stripe_newton", "env", "obs"),
    ("stripe_newton", "logger"),
    ("stripe_newton", "logger", "rewbuffer"),
    ("stripe_newton", "logger", "tot_timesteps"),
    ("stripe_newton", "logger", "cur_reward_sum"),
    ("stripe_newton", "learning_rate"),
    ("stripe_newton", "rng"),
    ("stripe_newton", "rng", "python"),
    ("stripe_newton", "rng", "numpy"),
    ("stripe_newton", "rng", "torch"),
    ("stripe_newton", "hidden"),
    ("stripe_newton", "rnd"),
    ("stripe_newton", "ranks"),
)
OBJECTS = ("1", "'x'", "{}", "[1]", "torch.zeros(3)", "{'actor_state_dict': {}}", "{'actor_state_dict': 3, 'iter': 0}",
           "{'model_state_dict': {}}", "Path('/')", "{1: 2, 'actor_state_dict': {}}", "None",
           "np.zeros(3)")  # fmt: skip
USED_BY_ALL = ("iter", "actor_state_dict")
"""Parts that a policy which only acts needs; the others matter for a resumed training alone."""


WRONG_CHECKPOINTS = ("set", "set", "set", "pack", "damage", "zip", "special", "object")
"""Kinds of them; wrong values in right files are the most."""
PACKED_PARTS = ("zlib", "dtype", "shape", "on_device")
"""Parts of a compressed tensor."""
SPECIAL = ("fifo", "folder", "socket", "loop", "zero", "null", "tty", "gone")
ZIPS = {"encrypted": False, "deflated": True, "bzip2": True, "lzma": True, "dots": True, "twice": True, "empty": True,
        "method": False, "big": False}  # fmt: skip
"""Kinds of zip files, and whether a checkpoint of that kind may be read."""


def checkpoints(rng: random.Random, count: int) -> Iterator[Case]:
    """Checkpoints with other contents, damaged, packed, or no files at all."""
    for _ in range(count):
        argv, kind = rng.choice(READERS), rng.choice(WRONG_CHECKPOINTS)
        # A checkpoint that cannot be read may be passed over for an earlier one, with a warning.
        step: list[object] = ["checkpoint_replace", "run", rng.choice(OBJECTS)]
        may = False
        if kind == "set":
            argv = rng.choice((RESUME, RESUME, argv))
            path, value = rng.choice(PLACES), rng.choice(VALUES)
            step = ["checkpoint_set", "run", list(path), value]
            may = _may_be(path, value, argv == RESUME)
        elif kind == "pack":
            part, value = rng.choice(PACKED_PARTS), rng.choice(VALUES)
            step = ["checkpoint_pack", "run", part, value]
            # A dict that lacks a part is not a compressed tensor, and a policy that acts does not read it.
            may = argv != RESUME and (value == "DELETE" or (part, value) == ("on_device", "True"))
        elif kind == "damage":
            step = ["damage", "run", rng.choice(DAMAGE), rng.randrange(10**6)]
            may = step[2] in ("flip", "zero", "double")
        elif kind == "zip":
            packing = rng.choice(list(ZIPS))
            step = ["big_zip", "run"] if packing == "big" else ["zip", "run", packing]
            may = ZIPS[packing]
        elif kind == "special":
            step = ["special", "run", rng.choice((*SPECIAL, "full"))]
            may = True
        data = {"argv": argv, "files": [RUN, step]}
        what = f"{argv[0]}: {' '.join(map(str, step))}"
        yield Case("checkpoints", "command", what, data, ["model_", "checkpoint"], may)


def _may_be(path: tuple[object, ...], value: str, resumed: bool) -> bool:
    """Whether a value may be in this place of a checkpoint: it is free or not used there, or the type fits."""
    last = path[-1]
    if path in (("infos",), ("stripe_newton", "rnd"), ("stripe_newton", "hidden"), ("stripe_newton", "ranks")):
        return True
    if not resumed and path[0] not in USED_BY_ALL:
        return True
    if last in ("buffers", "parts", "critic_state_dict", "rewbuffer") and value in ("{}", "[]"):
        return True
    if last in ("arrays", "env", "rewbuffer", "step") and value in ("None", "[1, 2]", "[]"):
        return True
    if last == "tot_timesteps":
        return "nan" not in value
    return last in ("step", "learning_rate") and value in ("True", "2.5")


BOMBS = ("aliases", "cycle", "merge", "deep", "deep map", "long", "many", "python", "binary", "list", "text", "empty",
         "number", "null keys")  # fmt: skip


RUN_FILES = ("params/env.yaml", "params/agent.yaml", "params/run.yaml", "metrics.csv", "sweep.yaml", "scene")


REFERRING = {
    "part.xml": ("xml", '<mujoco><include file="part.xml"/><worldbody><geom size="1"/></worldbody></mujoco>'),
    "part.stl": (
        "xml",
        '<mujoco><asset><mesh file="part.stl"/></asset><worldbody><geom type="mesh" mesh="part"/></worldbody></mujoco>',
    ),
    "part.png": (
        "xml",
        '<mujoco><asset><texture name="part" type="2d" file="part.png"/></asset><worldbody><geom size="1"/></worldbody>'
        "</mujoco>",
    ),
    "part.obj": (
        "urdf",
        '<robot name="r"><link name="a"><collision><geometry><mesh filename="part.obj"/></geometry></collision></link>'
        "</robot>",
    ),
    "part.usda": ("usda", '#usda 1.0\ndef Cube "a" (\n    references = @./part.usda@\n)\n{\n}\n'),
}
"""Scenes that refer to another file, by the name of that."""


def run_files(rng: random.Random, count: int) -> Iterator[Case]:
    """The other files of a run folder, files of sweeps, and scenes: YAML bombs, FIFOs, devices, damage."""
    for _ in range(count):
        file = rng.choice(RUN_FILES)
        step: list[object] = ["bomb", f"run/{file}", rng.choice(BOMBS)]
        if file == "metrics.csv":
            step = _metrics_step(rng)
        elif rng.random() < 0.4 or file == "scene":
            step = ["special", f"run/{file}", rng.choice(SPECIAL)]
        argv = rng.choice(READERS)
        if file == "metrics.csv":
            argv = rng.choice((RESUME, ["compare", "run"]))
        elif rng.random() < 0.2:
            argv = ["compare", "run"]
        files, names = [RUN, step], [file.rpartition("/")[2], "run"]
        if file == "sweep.yaml":
            argv = ["train", TASK, "--sweep", "run/sweep.yaml", "--device", "cpu"]
            files = [RUN, ["write", "run/sweep.yaml", "agent.algorithm.gamma: [0.9]\n"], step]
        if file == "scene":
            scene = f"run/scene.{rng.choice(('usd', 'usda', 'usdc', 'urdf', 'xml', 'usdz'))}"
            files = [["mkdir", "run"], ["write", scene, "x"], ["special", scene, step[2]]]
            argv = ["inspect", scene]
            if rng.random() < 0.4:
                part = rng.choice(list(REFERRING))
                kind, content = REFERRING[part]
                scene, step = f"run/scene.{kind}", ["special", f"run/{part}", step[2]]
                files = [["mkdir", "run"], ["write", scene, content], ["write", f"run/{part}", "x"], step]
                argv, names = ["inspect", scene], [part, *names]
            elif rng.random() < 0.3:
                files = [RUN, *files[1:]]
                argv = [*EVAL[:2], "--checkpoint", ONNX, "--env.scene.scenery", scene, "--device", "cpu"]
        may = file in ("metrics.csv", "params/run.yaml") or step[0] == "bomb"
        may = may or (argv[0] == "compare" and step[2] == "gone")
        may = may or "/part." in str(step[1])  # a part that is missing may have a row of the report
        data = {"argv": argv, "files": files, "no_sweep": True, "forbidden": ["pwned"]}
        what = f"{argv[0]}: {' '.join(map(str, step))[:80]}"
        yield Case("files of runs and scenes", "command", what, data, names, may)


def _metrics_step(rng: random.Random) -> list[object]:
    kind = rng.choice(("damage", "special", "text"))
    if kind == "damage":
        return ["damage", "run/metrics.csv", rng.choice(DAMAGE), rng.randrange(10**6)]
    if kind == "special":
        return ["special", "run/metrics.csv", rng.choice(SPECIAL)]
    return ["text", "run/metrics.csv", *rng.choice((("iteration", "x"), ("0,", "nan,"), ("1", "-"), ("\n", ",")))]


KEYS = ("format_version", "task", "run", "iteration", "versions", "rates", "solver", "assets", "actions",
        "observations", "sensors", "commands", "network", "check")  # fmt: skip
JSON_VALUES = ("None", "3", "-1", "'text'", "[]", "{}", "[1]", "{'a': 1}", "True", "1e300", "float('nan')", "DELETE",
               "RAW:{", "'RAW:{'", "'RAW:' + '[' * 100000", "'x' * 10**6", "[None]", "[{}]", "{'size': 'x'}",
               "{'inputs': 3}", "{'inputs': [{}], 'states': []}", "{'size': 1, 'clip': 'x', 'terms': None}",
               "{**old, 'inputs': [{'name': 'x', 'groups': ['policy'], 'shape': []}]} if isinstance(old, dict) else 1",
               "{**old, 'states': [{'input': 'x', 'output': 'y', 'shape': [9**9]}]} if isinstance(old, dict) else 1",
               "[{'name': 3, 'shape': 'x', 'terms': 5}]", "99")  # fmt: skip
NEEDED = ("format_version", "assets", "actions", "observations", "network")


def exported(rng: random.Random, count: int) -> Iterator[Case]:
    """Exported policies that are damaged, or whose metadata are of other types."""
    for _ in range(count):
        argv, kind = rng.choice(BY_ONNX), rng.choice(("metadata", "metadata", "damage", "special", "text"))
        may, names = False, ["policy.onnx"]
        if kind == "metadata":
            key, value = rng.choice(KEYS), rng.choice(JSON_VALUES)
            value = "'RAW:{'" if value == "RAW:{" else value
            step: list[object] = ["onnx_metadata", ONNX, key, value]
            # Keys that are not known are left to later versions.
            may = (
                (value.startswith("{**old") and key != "network")
                or key not in NEEDED
                or (key in ("assets", "sensors", "commands") and value == "{}")
            )
        elif kind == "damage":
            step = ["damage", ONNX, rng.choice(DAMAGE), rng.randrange(10**6)]
            may = step[2] != "random"
        elif kind == "special":
            step = ["special", ONNX, rng.choice(("fifo", "folder", "loop", "zero", "null", "gone"))]
        else:
            step = ["write", ONNX, rng.choice(("", "x", "{}", "\0" * 100))]
        data = {"argv": argv, "files": [RUN, step]}
        yield Case("exported policies", "command", f"{argv[0]}: {' '.join(map(str, step))[:80]}", data, names, may)


MAKE = (
    "import h5py, numpy as np\n"
    "from stripe_newton.managers.episode_file import EpisodeFile\n"
    "file = EpisodeFile.create('e.hdf5', {'env_name': 'x'})\n"
    "file.write({'actions': np.zeros((3, 2)), 'states': {'robot': {'root_pose': np.zeros((3, 7))}}}, 3, seed=1)\n"
    "file.close()\n"
)
EPISODES = (
    "f['data'].attrs['env_args'] = {value}",
    "f['data'].attrs['total'] = {value}",
    "f['data'].attrs['quat_convention'] = {value}",
    "f.attrs['format_version'] = {value}",
    "f['data/demo_0'].attrs['num_samples'] = {value}",
    "del f['data/demo_0/actions']; f['data/demo_0/actions'] = {value}",
    "del f['data/demo_0']; f['data/demo_0'] = {value}",
    "del f['data']; f['data'] = {value}",
    "f['data/x'] = {value}",
    "f['data/demo_0/states/robot/other'] = {value}; f['data/demo_0/states/robot'].move('other', 'another')",
    "del f['data'].attrs['env_args']",
    "del f['data'].attrs['total']",
    "f['data/demo_1'] = h5py.SoftLink('/nowhere')",
    "f['data/demo_1'] = h5py.ExternalLink('/etc/passwd', '/x')",
    "f['data/demo_0/loop'] = h5py.SoftLink('/data/demo_0')",
)
H5_VALUES = ("3", "'text'", "b'x'", "float('nan')", "-5", "np.zeros((2, 2))", "'{{'", "'[1]'", "h5py.Empty('f')",
             "np.array(['a', 'b'], dtype=h5py.string_dtype())", "np.zeros(0)", "'{{\"env_name\": 3}}'")  # fmt: skip
DAMAGED_EPISODES = (
    "open('e.hdf5', 'r+b').truncate(500)",
    "open('e.hdf5', 'wb').close()",
    "import os; os.remove('e.hdf5'); os.mkfifo('e.hdf5')",
    "import os; os.remove('e.hdf5'); os.mkdir('e.hdf5')",
    "b = bytearray(open('e.hdf5', 'rb').read()); b[200:400] = bytes(200); open('e.hdf5', 'wb').write(b)",
)
READ = (
    "with EpisodeFile.open('e.hdf5') as file:\n"
    "    file.total, len(file)\n"
    "    for name in file.names: file.read(name), file.attributes(name)\n"
)
APPEND = "EpisodeFile.create('e.hdf5', {'env_name': 'x'}, mode='append').close()\n"


def episodes(rng: random.Random, count: int) -> Iterator[Case]:
    """Files of recorded episodes with other contents."""
    for _ in range(count):
        change, value = rng.choice(EPISODES), rng.choice(H5_VALUES).replace("{{", "{").replace("}}", "}")
        prepare = MAKE + f"with h5py.File('e.hdf5', 'r+') as f:\n    {change.replace('{value}', value)}\n"
        if rng.random() < 0.25:
            damage = rng.choice(DAMAGED_EPISODES)
            prepare, change = MAKE + damage + "\n", damage
        data = {"env": "", "prepare": prepare, "code": rng.choice((READ, READ, APPEND))}
        yield Case("recorded episodes", "call", f"{change[:60]} {value}", data, ["e.hdf5"], may_pass=True)


def diverged(rng: random.Random, count: int) -> Iterator[Case]:
    """Policies with weights that are not finite."""
    for _ in range(count):
        value = rng.choice(("nan", "inf"))
        number = f"float('{value}')"
        if rng.random() < 0.3:
            argv, step = rng.choice(BY_ONNX), ["onnx_weights", ONNX, float(value)]
        else:
            argv, step = rng.choice(READERS), ["nan_weights", "run", "actor_state_dict", float(value)]
        data = {"argv": argv, "files": [RUN, step]}
        yield Case("diverged policies", "command", f"{argv[0]}: {step[0]} {number}", data, ["not finite", "diverged"])
