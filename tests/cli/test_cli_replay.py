"""`rig replay`: the same frames give the same decisions, another picture gives another."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig.cli.main import run
from rig.core.errors import CameraLost, RigError
from rig.core.protocols import Source
from rig.core.types import Frame, Lost, Pair, PairRecord
from rig.drivers.registry import open_source
from rig.record.reader import open_recording
from rig.record.writer import RecordWriter


@pytest.fixture(scope="module")
def raced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replay") / "run"
    arguments = ["--cameras", "sim:tunnel?size=320x240", "--frames", "14", "-q"]
    assert run(["race", "ours", "shin", *arguments, "--out", str(folder)]) == 0
    return folder


def replayed(
    capsys: pytest.CaptureFixture[str], folder: Path, controller: str
) -> tuple[int, dict[str, object]]:
    capsys.readouterr()
    code = run(["replay", str(folder), controller, "--json"])
    values: dict[str, object] = json.loads(capsys.readouterr().out)
    return code, values


@pytest.mark.parametrize(("controller", "side"), [("ours", "primary"), ("shin", "secondary")])
def test_decisions_are_the_same_to_the_last_bit(
    raced: Path, controller: str, side: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, values = replayed(capsys, raced, controller)
    assert code == 0
    assert (values["compared"], values["different"], values["identical"]) == (14, 0, True)
    assert values["drove"] == [side]
    recorded = [getattr(each.decisions, side).command for each in open_recording(raced).records()]
    told = values["decisions"]
    assert isinstance(told, dict)
    assert [(each["exposure_us"], each["gain_db"]) for each in told[side]] == [
        (each.exposure_us, each.gain_db) for each in recorded
    ]


def again(folder: Path, out: Path, change: Callable[[PairRecord], PairRecord]) -> None:
    recording = open_recording(folder)
    with RecordWriter(out, recording.header, real_time=False) as writer:
        for each in recording.records():
            writer.write(change(each))


def darker(record: PairRecord) -> PairRecord:
    primary = record.shot.primary
    if record.trigger != 6 or not isinstance(primary, Frame):
        return record
    return replace(
        record, shot=record.shot._replace(primary=replace(primary, image=primary.image // 4))
    )


def test_one_altered_picture_changes_the_decision(
    raced: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again(raced, tmp_path / "altered", darker)
    code, values = replayed(capsys, tmp_path / "altered", "ours")
    assert code == 1
    mismatches = values["mismatches"]
    assert isinstance(mismatches, list)
    differ = [each["trigger"] for each in mismatches]
    assert differ[:3] == [6, 7, 8]  # it looks at three frames, and goes on from its last command
    assert values["different"] == len(differ)
    assert mismatches[0]["recorded"] != mismatches[0]["replayed"]
    assert run(["replay", str(tmp_path / "altered"), "ours"]) == 1
    assert f"{len(differ)} of 14 differ" in capsys.readouterr().out


def test_another_controller_is_shown_and_not_compared(
    raced: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, values = replayed(capsys, raced, "fixed:exposure_us=700,gain_db=3")
    assert code == 0
    assert (values["compared"], values["identical"], values["drove"]) == (0, False, [])
    told = values["decisions"]
    assert isinstance(told, dict)
    assert told["primary"][3] == {"trigger": 3, "exposure_us": 700.0, "gain_db": 3.0}
    assert run(["replay", str(raced), "fixed:exposure_us=700,gain_db=3"]) == 0
    assert "nothing to compare" in capsys.readouterr().out


def test_losses_are_passed_over_as_they_were(
    raced: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def lose(record: PairRecord) -> PairRecord:
        if record.trigger != 4:
            return record
        lost = Lost(4, "secondary: no frame in time")
        shot: Pair[Frame | Lost] = Pair(record.shot.primary, lost)
        nobody = Pair(None, None)
        return replace(record, shot=shot, cause=lost.cause, offset_ns=None, decisions=nobody)

    again(raced, tmp_path / "lossy", lose)
    _, values = replayed(capsys, tmp_path / "lossy", "shin")
    assert values["compared"] == 13
    source = open_source(f"replay:{tmp_path / 'lossy'}", seed=0)
    shots = list(play(source))
    assert shots[4].secondary == "secondary: no frame in time"
    assert isinstance(shots[5].secondary, Frame)


def play(source: Source) -> list[Pair[Frame | str]]:
    """Return the shots of a whole replay, taken as the loop takes them."""
    from rig.pair import CameraPair

    pair, found = CameraPair(source), []
    for _ in range(source.drive_triggers or 0):
        frames = pair.shoot().frames
        found.append(Pair(*(each if isinstance(each, Frame) else each.cause for each in frames)))
    return found


def test_a_recording_is_an_address_of_cameras(raced: Path, tmp_path: Path) -> None:
    folder = tmp_path / "raced-again"
    cameras = f"replay:{raced}"
    assert run(["race", "ours", "shin", "--cameras", cameras, "--out", str(folder), "-q"]) == 0
    pairs = zip(open_recording(raced).records(), open_recording(folder).records(), strict=True)
    for before, now in pairs:
        for a, b in zip(before.shot, now.shot, strict=True):
            assert isinstance(a, Frame)
            assert isinstance(b, Frame)
            assert np.array_equal(a.image, b.image)
            assert (a.device_time_ns, a.used) == (b.device_time_ns, b.used)
        for told, said in zip(before.decisions, now.decisions, strict=True):
            assert told is not None
            assert said is not None
            assert (told.command, told.diagnostics) == (said.command, said.diagnostics)


def test_behind_the_end_the_cameras_are_gone(raced: Path) -> None:
    source = open_source(f"replay:{raced}", seed=0)
    play(source)
    with pytest.raises(CameraLost, match="ended after 14 triggers"):
        source.cameras.primary.trigger()


def test_what_is_not_there_is_said_in_one_line(
    raced: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["replay", "nowhere", "ours"]) == 1
    assert run(["replay", str(raced), "nobody"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    with pytest.raises(RigError, match="does not exist"):
        open_source("replay:nowhere", seed=0)
