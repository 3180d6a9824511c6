"""Ctrl-C: the files are finalised and the exit code says so."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rig.record.verify import verify


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_finalises_the_recording(number: signal.Signals, tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-c", "from rig.cli.main import main; main()"]
    command += ["collect", "--frames", "100000", "--cameras", "sim:tunnel?size=320x240"]
    command += ["--out", str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        wait_for_bytes(out / "run.mcap", process)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "finishing the recording" in errors
    found = verify(out)
    assert found.sound and found.pairs > 0 and not found.lost


def wait_for_bytes(file: Path, process: subprocess.Popen[str]) -> None:
    """Wait until at least one pair has been written."""
    deadline_s = time.monotonic() + 120
    while not (file.exists() and file.stat().st_size > 500_000):
        assert process.poll() is None and time.monotonic() < deadline_s
        time.sleep(0.05)
