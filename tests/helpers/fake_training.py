# SPDX-License-Identifier: Apache-2.0
"""Program with the options and files of ``stripe-newton train`` that learns nothing, for the tests of sweeps.

Its return is ``1 - gamma`` times the iteration, plus a tenth of the seed. It fails if ``lam`` is 0, and takes
``--agent.algorithm.max-grad-norm`` milliseconds an iteration.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
import zipfile
from pathlib import Path


def main(words: list[str]) -> int:
    task, pairs = words[0], words[1:]
    options = dict(zip(pairs[::2], pairs[1::2]))
    if options.get("--agent.algorithm.lam") == "0.0":
        print("RuntimeError: nothing to learn", flush=True)
        return 1
    stop: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: stop.append(number))
    end = int(os.environ["STRIPE_NEWTON_SWEEP_PIPE"])
    threading.Thread(target=lambda: stop.append(len(os.read(end, 1))), daemon=True).start()
    if "--resume" in options:
        run = Path(options["--resume"])
    else:
        run = Path(options["--log-dir"], "fake", f"{time.time_ns()}")
        (run / "checkpoints").mkdir(parents=True)
        (run / "metrics.csv").write_text("iteration,total_steps,elapsed_s,Train/mean_reward,late\n")
    rows = (run / "metrics.csv").read_text().splitlines()
    first = int(rows[-1].split(",")[0]) + 1 if len(rows) > 1 else 0
    with open(run / "calls.jsonl", "a") as calls:
        here = {"task": task, "options": options, "first": first, "t": time.time()}
        calls.write(json.dumps({**here, "gpu": os.environ.get("CUDA_VISIBLE_DEVICES")}) + "\n")
    total = int(options["--max-iterations"])
    slope = 1.0 - float(options.get("--agent.algorithm.gamma", 0.0))
    for iteration in range(first, total):
        time.sleep(float(options.get("--agent.algorithm.max-grad-norm", 0.0)) / 1000.0)
        reward = slope * iteration + 0.1 * int(options["--seed"])
        with open(run / "metrics.csv", "a") as file:
            file.write(f"{iteration},{100 * (iteration + 1)},{iteration + 1},{reward},\n")
        with zipfile.ZipFile(run / "checkpoints" / f"model_{iteration}.pt", "w") as checkpoint:
            checkpoint.writestr("data", "")
        if stop:
            break
    print("done", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
