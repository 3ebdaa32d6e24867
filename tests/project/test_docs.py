# SPDX-License-Identifier: Apache-2.0
"""Documentation: its Python blocks run, its imports, links and command lines are right."""

from __future__ import annotations

import dataclasses
import importlib
import os
import pydoc
import re
import shlex
import sys
import types
from pathlib import Path

import gymnasium
import pytest
import tyro

from stripe_newton.cli import COMMANDS, main
from stripe_newton.cli.arguments import parse
from stripe_newton.cli.early_checks import with_flag_values
from stripe_newton.cli.foreign_options import with_own_options
from stripe_newton.cli.tasks import import_extra, load_cfg, task_ids
from tests.helpers.checkout import ROOT
from tools.documentation import first_hour
from tools.pictures import architecture_figure

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
TASK = "Stripe-Cartpole-Direct-v0"

BLOCK = re.compile(r"^```python\n(.*?)^```", re.S | re.M)
FENCE = re.compile(r"^```.*?^```", re.S | re.M)
CODE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
INLINE_CODE = re.compile(r"`[^`\n]*`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ (.*)$", re.M)
FILE_NAME = re.compile(r"# (\w+\.py)\n")


def page_id(path: Path) -> str:
    return str(path.relative_to(ROOT))


def snippets(text: str) -> list[str]:
    """Code in a page that is no Python block: between backticks, or indented by four blanks."""
    text = FENCE.sub("", text)
    return [*CODE.findall(text), *(line.strip() for line in re.findall(r"^ {4}\S.*$", text, re.M))]


WITH_BLOCKS = [page for page in PAGES if BLOCK.search(page.read_text(encoding="utf-8"))]
ELSEWHERE = ("learners.md", "tutorial.md")  # run by tests/helpers/learner_examples.py, once, and as a whole below
WITH_BLOCKS = [page for page in WITH_BLOCKS if page.name not in ELSEWHERE]
IMPORTS = sorted(
    {
        code.removesuffix(", ...")
        for page in PAGES
        for code in snippets(page.read_text(encoding="utf-8"))
        if re.match(r"(from|import) stripe_", code)
    }
)
COMMAND_LINES = sorted(
    {
        code.split("    ")[0].split("  #")[0].strip()
        for page in PAGES
        for code in snippets(page.read_text(encoding="utf-8"))
        if code.startswith("stripe-newton ") and "COMMAND" not in code
    }
)


@pytest.fixture
def same_tasks():
    """Forget the tasks that a test registers."""
    task_ids()
    before = dict(gymnasium.registry)
    yield
    gymnasium.registry.clear()
    gymnasium.registry.update(before)


@pytest.mark.parametrize("page", WITH_BLOCKS, ids=page_id)
def test_python_blocks_run(page, tmp_path, monkeypatch, same_tasks):
    """Blocks run one after the other; one that begins with a file's name is written to that file instead."""
    monkeypatch.syspath_prepend(tmp_path)
    own = []
    module = types.ModuleType("docs_page")
    monkeypatch.setitem(sys.modules, module.__name__, module)  # dataclasses look their module up
    for number, block in enumerate(BLOCK.findall(page.read_text(encoding="utf-8"))):
        if file := FILE_NAME.match(block):
            (tmp_path / file[1]).write_text(block, encoding="utf-8")
            own.append(Path(file[1]).stem)
            continue
        file_name = tmp_path / f"block_{number + 1}_of_{page.stem}.py"  # Warp looks at the source of its functions
        file_name.write_text(block, encoding="utf-8")
        exec(compile(block, str(file_name), "exec"), vars(module))
    for name in own:
        assert sys.modules.pop(name).__file__ == str(tmp_path / f"{name}.py")


SMALL = {
    "stripe-newton train": " --num-envs 4 --max-iterations 1 --final-video False --agent.num-steps-per-env 4",
    "stripe-newton play": " --num-envs 2 --steps 4",
    "stripe-newton eval": " --num-envs 2 --env.episode-length-s 0.2",
}
"""Options that make a command of the tutorial short, by its beginning."""


def test_the_tutorial_makes_what_it_says(monkeypatch, same_tasks):
    """Its files are written and changed, and its test of the term passes; the slow test below runs its commands."""
    folder = Path.cwd()
    for step in first_hour.read_steps(ROOT / "docs" / "tutorial.md"):
        if step.text.startswith("stripe-newton new"):
            assert main(shlex.split(step.text)[1:]) == 0
        elif step.text.startswith("cd "):
            folder /= step.text[3:]
        elif step.kind not in ("heading", "command"):
            first_hour.apply_block(step, folder)
    monkeypatch.syspath_prepend(str(folder))
    own = ["-q", "-p", "no:cacheprovider", "-c", str(folder / "pyproject.toml"), str(folder / "tests/test_terms.py")]
    assert pytest.main(own) == pytest.ExitCode.OK


@pytest.mark.slow
def test_the_commands_of_the_tutorial_run():
    env = os.environ | {"PYTHONPATH": os.pathsep.join(str(ROOT / part) for part in (".", "kernels", "tasks"))}
    recorder = first_hour.Recorder(Path.cwd(), env)
    for step in first_hour.read_steps(ROOT / "docs" / "tutorial.md"):
        if step.kind == "command":
            recorder.run(step.text + next((text for name, text in SMALL.items() if step.text.startswith(name)), ""))
        elif step.kind != "heading":
            first_hour.apply_block(step, recorder.folder)
    assert (recorder.folder / "robot" / "policy.onnx").is_file()


@pytest.mark.parametrize("line", IMPORTS)
def test_imports_work(line):
    exec(line, {})


def test_the_names_of_the_designs_lead_to_what_is_here():
    """Each name in the second column can be imported; attributes of classes count fields without a default."""
    rows = re.findall(r"^\| [^|]+ \| ([^|]+) \|", (ROOT / "docs" / "names.md").read_text(encoding="utf-8"), re.M)
    names = [name for row in rows for name in CODE.findall(row)]
    assert len(names) > 50
    for name in names:
        found = pydoc.locate(name)
        owner, _, attribute = name.rpartition(".")
        fields = [vars(base).get("__annotations__", {}) for base in getattr(pydoc.locate(owner), "__mro__", ())]
        assert found is not None or any(attribute in names for names in fields), name
    assert not [row for row in rows if row != "name here" and not CODE.findall(row)]


def anchors(page: Path) -> set[str]:
    """Names of a page's headings, as GitHub makes them."""
    headings = HEADING.findall(FENCE.sub("", page.read_text(encoding="utf-8")))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_links_lead_somewhere(page):
    text = INLINE_CODE.sub("", FENCE.sub("", page.read_text(encoding="utf-8")))
    for target in LINK.findall(text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        assert file.exists(), f"{target}: no such file"
        assert not anchor or anchor in anchors(file), f"{target}: no such heading"


FILES_ELSEWHERE = ("stages.md", "first_hour.md")  # of Newton, and of the package that the tutorial makes


@pytest.mark.parametrize("page", [page for page in PAGES if page.name not in FILES_ELSEWHERE], ids=page_id)
def test_named_files_exist(page):
    for code in snippets(page.read_text(encoding="utf-8")):
        for name in re.findall(r"\b(?:tools|tests|docs|kernels|tasks|stripe_newton)/[\w/]+\.\w+", code):
            assert (ROOT / name).exists(), f"{name}: no such file"


def test_the_figure_of_the_architecture_is_drawn_from_the_files_that_exist():
    assert (ROOT / "docs" / "images" / "architecture.svg").read_text(encoding="utf-8") == architecture_figure.draw()


def test_pictures_are_small():
    files = list((ROOT / "docs" / "images").iterdir())
    assert files
    assert not [file.name for file in files if file.stat().st_size > 400_000]


def test_the_readme_names_each_task():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert not [name for name in task_ids() if name.startswith("Stripe-") and f"`{name}`" not in text]


def options_type(command: str) -> type:
    """The dataclass that a command parses its arguments into."""
    module = importlib.import_module(COMMANDS[command][0])
    own = module.__name__, "stripe_newton.cli.options"
    return next(v for k, v in vars(module).items() if k.endswith("Args") and v.__module__ in own)


@pytest.mark.parametrize("line", COMMAND_LINES)
def test_command_lines_parse(line):
    """The command is known, and so are its options; the names of tasks and files are only examples."""
    _, command, *argv = shlex.split(line)
    assert command in COMMANDS
    options = options_type(command)
    if not argv:
        return  # the command is only named
    if "--isaaclab" in argv:  # it would switch the dialect on for the tests that follow
        argv.remove("--isaaclab")
    if "--import" in argv:
        start = argv.index("--import")
        del argv[start : start + 2]
    assert import_extra(argv) == argv
    if "--help" in argv:
        return
    if command == "scene":
        from stripe_newton.cli.scene import ACTIONS

        if argv[1:]:  # else the action is only named
            tyro.cli(ACTIONS[argv[0]], args=argv[1:])
        return
    if command in ("list", "new", "demo", "inspect", "compare", "report", "export", "replay-motion"):
        tyro.cli(options, args=argv)
        return
    argv = with_own_options(command, argv)
    argv[0] = argv[0] if argv[0] in task_ids() else TASK
    configs = {"env": load_cfg(argv[0], "env")} | ({"agent": load_cfg(argv[0], "agent")} if command == "train" else {})
    parse(options, with_flag_values(command, argv), command, **configs)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_command_line_page_names_each_option(command):
    text = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", text.split(f"## {command}\n")[1], flags=re.M)[0]
    named = set(re.findall(r"--([a-z][a-z-]*)\b(?!\.)", section)) - {"resume"}
    fields = list(dataclasses.fields(options_type(command)))
    if command == "scene":
        from stripe_newton.cli.scene import ACTIONS

        fields += [field for kind in ACTIONS.values() for field in dataclasses.fields(kind)]
    known = {field.name.replace("_", "-") for field in fields} - {"resume"}
    positional = {"task", "target", "spec", "runs", "name", "files"}
    assert named <= known
    assert known - positional <= named
