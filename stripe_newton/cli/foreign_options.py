# SPDX-License-Identifier: Apache-2.0
"""Foreign options: what scripts of Isaac Lab and mjlab take, as options of a command, or as errors that name those."""

from __future__ import annotations

import re
from collections.abc import Sequence

from .options import OPTIONS
from .user_error import UserError

__all__ = ["with_own_options"]

_WITHOUT_EFFECT = ("--headless", "--enable-cameras")
"""Flags that ask for what always holds: there is no window, and cameras need no renderer to be enabled."""
_WITH_TASK_OPTION = ("export",)
"""Commands that have an option ``--task`` of their own; of others the task is the first argument."""
_FILMS = "the trained policy is filmed at the end; --video-interval K films every K iterations"
_LENGTH = "a film of the training is an episode or 10 s long; play TASK --viewer video --steps N sets the length"
_INSTEAD = {
    "train": {
        "--video": _FILMS,
        "--video-length": _LENGTH,
        "--load-run": "--resume RUN_FOLDER_OR_CHECKPOINT continues a run",
        "--checkpoint": "--resume RUN_FOLDER_OR_CHECKPOINT continues a run",
        "--experiment-name": "--agent.experiment-name NAME sets the folder below --log-dir",
        "--run-name": "--agent.run-name NAME is appended to the name of the run folder",
        "--logger": "--agent.logger wandb writes to Weights & Biases beside TensorBoard",
        "--log-project-name": "--agent.log-project NAME sets the project of Weights & Biases",
        "--distributed": "--gpus N trains on N GPUs of this host",
        "--gpu-ids": "--gpus N trains on N GPUs of this host",
        "--livestream": "--viewer viser shows the training in a browser",
    },
    "play": {
        "--video": "--viewer video writes a video, --steps N sets its length",
        "--video-length": "--viewer video --steps N sets the length of the video",
        "--checkpoint-file": "--checkpoint RUN_OR_FILE takes a run folder, a checkpoint or an ONNX file",
        "--load-run": "--checkpoint RUN_OR_FILE takes a run folder, a checkpoint or an ONNX file",
        "--real-time": "--viewer viser plays in real time",
        "--livestream": "--viewer viser shows the policy in a browser",
    },
}
"""What to write for an option of those scripts, by command. Underscores in their names count as hyphens."""
_OVERRIDE = re.compile(r"(?P<name>(env|agent)(\.\w+)+)=(?P<value>.+)", re.DOTALL)
"""A field by Hydra's syntax, as scripts of Isaac Lab take them: ``env.sim.dt=0.01``."""


def with_own_options(command: str, argv: Sequence[str]) -> list[str]:
    """The arguments of a command, with those of Isaac Lab's scripts as ones of its own.

    ``--task`` names the task, flags that need not be given are left out, and ``env.sim.dt=0.01`` is an option.

    Raises:
        UserError: for an option that has another name here; the message says which.
    """
    if command not in OPTIONS:
        return list(argv)
    words: list[str] = []
    rest = list(argv)
    while rest:
        word = rest.pop(0)
        name, equals, value = word.partition("=")
        option = name.replace("_", "-")
        if option == "--task" and command not in _WITH_TASK_OPTION and (equals or rest):
            words.append(value if equals else rest.pop(0))
        elif override := _OVERRIDE.fullmatch(word):
            words += [f"--{override['name']}", *_values(override["value"])]
        elif instead := _INSTEAD.get(command, {}).get(option):
            raise UserError(f"{command} has no {name}: {instead}")
        elif option.startswith("--") and "." in option and not option.startswith(("--env.", "--agent.")):
            field = name.removeprefix("--")
            raise UserError(f"{command} has no {name}: a field of a config is --env.{field} or --agent.{field}")
        elif option not in _WITHOUT_EFFECT:
            words.append(word)
    return words


def _values(text: str) -> list[str]:
    """The words of a value by Hydra's syntax, in which a list is ``[64,64]``."""
    is_list = text.startswith("[") and text.endswith("]")
    return [part.strip() for part in text[1:-1].split(",")] if is_list else [text]
