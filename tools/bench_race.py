"""Time a race and its evaluation, cold (light baked, code compiled) and warm.

    .venv/bin/python tools/bench_race.py [--pairs 100] [--size 640x480] [--rivals aeag shin]

Each figure is the wall time of the whole command in a process of its own.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--rivals", nargs=2, default=["ours", "shin"])
    parser.add_argument("--warm-runs", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        caches = {"RIG_CACHE_DIR": f"{folder}/light", "NUMBA_CACHE_DIR": f"{folder}/jit"}
        for turn in range(1 + arguments.warm_runs):
            seconds = race(arguments, Path(folder) / f"run-{turn}", caches)
            print(f"{'cold' if turn == 0 else 'warm'}: {seconds:.1f} s")


def race(arguments: argparse.Namespace, out: Path, caches: dict[str, str]) -> float:
    """Return the wall time of one race, in seconds."""
    command = [sys.executable, "-c", "from rig.cli.main import main; main()", "race"]
    command += [*arguments.rivals, "--frames", str(arguments.pairs), "--out", str(out), "-q"]
    command += ["--cameras", f"sim:tunnel?size={arguments.size}"]
    start_s = time.perf_counter()
    subprocess.run(command, check=True, env=os.environ | caches, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start_s


if __name__ == "__main__":
    main()
