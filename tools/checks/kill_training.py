# SPDX-License-Identifier: Apache-2.0
"""Kill test: end a training by signals at random moments, resume it each time, and report lost iterations.

    python tools/checks/kill_training.py OUT [--task TASK] [--moments 24] [--signals KILL TERM HUP] [--seed 0]
                                             [--num-envs 4] [--save-interval 5] [--every SECONDS]

The training runs through the command line. Most moments are while it trains, some while a checkpoint is being written,
some anywhere from the start of the process on. After each, the newest checkpoint must be whole, and no more iterations
may be lost than there are between two checkpoints: none, where SIGTERM or SIGHUP ended a training that had begun. At
the end the run is resumed to a planned end. Its metrics must have each iteration once, and its last checkpoint must be
the same bits as that of a training that nobody ended. OUT gets both runs, ``record.json`` and ``record.md``.

With ``--every``, a process trains for about that time, half as long to one and a half times, rather than for a few
iterations: 24 moments of 150 s are a day of hourly kills, 24 times as fast.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from determinism import differences

from stripe_newton.rl import RunFolder, load_checkpoint, read_metrics
from stripe_newton.rl.runs.run_folder import find_newest

TASK = "Stripe-Cartpole-Direct-v0"
SAVE_INTERVAL = 5
KINDS = ("training", "training", "saving", "anywhere", "training", "saving")
MOST_ITERATIONS = 4 * SAVE_INTERVAL
"""Most iterations that a process may do before it is killed."""
TIMEOUT_S = 300.0
"""Time after which a training that does not begin is an error [s]."""


@dataclasses.dataclass
class Moment:
    """One kill, and the state of the run folder after it."""

    kind: str
    signal: str
    """Name of the signal, such as ``SIGKILL``."""
    seconds: float
    """Time since the start of the process [s]."""
    first: int
    """First iteration of the process, whether it came to it or not."""
    done: int
    """Iterations with rows in ``metrics.csv``."""
    saved: int
    """Iterations in the newest checkpoint; 0 without one."""
    half_written: bool
    """Whether there was an unfinished checkpoint."""
    trained: bool
    """Whether the process had begun to train when the signal came."""
    reward: float = float("nan")
    """Mean return of an episode in the last row of ``metrics.csv``; NaN before the first episode ended."""

    @property
    def lost(self) -> int:
        """Iterations that were done but are not in the newest checkpoint."""
        return max(0, self.done - self.saved)


class Training:
    """Training that is killed and resumed."""

    def __init__(
        self,
        out: Path,
        task: str = TASK,
        options: tuple[str, ...] = (),
        seed: int = 0,
        num_envs: int = 4,
        save_interval: int = SAVE_INTERVAL,
        every_s: float | None = None,
    ):
        self.out, self.task, self.options = out, task, options
        self.num_envs, self.save_interval, self.every_s = num_envs, save_interval, every_s
        self.random = random.Random(seed)
        self.out.mkdir(parents=True, exist_ok=True)

    def folder(self) -> RunFolder | None:
        """The run folder; None before there is one."""
        found = sorted((self.out / "logs").glob("*/*"))
        return RunFolder(found[-1]) if found else None

    def start(self, iterations: int) -> subprocess.Popen:
        """Start the training, or resume it if there is something to resume."""
        folder = self.folder()
        goes_on = folder is not None and folder.params.is_dir() and any(folder.params.glob("agent.yaml"))
        begin = ["--log-dir", str(self.out / "logs"), "--num-envs", str(self.num_envs)]
        words = ["--resume", str(folder.path)] if goes_on else begin
        words += ["--max-iterations", str(iterations), "--agent.save-interval", str(self.save_interval)]
        command = [sys.executable, "-m", "stripe_newton.cli", *self.options, "train", self.task, "--device", "cpu"]
        self.output = self.out / "output.txt"
        with open(self.output, "w") as file:
            return subprocess.Popen([*command, *words, "--final-video", "False"], stdout=file, stderr=file)

    def is_training(self) -> bool:
        """Whether the training has begun."""
        return "run folder:" in self.output.read_text()

    def is_saving(self) -> bool:
        """Whether there is a checkpoint that is not yet whole."""
        folder = self.folder()
        return folder is not None and any(folder.checkpoints.glob("*.part"))

    def wait(self, process: subprocess.Popen, until: Callable[[], bool], pause_s: float) -> None:
        """Wait for a condition while the process runs."""
        deadline = time.monotonic() + TIMEOUT_S
        while not until():
            if process.poll() is not None or time.monotonic() > deadline:
                process.kill()
                raise RuntimeError(f"the training ended by itself, or did not begin:\n{self.output.read_text()}")
            time.sleep(pause_s)

    def kill(self, kind: str, usual_seconds: float, ending: signal.Signals = signal.SIGKILL) -> Moment:
        """Start or resume the training and end it by a signal."""
        begin = time.perf_counter()
        first = self.look()[1]
        process = self.start(10**6)
        if kind == "anywhere":
            time.sleep(self.random.uniform(0.0, usual_seconds))
        else:
            self.wait(process, self.is_training, 0.02)
            self.let_train(process, first)
        if kind == "saving":
            self.wait(process, self.is_saving, 0.0)
        trained = self.is_training()
        process.send_signal(ending)
        process.wait(TIMEOUT_S)
        seconds = time.perf_counter() - begin
        done, saved = self.look()
        moment = Moment(kind, ending.name, seconds, first, done, saved, self.is_saving(), trained, self.reward())
        assert moment.saved >= first, f"{moment}: a checkpoint was lost"
        assert moment.lost <= self.save_interval, f"{moment}: more was lost than there is between two checkpoints"
        if ending != signal.SIGKILL:
            output = self.output.read_text()
            assert "Traceback" not in output, output
            assert not moment.half_written, f"{moment}: a half-written checkpoint was left"
            assert not trained or moment.lost == 0, f"{moment}: iterations were lost"
        return moment

    def let_train(self, process: subprocess.Popen, first: int) -> None:
        """Wait for a random number of iterations after the ``first``, or for a random time."""
        if self.every_s is None:
            count = first + self.random.randrange(MOST_ITERATIONS)
            self.wait(process, lambda: self.rows() >= count, 0.005)
            time.sleep(self.random.uniform(0.0, 0.1))
            return
        end = time.monotonic() + self.every_s * self.random.uniform(0.5, 1.5)
        self.wait(process, lambda: time.monotonic() > end, 0.1)

    def look(self) -> tuple[int, int]:
        """Iterations with a row in ``metrics.csv``, and in the newest checkpoint, which must be whole."""
        folder = self.folder()
        if folder is None:
            return 0, 0
        newest = find_newest(folder)
        assert newest == (folder.list_checkpoints()[-1][1] if newest else None), "the newest checkpoint is damaged"
        saved = int(load_checkpoint(newest)["iter"]) + 1 if newest else 0
        return self.rows(), saved

    def rows(self) -> int:
        """Iterations with a row in ``metrics.csv``."""
        rows = self.metrics().get("iteration", [])
        return int(rows[-1]) + 1 if rows else 0

    def reward(self) -> float:
        """Mean return of an episode in the last row of ``metrics.csv``; NaN without one."""
        return self.metrics().get("Train/mean_reward", [float("nan")])[-1]

    def metrics(self) -> dict[str, list[float]]:
        """Columns of ``metrics.csv``; empty without it."""
        folder = self.folder()
        return read_metrics(folder.metrics) if folder and folder.metrics.exists() else {}

    def finish(self) -> int:
        """Resume the run and let it end; return its number of iterations."""
        target = self.look()[1] + 2 * self.save_interval + 1
        process = self.start(target)
        assert process.wait(TIMEOUT_S) == 0, self.output.read_text()
        folder = self.folder()
        assert folder is not None
        assert read_metrics(folder.metrics)["iteration"] == [float(n) for n in range(target)]
        assert self.look() == (target, target)
        assert not list(folder.path.rglob("*.part"))
        return target

    def differences_from_unbroken(self, iterations: int) -> list[str]:
        """Parts of the last checkpoint that are other bits than those of a training that nobody ended."""
        settings = self.num_envs, self.save_interval
        unbroken = Training(self.out / "unbroken", self.task, self.options, 0, *settings)
        process = unbroken.start(iterations)
        assert process.wait() == 0, unbroken.output.read_text()
        contents = []
        for training in (self, unbroken):
            folder = training.folder()
            assert folder is not None
            newest = find_newest(folder)
            assert newest is not None
            contents.append(load_checkpoint(newest))
        return list(differences(*contents))


def kill_and_resume(
    training: Training, kinds: list[str], endings: Sequence[signal.Signals] = (signal.SIGKILL,)
) -> list[Moment]:
    """End a training at a moment of each of ``kinds``, by signals in turn, resuming it each time, and let it end."""
    moments: list[Moment] = []
    usual = 15.0
    for number, kind in enumerate(kinds):
        moments.append(training.kill(kind, usual, endings[number % len(endings)]))
        print(json.dumps(dataclasses.asdict(moments[-1])), flush=True)
        usual = moments[-1].seconds if kind == "training" else usual
    target = training.finish()
    different = training.differences_from_unbroken(target)
    assert not different, f"not as in a training that nobody ended: {', '.join(different[:5])}"
    return moments


def table(moments: list[Moment]) -> str:
    """The record in Markdown."""
    names = ("", "while", "signal", "after", "iterations before", "done", "in the newest checkpoint", "lost",
             "half-written file", "return")  # fmt: skip
    lines = [f"| {' | '.join(names)} |".replace("|  |", "| |"), "|---" * (len(names) - 1) + "|---:|"]
    for number, m in enumerate(moments, 1):
        part = "yes" if m.half_written else ""
        cells = (m.kind, m.signal, f"{m.seconds:.2f} s", m.first, m.done, m.saved, m.lost, part, f"{m.reward:.4g}")
        lines.append(f"| {number} | {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """End and resume a training, and print the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--task", default=TASK)
    parser.add_argument("--moments", type=int, default=24)
    parser.add_argument("--signals", nargs="+", default=["KILL", "TERM", "HUP"], help="used in turn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--num-envs", type=int, default=4)
    parser.add_argument("--save-interval", type=int, default=SAVE_INTERVAL, help="iterations between two checkpoints")
    parser.add_argument("--every", type=float, help="time that a process trains, about [s]")
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a nohup before this command is not for the training
    settings = args.num_envs, args.save_interval, args.every
    training = Training(args.out, args.task, (), args.seed, *settings)
    kinds = [KINDS[number % len(KINDS)] for number in range(args.moments)]
    training.random.shuffle(kinds)  # or each kind would always meet the same signals
    moments = kill_and_resume(training, kinds, [signal.Signals[f"SIG{name}"] for name in args.signals])
    (args.out / "record.json").write_text(json.dumps([dataclasses.asdict(m) for m in moments], indent=1))
    (args.out / "record.md").write_text(table(moments))
    print(table(moments))


if __name__ == "__main__":
    main()
