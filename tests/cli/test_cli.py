# SPDX-License-Identifier: Apache-2.0
"""Command line: its commands, options and errors."""

from __future__ import annotations

import copy
import dataclasses
import errno
import json
import os
import pickle
import signal
import subprocess
import sys
import time
import types
from pathlib import Path
from typing import Literal

import gymnasium
import pytest
import torch
import tyro
import yaml

from stripe_newton.assets import RobotNotFoundError
from stripe_newton.cli import main, tasks
from stripe_newton.cli.field_options import apply_options, apply_saved, options_of
from stripe_newton.cli.shell_command import command, program
from stripe_newton.cli.tasks import load_cfg, task_ids
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.rl import CheckpointError, DivergedError, RslRlVecEnvWrapper, find_checkpoint, read_metrics
from tests.helpers.checkout import HELPERS, PYTHONPATH
from tests.helpers.fake_env import TASK


@pytest.fixture
def no_video(monkeypatch):
    """Leave the videos out, where a test is about something else."""
    from stripe_newton.cli import train

    monkeypatch.setattr(train, "record_video", lambda *args, **kwargs: None)
    monkeypatch.setattr(train, "export_policy", lambda *args: None)


def train(*args: str) -> Path:
    """Train in-process and return the run folder."""
    assert main(["train", TASK, "--device", "cpu", *args]) == 0
    return max(Path("logs/fake_cart").iterdir(), key=lambda path: path.stat().st_mtime_ns)


def error_of(capsys, *args: str) -> str:
    """The message of a command that shall end with code 2."""
    capsys.readouterr()
    assert main(list(args)) == 2
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return captured.err + captured.out


CONFIG_IS_NONE = (
    b"import gymnasium\ngymnasium.register('Own-v0', vector_entry_point=print, "
    b"kwargs={'env_cfg_entry_point': lambda: None})\n"
)
CONFIG_IS_GONE = CONFIG_IS_NONE.replace(b"lambda: None", b"'json:Cfg'")


# -- options for config fields


@configclass
class Inner:
    gain: float = 1.0
    """How much."""
    kind: Literal["a", "b"] = "a"
    stiffness: float | dict[str, float] | None = None


@configclass
class Outer:
    flag: bool = True
    count: int | None = None
    name: str = "x"
    size: tuple[int, ...] = (3, 4)
    point: tuple[float, float, float] = (0.0, 0.0, 1.0)
    files: list[str] = []
    space: int | object = 4
    needed: int = MISSING
    unannotated = 0.5
    func: object = len
    inner: Inner = Inner()
    parts: dict[str, Inner] = {"legs": Inner(gain=2.0), "arm.*": Inner()}


def parsed(cfg: Outer, line: str = "") -> Outer:
    options = tyro.cli(type(options_of(cfg, "cfg")), args=line.split(), config=(tyro.conf.FlagConversionOff,))
    apply_options(cfg, options)
    return cfg


def test_any_field_by_an_option():
    cfg = parsed(
        Outer(),
        "--flag False --count 3 --name y --size 1 2 5 --point 1 2 3 --files a b --space 9 --needed 8 "
        "--unannotated 2 --inner.gain 7 --inner.kind b --inner.stiffness 4.5 --parts.legs.gain 9",
    )
    assert (cfg.flag, cfg.count, cfg.name, cfg.size, cfg.point) == (False, 3, "y", (1, 2, 5), (1.0, 2.0, 3.0))
    assert (cfg.files, cfg.space, cfg.needed, cfg.unannotated) == (["a", "b"], 9, 8, 2.0)
    assert (cfg.inner.gain, cfg.inner.kind, cfg.inner.stiffness) == (7.0, "b", 4.5)
    assert cfg.parts["legs"].gain == 9.0
    assert cfg.func is len


def test_no_option_changes_nothing():
    cfg, untouched = Outer(), Outer()
    parsed(cfg)
    assert cfg.needed is MISSING
    assert cfg.to_dict() == untouched.to_dict()


def test_options_have_defaults_of_the_instance_and_help():
    cfg = Outer(size=(8,), name="mine")
    options = options_of(cfg, "cfg")
    assert (options.size, options.name) == ((8,), "mine")
    assert {field.name for field in dataclasses.fields(options)} >= {"flag", "count", "inner", "parts"}
    assert not hasattr(options, "func")


def test_saved_config_comes_back():
    changed = Outer(size=(9, 9), needed=3)
    changed.inner.stiffness = 3.5
    changed.parts["legs"].gain = 0.25
    changed.parts["arm.*"].gain = 4.0
    saved = yaml.safe_load(yaml.safe_dump(changed.to_dict()))
    fresh = Outer()
    assert apply_saved(fresh, saved, "env") == []
    assert fresh.to_dict() == changed.to_dict()
    assert fresh.size == (9, 9)
    assert isinstance(fresh.parts["legs"], Inner)
    saved["gone"], saved["func"] = 1, "builtins:max"
    assert apply_saved(fresh, saved, "env") == [
        "env.func: was 'builtins:max', is 'builtins:len'",
        "env.gone: was 1, the field is no longer there",
    ]


# -- list, help, errors


def test_list(capsys):
    assert main(["list"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith(f"{TASK} ")]
    assert line.split(maxsplit=1)[1] == "Cart on a spring, without physics"
    assert main(["list", "--json"]) == 0
    (entry,) = [task for task in json.loads(capsys.readouterr().out) if task["id"] == TASK]
    assert entry["rsl_rl_cfg"] == "tests.helpers.fake_env:FakeCartRunnerCfg"


def test_list_and_help_import_no_torch():
    code = (
        "import sys; from stripe_newton.cli import main; assert main(['--help']) == 0; assert main(['list']) == 0; "
        "assert not {'torch', 'warp', 'newton', 'matplotlib'} & set(sys.modules), 'heavy import'"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": PYTHONPATH})


def test_help_shows_fields_of_the_task(capsys):
    assert main(["train", TASK, "--help"]) == 0
    text = capsys.readouterr().out
    for option in ("--num-envs", "--resume", "--env.scene.num-envs", "--agent.algorithm.learning-rate"):
        assert option in text
    assert "Discount factor of one step." in text
    assert main(["train", "--help"]) == 0
    assert "--env" not in capsys.readouterr().out.replace("--env.scene.num-envs", "").replace("--env.seed", "").replace(
        "--env.sim.device", ""
    )


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["trian"], "did you mean 'train'?"),
        (["train"], "train needs a task"),
        (["train", "Fake-Crat-v0"], "did you mean Fake-Cart-v0"),
        (["train", "Quux"], "'stripe-newton list' shows all"),
        (["train", TASK, "--env.scene.num-env", "3"], "--env.scene.num-envs"),
        (["train", TASK, "--env.scene.num-envs", "abc"], "invalid literal for int()"),
        (["train", TASK, "--device", "cuda:77"], "there is no such device"),
        (["train", TASK, "--resume", "nowhere"], "nowhere: does not exist"),
        (["train", TASK, "--resume", "."], "contains no checkpoint"),
        (["train", TASK, "--video-interval", "-1"], "must be 0 or more"),
        (["train", TASK, "--agent.obs-groups.actor", "camera"], "the environment has policy, critic"),
        (["eval", TASK], "--checkpoint"),
        (["eval", TASK, "--checkpoint", __file__], "was not written by torch.save"),
        (["play", TASK], "either --checkpoint RUN_OR_FILE or --agent"),
        (["play", TASK, "--agent", "zero", "--steps", "0"], "must be at least 1"),
        (["--import", "no_such_module", "list"], "there is no module 'no_such_module'"),
        (["--import", "none.py", "list"], "none.py does not exist"),
    ],
)
def test_errors_are_one_message(capsys, args, message):
    assert message in error_of(capsys, *args)
    assert not Path("logs").exists() or not list(Path("logs").glob("*/*"))


@pytest.mark.usefixtures("no_video")
def test_a_run_of_another_task(capsys):
    run = train("--num-envs", "4", "--max-iterations", "1")
    text = error_of(capsys, "eval", "Stripe-Cartpole-Direct-v0", "--checkpoint", str(run))
    assert f"is a run of {TASK}, not of Stripe-Cartpole-Direct-v0" in text


def test_all_problems_of_both_configs_at_once(capsys):
    text = error_of(capsys, "train", TASK, "--env.limit", "-1", "--agent.algorithm.gamma", "2")
    assert "env.limit: is -1.0" in text
    assert "agent.algorithm.gamma: is 2.0" in text


def test_a_bug_keeps_its_traceback(monkeypatch):
    from stripe_newton.cli import list_tasks

    monkeypatch.setattr(list_tasks, "task_ids", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["list"])


def test_tasks_of_one_own_by_file_and_module(capsys, tmp_path):
    text = "import gymnasium\nif 'My-v0' not in gymnasium.registry:\n"
    text += "    gymnasium.register('My-v0', vector_entry_point='a:b', kwargs={'env_cfg_entry_point': 'a:c'})\n"
    (tmp_path / "my_task_file.py").write_text(text)
    assert main(["list", "--import", "my_task_file.py"]) == 0
    assert "My-v0" in capsys.readouterr().out.split()
    assert main(["--import=my_task_file", "list"]) == 0


def test_a_package_is_imported_by_the_path_of_its_folder(capsys):
    package = Path("outer_folder") / "outer_folder"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("from .inner import NUMBER\nprint('imported', NUMBER)\n")
    (package / "inner.py").write_text("NUMBER = 17\n")
    said = "outer_folder is a folder without __init__.py, so it has no tasks; did you mean outer_folder/outer_folder?"
    assert said in error_of(capsys, "list", "--import", "outer_folder")
    sys.modules.pop("outer_folder")
    assert main(["list", "--import", "outer_folder/outer_folder"]) == 0
    assert "imported 17" in capsys.readouterr().out
    assert main(["list", "--import", "outer_folder/outer_folder/__init__.py"]) == 0


def test_a_config_whose_module_is_missing_is_one_line(capsys):
    kwargs = {"env_cfg_entry_point": "gone_package.cfg:Cfg"}
    gymnasium.register("Gone-v0", vector_entry_point="gone_package.env:Env", kwargs=kwargs)
    try:
        text = error_of(capsys, "bench", "Gone-v0")
    finally:
        gymnasium.registry.pop("Gone-v0")
    assert "task 'Gone-v0' is registered with 'gone_package.cfg:Cfg': there is no module 'gone_package'" in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "import no_such_dependency",
            "mine.py cannot be imported: mine.py:1: ModuleNotFoundError: No module named 'no_s",
        ),
        ("x = 1\ndef f(:", "mine.py cannot be imported: mine.py:2: SyntaxError: "),
        (
            "x = 1\n\ny = x.z",
            "mine.py cannot be imported: mine.py:3: AttributeError: 'int' object has no attribute 'z'",
        ),
    ],
)
def test_an_error_in_a_users_file_is_a_line_with_its_place(capsys, monkeypatch, text, message):
    Path("mine.py").write_text(f"{text}\n")
    (line,) = error_of(capsys, "--import", "mine.py", "list").splitlines()
    assert message in line
    assert line.endswith("(STRIPE_NEWTON_TRACEBACK=1 shows the traceback)")
    monkeypatch.setenv("STRIPE_NEWTON_TRACEBACK", "1")
    with pytest.raises((ModuleNotFoundError, SyntaxError, AttributeError)):
        main(["--import", "mine.py", "list"])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"import sys; sys.exit(3)\n", r"ends the program while it is imported (sys.exit(3))"),
        (b"class Odd(BaseException): pass\nraise Odd('odd')\n", "cannot be imported: Odd: odd"),
        (b"x = 1\0\n", "cannot be imported"),
        (b"\xef\xbb\xbf\xff'\n", "cannot be imported"),
        (CONFIG_IS_NONE, "task 'Own-v0' is registered with a config that is None, must be one of @configclass"),
        (CONFIG_IS_GONE, "task 'Own-v0' is registered with 'json:Cfg', which the module does not have"),
    ],
)
def test_a_module_that_cannot_be_imported_is_one_line(capsys, content, message):
    Path("broken_module.py").write_bytes(content)
    sys.modules.pop("broken_module", None)
    try:
        found = error_of(capsys, "bench", "Own-v0", "--import", "broken_module.py", "--device", "cpu")
    finally:
        gymnasium.registry.pop("Own-v0", None)
    assert "broken_module" in found or "Own-v0" in found
    assert message in found
    assert len(found.splitlines()) == 1


def test_an_error_in_a_users_config_is_a_line_too(capsys):
    Path("their_config.py").write_text(
        "from stripe_newton.registration import register_task\n"
        "from tests.helpers.fake_env import FakeCartCfg\n\n"
        "class Forgotten(FakeCartCfg):\n    pass\n\n"
        "def wrong():\n    return 1 / 0\n\n"
        "for name in ('Forgotten', 'wrong'):\n"
        "    register_task(f'Test-{name}-v0', env='a:b', env_cfg=f'their_config:{name}')\n"
    )
    try:
        message = error_of(capsys, "play", "Test-Forgotten-v0", "--agent", "zero", "--import", "their_config.py")
        assert "class 'Forgotten' of their_config, a subclass of FakeCartCfg, has no @configclass" in message
        message = error_of(capsys, "play", "Test-wrong-v0", "--agent", "zero", "--import", "their_config.py")
        assert "the env config of Test-wrong-v0: their_config.py:8: ZeroDivisionError: division by zero" in message
    finally:
        for name in ("Forgotten", "wrong"):
            gymnasium.registry.pop(f"Test-{name}-v0", None)


def test_help_and_errors_load_nothing_heavy():
    lines = [f"{command} --help" for command in ("train", "eval", "export", "play", "bench", "inspect", "new")]
    lines += ["train", "train Stripe-None-v0", "train Stripe-Cartpole-v0 --num-envz 2"]
    lines += ["play Stripe-Cartpole-v0", "play Stripe-Cartpole-v0 --checkpoint none", "eval Stripe-Cartpole-v0"]
    code = (
        "import sys; from stripe_newton.cli import main\n"
        f"for line in {lines}:\n"
        "    assert main(line.split()) == 2 * ('--help' not in line), line\n"
        "    assert not {'torch', 'warp', 'newton', 'rsl_rl', 'matplotlib'} & set(sys.modules), line"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": PYTHONPATH})


# -- train, eval, play


def test_train_eval_play(capsys):
    pytest.importorskip("av")
    run = train("--num-envs", "8", "--seed", "5", "--agent.actor.hidden-dims", "8", "4", "--video-interval", "3")
    out = capsys.readouterr().out
    assert f"run folder: {run}" in out
    assert f"  {program()} play {TASK} --checkpoint {run}" in out
    names = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    assert names >= {
        *("params/env.yaml", "params/agent.yaml", "checkpoints/model_5.pt", "metrics.csv", "learning_curve.png"),
        *("params/system.yaml", "params/changes.yaml", "report.html"),
        *("videos/iteration_3.mp4", "videos/final_6.mp4", "exported/policy.pt", "exported/policy.onnx"),
    }
    agent = yaml.safe_load((run / "params/agent.yaml").read_text())
    env = yaml.safe_load((run / "params/env.yaml").read_text())
    assert (agent["seed"], env["seed"], env["scene"]["num_envs"]) == (5, 5, 8)
    assert agent["actor"]["hidden_dims"] == [8, 4]
    page = (run / "report.html").read_text()
    changes = yaml.safe_load((run / "params/changes.yaml").read_text())
    assert changes["agent.actor.hidden_dims"][1] == "[8, 4]"
    assert {"env.scene.num_envs", "agent.seed"} <= changes.keys()
    assert "final_6.mp4" in page
    assert "6 of 6 iterations" in page

    assert main(["eval", TASK, "--checkpoint", str(run), "--episodes", "5", "--json", "out/r.json"]) == 0
    result = json.loads(Path("out/r.json").read_text())
    assert list(result) == [
        "task",
        "episodes",
        "mean_return",
        "mean_length",
        "max_length",
        "terminated_rate",
        "success_rate",
        "metrics",
    ]
    assert (result["task"], result["episodes"], result["max_length"]) == (TASK, 5, 30)
    checkpoint = str(run / "checkpoints/model_5.pt")
    assert main(["eval", TASK, "--checkpoint", checkpoint, "--episodes", "5", "--json", "out/again.json"]) == 0
    assert json.loads(Path("out/again.json").read_text()) == result

    capsys.readouterr()
    assert main(["play", TASK, "--checkpoint", checkpoint, "--viewer", "video", "--steps", "3"]) == 0
    assert capsys.readouterr().out.strip().endswith("videos/play_model_5.mp4")
    assert main(["play", TASK, "--agent", "random", "--viewer", "none"]) == 0
    assert "30 steps of 16 environments" in capsys.readouterr().out


@pytest.mark.usefixtures("no_video")
def test_resume_takes_the_configuration_over(capsys):
    run = train("--num-envs", "8", "--max-iterations", "3", "--agent.algorithm.learning-rate", "0.002")
    assert "3 iterations are done, of 3" in error_of(capsys, "train", TASK, "--resume", str(run))
    assert main(["train", TASK, "--resume", str(run), "--max-iterations", "6"]) == 0
    assert read_metrics(run / "metrics.csv")["iteration"] == [0, 1, 2, 3, 4, 5]
    agent = yaml.safe_load((run / "params/agent.yaml").read_text())
    assert (agent["max_iterations"], agent["algorithm"]["learning_rate"]) == (6, 0.002)
    assert "env.scene.num_envs: was 8, is 4" in error_of(
        capsys, "train", TASK, "--resume", str(run), "--max-iterations", "9", "--num-envs", "4"
    )

    whole = train("--num-envs", "8", "--max-iterations", "6", "--agent.algorithm.learning-rate", "0.002")
    one, other = (torch.load(find_checkpoint(path))["actor_state_dict"] for path in (run, whole))
    assert all(torch.equal(value, other[name]) for name, value in one.items())


@pytest.mark.usefixtures("no_video")
def test_same_seed_same_policy():
    policies = []
    for seed in ("7", "7", "8"):
        run = train("--num-envs", "8", "--max-iterations", "2", "--seed", seed)
        policies.append(torch.load(find_checkpoint(run))["actor_state_dict"]["mlp.0.weight"])
    assert torch.equal(policies[0], policies[1])
    assert not torch.equal(policies[0], policies[2])


def test_live_view(monkeypatch, capsys):
    import stripe_newton.viewers

    seen = []

    class View:
        url = "http://localhost:1"

        def __init__(self, subject, **options):
            seen.append((subject.num_envs, options["title"], options["host"], options["port"]))
            options["reset"]()

        def steps(self, limit):
            yield from range(3)
            raise KeyboardInterrupt

        def close(self):
            seen.append("closed")

    monkeypatch.setattr(stripe_newton.viewers, "LiveViewer", View, raising=False)
    monkeypatch.setattr("stripe_newton.cli.live_view.check_installed", lambda: None)
    monkeypatch.setattr("stripe_newton.cli.play.check_installed", lambda: None)
    monkeypatch.setattr("tests.helpers.fake_env.FakeCartEnv.sim", types.SimpleNamespace(cfg=None), raising=False)
    steps = []
    monkeypatch.setattr(
        "stripe_newton.rl.RslRlVecEnvWrapper.step",
        lambda self, actions, step=RslRlVecEnvWrapper.step: (steps.append(1), step(self, actions))[1],
    )
    words = ["play", TASK, "--agent", "zero", "--viewer", "viser", "--num-envs", "2", "--host", "::1", "--port", "99"]
    assert main(words) == 0
    assert seen == [(2, TASK, "::1", 99), "closed"]
    assert len(steps) == 3
    assert "http://localhost:1" in capsys.readouterr().out


@pytest.mark.usefixtures("no_video")
def test_the_checkpoints_of_a_run_act_in_turn(monkeypatch):
    """`play --viewer viser` hands them to the viewer; the policy is the same object with other weights."""
    import stripe_newton.viewers

    run = train("--num-envs", "4", "--max-iterations", "4")
    files = dict(sorted((file.stem, file) for file in (run / "checkpoints").glob("model_*.pt")))
    *_, older, newest = files
    seen = []

    class View:
        url = "http://localhost:1"

        def __init__(self, subject, checkpoints, **options):
            self.checkpoints = checkpoints

        def steps(self, limit):
            for name in [None, older, newest]:
                if name is not None:
                    self.checkpoints.load(name)
                weights = self.checkpoints._runner.networks["actor"].state_dict()["mlp.0.weight"]
                seen.append((self.checkpoints.current, weights.clone(), self.checkpoints.names()))
                yield 0
            with pytest.raises(CheckpointError):
                self.checkpoints.load("model_99")
            assert self.checkpoints.current == newest

        def close(self):
            pass

    monkeypatch.setattr(stripe_newton.viewers, "LiveViewer", View, raising=False)
    monkeypatch.setattr("stripe_newton.cli.play.check_installed", lambda: None)
    monkeypatch.setattr("tests.helpers.fake_env.FakeCartEnv.sim", types.SimpleNamespace(cfg=None), raising=False)
    assert main(["play", TASK, "--checkpoint", str(run), "--viewer", "viser", "--num-envs", "2"]) == 0
    assert [name for name, _, _ in seen] == [newest, older, newest]
    for name, weights, names in seen:
        assert torch.equal(weights, torch.load(files[name])["actor_state_dict"]["mlp.0.weight"])
        assert names == list(files)
    assert not torch.equal(seen[0][1], seen[1][1])


def test_a_training_is_shown_only_while_somebody_looks(monkeypatch):
    import stripe_newton.viewers

    seen = []

    class View:
        url = "http://localhost:1"

        def __init__(self, subject, **options):
            assert options["reset"] is False
            assert not options["is_paced"]

        def has_clients(self):
            return 2 <= sum("iteration" in x for x in seen) < 4  # a browser comes after one iteration, and goes

        def set_status(self, lines):
            seen.append(lines)

        def after_step(self):
            seen.append("step")

        def serve(self):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            seen.append("closed")

    monkeypatch.setattr(stripe_newton.viewers, "LiveViewer", View, raising=False)
    monkeypatch.setattr("stripe_newton.cli.train.check_installed", lambda: None)
    monkeypatch.setattr("tests.helpers.fake_env.FakeCartEnv.sim", None, raising=False)
    train("--num-envs", "4", "--max-iterations", "5", "--viewer", "viser", "--final-video", "False")
    lines = [x["iteration"] for x in seen if isinstance(x, dict)]
    assert lines == [f"{i} of 5" for i in range(6)]
    begin, end = (
        next(i for i, x in enumerate(seen) if x != "step" and x.get("iteration") == f"{k} of 5") for k in (1, 3)
    )
    assert "step" in seen[begin:end]
    assert "step" not in seen[:begin] + seen[end:]
    assert seen[-1] == "closed"


def test_interrupted_command_leaves_a_run_that_goes_on():
    words = [sys.executable, "-m", "stripe_newton.cli", "--import", str(HELPERS / "fake_env.py"), "train", TASK]
    process = subprocess.Popen(
        [*words, "--device", "cpu", "--max-iterations", "100000"],
        env=os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 60.0
        while not list(Path("logs").glob("*/*/checkpoints/model_2.pt")) and time.monotonic() < deadline:
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 0, err
    assert "stopping after this iteration" in err
    (run,) = Path("logs/fake_cart").iterdir()
    assert f"run folder: {run}" in out
    assert f"--resume {run}" in out
    last = read_metrics(run / "metrics.csv")["iteration"][-1]
    assert find_checkpoint(run).name == f"model_{last:.0f}.pt"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_the_environment_is_built_leaves_no_run(monkeypatch, number):
    from stripe_newton.cli import end_signals, env_and_policy

    before = signal.getsignal(number)
    monkeypatch.setattr(env_and_policy, "make_env", lambda *_: os.kill(os.getpid(), number))
    try:
        end_signals.end_on_signals()
        assert main(["train", TASK, "--device", "cpu"]) == 128 + number
    finally:
        signal.signal(number, before)
    assert not list(Path("logs").glob("*/*"))


def test_errors_of_the_system_are_one_line(capsys, monkeypatch):
    from stripe_newton.cli import train as module

    def failing(error: Exception):
        def fail(*_, **__):
            raise error

        return fail

    for error, message in (
        (OSError(errno.ENOSPC, "No space left on device", "/full/x"), "'/full/x': No space left on device"),
        (MemoryError(), "out of memory: Python got none; use fewer environments"),
        (RuntimeError("Failed to allocate 9 bytes on device 'cpu'"), "out of memory: Failed to allocate 9 bytes"),
        (DivergedError("iteration 3: the loss value is nan"), "iteration 3: the loss value is nan"),
    ):
        monkeypatch.setattr(module, "load_configs", failing(error))
        found = error_of(capsys, "train", TASK)
        assert f"error: {message}" in found
        assert len(found.splitlines()) == 1
        if not isinstance(error, DivergedError):
            with monkeypatch.context() as patch:
                patch.setenv("STRIPE_NEWTON_TRACEBACK", "1")
                with pytest.raises(type(error)):
                    main(["train", TASK])


def test_places_are_tried_before_the_work(capsys, monkeypatch):
    from stripe_newton.cli import bench, env_and_policy

    def never(*_):
        raise AssertionError("the work had begun")

    monkeypatch.setattr(env_and_policy, "make_env", never)
    monkeypatch.setattr(bench, "measure", never)
    Path("file").touch()
    for words in (
        ("bench", TASK, "--json", "file/x.json"),
        ("inspect", TASK, "--out", "file/x"),
        ("compare", "file", "--out", "file/x"),
        ("train", TASK, "--log-dir", "file/x"),
    ):
        found = error_of(capsys, *words)
        assert "file/x" in found
        assert "Not a directory" in found
        assert len(found.splitlines()) == 1
    assert sorted(path.name for path in Path().iterdir()) == ["file"]


# -- inspect


def test_inspect_a_stage_and_a_task(capsys):
    get_asset = pytest.importorskip("newton.examples").get_asset
    stage = get_asset("cartpole_single_pendulum.usda")
    assert main(["inspect", stage, "--out", "pictures"]) == 0
    text = capsys.readouterr().out
    assert "cart_to_pole" in text
    assert "picture: pictures/cartpole_single_pendulum.png" in text
    assert Path("pictures/cartpole_single_pendulum.png").read_bytes()[:4] == b"\x89PNG"

    assert main(["inspect", "Stripe-Cartpole-Direct-v0", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["name"], content["decimation"], content["actions"]) == ("Stripe-Cartpole-Direct-v0", 2, 1)
    assert content["observations"] == {"policy": [4]}
    assert Path(content["picture"]).is_file()
    assert any("cart_to_pole" in joint["path"] for report in content["reports"] for joint in report["joints"])


def test_inspect_errors(capsys):
    assert "none.usda: there is no such file" in error_of(capsys, "inspect", "none.usda")
    assert "nor is there a file of that name" in error_of(capsys, "inspect", "None-v0")


def test_a_run_of_another_machine_finds_the_files_of_this_one(tmp_path):
    from stripe_newton.cli.field_options import apply_saved
    from stripe_newton.configclass import configclass

    here = tmp_path / "robot.usda"
    here.write_text("#usda 1.0")

    @configclass
    class Cfg:
        usd_path: str = str(here)
        other: str = str(here)

    cfg = Cfg()
    assert apply_saved(cfg, {"usd_path": "/elsewhere/robot.usda", "other": "/elsewhere/cart.usda"}, "env") == []
    assert cfg.usd_path == str(here)
    assert cfg.other == "/elsewhere/cart.usda"  # another file: the run's own, to be missed when it is opened


def test_the_commands_to_run_next_start_in_the_callers_shell(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "argv", [str(tmp_path / ".venv/bin/stripe-newton"), "train"])
    assert program() == ".venv/bin/stripe-newton"  # not on the PATH: where it lies, from here
    monkeypatch.setattr(sys, "argv", ["/somewhere/stripe_newton/cli/__main__.py"])
    assert program() == f"{sys.executable} -m stripe_newton.cli"
    script = tmp_path / "stripe-newton"
    script.write_text("#!/bin/sh\n")
    script.chmod(0o755)
    assert program() == "stripe-newton"
    monkeypatch.setattr(tasks, "_imported", ["my task.py"])
    assert command("play", "My-v0") == "stripe-newton play My-v0 --import 'my task.py'"


def test_configs_of_every_task_are_copied_and_pickled():
    """Sweeps and other processes need that; Warp functions and generated scenes are among the values."""
    for task in (name for name in task_ids() if name.startswith("Stripe-")):
        for kind in ("env", "agent"):
            try:
                cfg = load_cfg(task, kind)
            except RobotNotFoundError:  # its file is not on this machine
                continue
            names = cfg.to_dict() if "Forest" not in task else {}  # a specification has no name that would compare
            for other in (copy.deepcopy(cfg), pickle.loads(pickle.dumps(cfg))):
                assert type(other) is type(cfg)
                assert not names or other.to_dict() == names
