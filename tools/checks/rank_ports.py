# SPDX-License-Identifier: Apache-2.0
"""Rank ports: trains with several processes, and lists the sockets on which they listen.

    python tools/checks/rank_ports.py [--gpus 2] [--device cuda] [--task Stripe-Cartpole-Direct-v0]

The command fails if one of them can be reached from another host.
"""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = ["descendants", "listening_sockets"]

_LISTEN = "0A"


def listening_sockets(process: int) -> list[tuple[str, int]]:
    """Addresses and ports on which a process listens."""
    inodes = set()
    for link in Path(f"/proc/{process}/fd").glob("*"):
        with contextlib.suppress(OSError):
            target = os.readlink(link)
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    found = []
    for name in ("tcp", "tcp6"):
        for line in Path(f"/proc/{process}/net/{name}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == _LISTEN and words[9] in inodes:
                address, port = words[1].split(":")
                found.append((_address(address), int(port, 16)))
    return found


def _address(text: str) -> str:
    """An address as the kernel writes it: words of four bytes in the order of the machine."""
    words = bytes.fromhex(text)
    content = b"".join(words[i : i + 4][::-1] for i in range(0, len(words), 4))
    return str(ipaddress.ip_address(content))


def descendants(process: int) -> Iterator[int]:
    """A process and those that it has started."""
    yield process
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        for child in task.read_text().split():
            yield from descendants(int(child))


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gpus", type=int, default=2, help="number of processes")
    parser.add_argument("--device", default="cuda", choices=("cuda", "cpu"))
    parser.add_argument("--task", default="Stripe-Cartpole-Direct-v0")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        words = ["--gpus", str(args.gpus), "--device", args.device, "--num-envs", str(8 * args.gpus)]
        words += ["--max-iterations", "1000000", "--log-dir", folder, "--final-video", "False"]
        words += ["--agent.save-interval", "1"]
        command = [sys.executable, "-m", "stripe_newton.cli", "train", args.task, *words]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as launcher:
            try:
                while not list(Path(folder).rglob("model_1.pt")):
                    if launcher.poll() is not None:
                        return launcher.returncode
                    time.sleep(0.2)
                sockets = [(pid, *place) for pid in descendants(launcher.pid) for place in listening_sockets(pid)]
            finally:
                launcher.send_signal(signal.SIGINT)
    print("| process | address | port |\n|---|---|---|")
    for pid, address, port in sockets:
        print(f"| {'launcher' if pid == launcher.pid else 'rank'} {pid} | {address} | {port} |")
    return int(any(not ipaddress.ip_address(address).is_loopback for _, address, _ in sockets))


if __name__ == "__main__":
    sys.exit(main())
