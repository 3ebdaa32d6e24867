# SPDX-License-Identifier: Apache-2.0
"""Command line: list, help, inspect and errors."""

from __future__ import annotations

import importlib.metadata
import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

from stripe_newton.cli import main
from tests.helpers.checkout import PYTHONPATH
from tests.helpers.command_line import error_of, train
from tests.helpers.fake_env import TASK

CONFIG_IS_NONE = (
    b"import gymnasium\ngymnasium.register('Own-v0', vector_entry_point=print, "
    b"kwargs={'env_cfg_entry_point': lambda: None})\n"
)

CONFIG_IS_GONE = CONFIG_IS_NONE.replace(b"lambda: None", b"'json:Cfg'")


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


def test_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"stripe-newton {importlib.metadata.version('stripe-newton')}\n"


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
        (["train", TASK, "--env.sim.device", "cuda:77"], "--device cuda:77: there is no such device"),
        (["bench", TASK, "--env.sim.device=cuda:77"], "--device cuda:77: there is no such device"),
        (["bench", TASK, "--device=gpu"], "--device 'gpu': is not a device; 'cpu', 'cuda' or 'cuda:N'"),
        (["train", TASK, "--log-dir", "l\udcefgs"], r"'l\udcefgs': has bytes that are not utf-8; rename the file"),
        (
            ["train", TASK, "--seed", "1", "--agent.seed=2"],
            "--seed 1 is short for --agent.seed, which is 2; give one of them",
        ),
        (
            ["bench", TASK, "--env.scene.num_envs", "3", "--num-envs", "2"],
            "--num-envs 2 is short for --env.scene.num-env",
        ),
        (["train", TASK, "--viewer", "viser", "--port", "99999"], "--port 99999: must be from 1 to 65535"),
        (["play", TASK, "--agent", "zero", "--viewer", "viser", "--host", ""], "--host: the value is empty"),
        (["train", TASK, "--resume", "nowhere"], "nowhere: does not exist"),
        (["train", TASK, "--final-video", ""], "--final-video: the value is empty; give one, or leave the option out"),
        (["eval", TASK, "--checkpoint="], "--checkpoint: the value is empty"),
        (["train", TASK, "--runner", "x" * 5000], "--runner xxxxxxxxxxxxxxxxxxxx...: has 5000 characters, 4096 at"),
        (["train", TASK, "--resume", "."], "contains no checkpoint"),
        (["train", TASK, "--video-interval", "-1"], "must be at least 0"),
        (["train", TASK, "--agent.obs-groups.actor", "camera"], "the environment has policy, critic"),
        (["eval", TASK], "--checkpoint"),
        (["eval", TASK, "--checkpoint", __file__], "was not written by torch.save"),
        (["play", TASK], "either --checkpoint RUN_OR_FILE or --agent"),
        (["play", TASK, "--agent", "zero", "--steps", "0"], "must be at least 1"),
        (["play", TASK, "--agent", "zero", "--steps", str(10**20)], "must be at least 1 and at most 2147483647"),
        (["train", TASK, "--video-interval", str(10**20)], "must be at least 0 and at most 2147483647"),
        (["--import", "no_such_module", "list"], "there is no module 'no_such_module'"),
        (["--import", "none.py", "list"], "none.py does not exist"),
    ],
)
def test_errors_are_one_message(capsys, args, message):
    assert message in error_of(capsys, *args)
    assert not Path("logs").exists() or not list(Path("logs").glob("*/*"))


@pytest.mark.parametrize(
    ("size", "said"), [("abc", "WORLD_SIZE is 'abc', must be a whole number"), ("2", "RANK, LOCAL")]
)
def test_variables_of_ranks_that_are_wrong(capsys, monkeypatch, size, said):
    monkeypatch.setenv("WORLD_SIZE", size)
    assert said in error_of(capsys, "bench", TASK)


def test_closed_streams_are_opened_before_any_file():
    code = (
        "import sys; from stripe_newton.cli import _open_closed_streams; assert sys.stdout is None; "
        "_open_closed_streams(); print('lost'); assert open('/dev/null').fileno() > 2"
    )
    words = ["sh", "-c", 'exec "$@" >&- <&-', "sh", sys.executable, "-c", code]
    subprocess.run(words, check=True, env=os.environ | {"PYTHONPATH": PYTHONPATH})


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
    assert f"./{said}" in error_of(capsys, "list", "--import", "./outer_folder/").replace("mean ./", "mean ")
    assert "is no Python file" in error_of(capsys, "list", "--import", "/dev/null")
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


def test_an_attribute_that_the_module_of_a_config_misses_is_named_with_its_line(capsys, monkeypatch):
    """As in a file of Isaac Lab whose imports were changed; it was taken for a config that the module does not have."""
    monkeypatch.syspath_prepend(".")
    Path("their_module.py").write_text("import math\n\nclass Cfg:\n    part = math.no_such_part\n")
    gymnasium.register("Part-v0", vector_entry_point="a:b", kwargs={"env_cfg_entry_point": "their_module:Cfg"})
    try:
        message = error_of(capsys, "bench", "Part-v0", "--device", "cpu")
    finally:
        gymnasium.registry.pop("Part-v0")
    assert "their_module.py:4: AttributeError: module 'math' has no attribute 'no_such_part'" in message


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
    Path("arm.xml").write_text("<mujoco/>")
    assert error_of(capsys, "inspect", "arm.xlm") == "error: arm.xlm: does not exist; did you mean arm.xml?\n"
    assert error_of(capsys, "inspect", "arms.xml").endswith("arms.xml: does not exist; did you mean arm.xml?\n")
    assert "none.usda: does not exist" in error_of(capsys, "inspect", "none.usda")
    assert "nor is there a file of that name" in error_of(capsys, "inspect", "None-v0")
    for name, problem in (("/dev/zero", "is a device"), (".", "is a folder"), ("x" * 300, "File name too long")):
        assert f"{problem}; give a task, or a file of USD, URDF or MJCF" in error_of(capsys, "inspect", name)
