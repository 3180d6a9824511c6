"""Parameters and forward passes of the networks (thesis Table 4.1), on one core of this machine.

The thesis timed them on the graphics card of a laptop, with whatever ran there; here ONNX Runtime
runs the files that drive, one sample at a time. Weights are random: they do not change the time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rig.core.errors import RigError
from rig.experiments.reproduce import Job

TABLE_4_1: Mapping[str, tuple[int, float]] = MappingProxyType(
    {
        "resnet18": (12_726_337, 11.8),
        "single": (1_746_609, 1.5),
        "dual-large": (6_150_322, 2.2),
        "dual-small": (1_546_498, 1.3),
    }
)
"""The thesis' parameters and milliseconds, on an NVIDIA GeForce GTX 1050 Ti."""

NETS = (*TABLE_4_1, "map-small", "map-large")
RUNS, QUICK_RUNS = 300, 20


def measure(job: Job) -> dict[str, Any]:
    """Return parameters and times of every network; raises RigError where torch is missing."""
    try:
        from rig.models.forward import forward
    except ModuleNotFoundError as error:
        if error.name not in ("torch", "onnx"):
            raise
        raise RigError(f"table-4.1 needs {error.name}: pip install 'exposure-rig[train]'") from None
    runs = QUICK_RUNS if job.quick else RUNS
    load = os.getloadavg()[0]
    nets = {}
    for done, net in enumerate(NETS):
        job.advance(done, len(NETS))
        nets[net] = asdict(forward(net, runs))
    job.advance(len(NETS), len(NETS))
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "load": load,
        "runs": runs,
        "nets": nets,
    }


def processor() -> str:
    """Return what the system calls this machine's processor, or that it does not tell."""
    try:
        told = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        told = ""
    names = [line.partition(":")[2].strip() for line in told.splitlines() if "model name" in line]
    return names[0] if names else "unknown processor"


def words(values: dict[str, Any]) -> str:
    """Return the table, the thesis' column beside this machine's."""
    lines = [
        "| network | parameters | thesis' | thesis, GPU ms | float32 ms, median / p99 "
        "| 8-bit ms, median / p99 |",
        "|---|---|---|---|---|---|",
    ]
    for net, told in values["nets"].items():
        parameters, gpu_ms = TABLE_4_1.get(net, (None, None))
        lines.append(
            f"| {net} | {told['parameters']:,} | {f'{parameters:,}' if parameters else '-'} "
            f"| {gpu_ms or '-'} | {_shown(told['full'])} | {_shown(told['int8'])} |"
        )
    lines += [
        "",
        f"ONNX Runtime, one thread, one sample at a time, {values['runs']} runs after warm-up, "
        f"random weights. {values['processor']}, {values['cores']} cores, load average "
        f"{values['load']:.1f} at the beginning: more than the cores makes all times longer. "
        "The thesis' times are those of an NVIDIA GeForce GTX 1050 Ti.",
    ]
    return "\n".join(lines)


def _shown(times: Mapping[str, float] | None) -> str:
    return "-" if times is None else f"{times['median_ms']:.2f} / {times['p99_ms']:.2f}"
