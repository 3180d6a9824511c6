"""`rig calibrate-aperture` as it is called: the ring is turned, and its true place checked."""

from __future__ import annotations

import json
import math
import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from rig.cli import calibrate_aperture
from rig.cli.big import big
from rig.cli.main import run
from rig.config import load_calibration
from rig.drivers.registry import open_source

WALL = "sim:wall?size=320x240"
CELLS = (80, 24)


def called(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run(["calibrate-aperture", *map(str, arguments)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


@pytest.mark.parametrize("camera", ["", "&camera=mvbluefox3-2024a&size=968x608"])
def test_the_hand_finds_the_true_ring(
    camera: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Only this test looks at the ring; the command saw frames."""
    opened: list[Any] = []

    def open_and_keep(*words: Any, **names: Any) -> Any:
        opened.append(open_source(*words, **names))
        return opened[-1]

    monkeypatch.setattr(calibrate_aperture, "open_source", open_and_keep)
    out = tmp_path / "a"
    address = WALL if not camera else f"sim:wall?{camera[1:]}"
    code, text, _ = called(
        capsys, "--cameras", address, "--seed", 5, "--auto", "--out", out, "--json", "-q"
    )
    assert code == 0
    values = json.loads(text)
    assert {"file", "residual", "tolerance", "passed"} <= values.keys()
    assert values["passed"] and values["residual"] <= values["tolerance"] == 0.02
    true_stops = math.log2(opened[0].scene.ring.transmits())
    assert abs(true_stops) <= 0.02
    assert abs(values["ratio_stops"] - true_stops) <= 3 * values["uncertainty_stops"] + 2e-4
    assert len(values["linearity_exposures_us"]) == 3
    found = load_calibration(out / "calibration.toml")
    assert found.primary_serial == "SIM-PRIMARY"
    assert found.aperture is not None
    assert found.aperture.ratio_stops == values["ratio_stops"]
    assert found.aperture.uncertainty_stops == values["uncertainty_stops"]
    assert (out / "histograms.svg").read_text().count("<polyline") == 2


def test_a_person_at_a_terminal_turns_the_ring_with_keys(tmp_path: Path) -> None:
    """Reads the large words from the screen as a person would, and presses O and C."""
    mine, theirs = pty.openpty()
    command = [sys.executable, "-c", "from rig.cli.main import main; main()", "calibrate-aperture",
               "--cameras", f"{WALL}&aperture_offset_stops=0.25", "--hold-s", "0.5",
               "--out", str(tmp_path / "p"), "--json"]  # fmt: skip
    size = {"COLUMNS": str(CELLS[0]), "LINES": str(CELLS[1])}
    child = subprocess.Popen(
        command, stdin=theirs, stderr=theirs, stdout=subprocess.PIPE, env=os.environ | size
    )
    os.close(theirs)
    with child:
        try:
            seen = press_until_done(mine, child)
            child.wait(30)
        finally:
            child.kill()
        assert child.stdout is not None
        values = json.loads(child.stdout.read())
    assert child.returncode == 0
    assert values["passed"]
    assert abs(values["ratio_stops"]) <= 0.02
    assert seen[0] == "CLOSE" and "HOLD" in seen and "LOCKED" in seen


def press_until_done(terminal: int, child: subprocess.Popen[bytes]) -> list[str]:
    """Press a key when every third screen asks for it; return the words that were read.

    A key is acted on after the next pair, so whoever presses at once turns too far.
    """
    half = (CELLS[1] - 5) // 2
    words = {word: big(word, CELLS[0], half)[0] for word in ("OPEN", "CLOSE", "HOLD", "LOCKED")}
    seen: list[str] = []
    until_s = time.monotonic() + 120
    text = ""
    while child.poll() is None and time.monotonic() < until_s:
        if select.select([terminal], [], [], 0.1)[0]:
            try:
                text += os.read(terminal, 65_536).decode("utf-8", "replace")
            except OSError:
                break
        *whole, text = text.split("\033[J")
        for screen in whole:
            rows = screen.split("\r\n")
            found = [word for word, row in words.items() if any(row in each for each in rows)]
            if len(found) == 1:
                seen += found
                key = {"OPEN": b"O", "CLOSE": b"C"}.get(found[0])
                if key and len(seen) % 3 == 0:
                    os.write(terminal, key)
    os.close(terminal)
    return seen


def test_nobody_to_turn_the_ring_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, told = called(capsys, "--cameras", WALL)
    assert code == 2
    assert "nobody can turn the simulated ring: add --auto or --web" in told


def test_auto_needs_the_simulated_ring(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, told = called(capsys, "--cameras", "sim:chessboard?size=320x240", "--auto")
    assert code == 2
    assert "these cameras have none" in told


def test_too_few_frames_leave_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "short"
    code, _, told = called(capsys, "--cameras", WALL, "--auto", "--frames", 12, "--out", out, "-q")
    assert code == 1
    assert "not locked after 12 triggers" in told
    assert not out.exists()


def test_the_calibration_of_swapped_cameras_is_not_completed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    earlier = tmp_path / "calibration.toml"
    earlier.write_text(
        'schema = "rig.calibration/1"\ndate = 2026-01-01\n'
        'primary_serial = "SIM-SECONDARY"\nsecondary_serial = "SIM-PRIMARY"\n'
    )
    code, _, told = called(capsys, "--cameras", WALL, "--auto", "--calibration", earlier,
                           "--out", tmp_path / "x", "-q")  # fmt: skip
    assert code == 1
    assert "swapped cameras" in told
