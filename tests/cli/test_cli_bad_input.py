"""Bad input gets one clear line and the right exit code, and loses nothing."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rig.cli.main import run

CAMERAS = ("--cameras", "sim:tunnel?size=320x240")


def complaint(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    capsys.readouterr()
    code = run([str(argument) for argument in arguments])
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("rig: ")]
    assert len(lines) == 1, "one line"
    return code, lines[0]


SMALL_WALL = ("--cameras", "sim:wall?size=160x120")
ONE_WORLD = ("--cameras", "sim:tunnel?seed=9")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("race", "shinn", "aeag"), 2, ("shinn", "shin")),
        (("race", "aeag:target=50", "aeag"), 2, ("target", "target_dn")),
        (("race", "fixed:exposure_us=much", "aeag"), 2, ("exposure_us", "much")),
        (("race", "aeag", "aeag", "--cameras", "sim:tunel"), 2, ("tunel", "tunnel")),
        (("race", "aeag", "aeag", "--cameras", "sim:tunnel?sped_mps=3"), 2, ("speed_mps",)),
        (("race", "aeag", "aeag", "--cameras", "sim:tunnel?size=big"), 2, ("size", "big")),
        (("race", "aeag", "aeag", "--cameras", "usb:1"), 2, ("usb", "sim")),
        (("race", "aeag"), 2, ("RIGHT",)),
        (("rase", "aeag", "aeag"), 2, ("race",)),
        (("race", "aeag", "aeag", "--frames", "0"), 2, ("--frames", "0")),
        (("collect", "--frames", "-3"), 2, ("--frames", "-3")),
        (("bound", "--frames", "0"), 2, ("--frames", "0")),
        (("report", "no/such/run"), 1, ("no/such/run does not exist",)),
        (("export", "no/run", "--to", "eurocc", "--out", "x"), 2, ("eurocc", "mean 'euroc'")),
        (("race", "aeag", "aeag", "--seeds", "one"), 2, ("one", "1-20")),
        (("evaluate", "no/such/run"), 1, ("no/such/run",)),
        (("simulate", "tunel"), 2, ("tunel", "tunnel")),
        (("simulate", "wall", "--exposure-us", "a,b"), 2, ("--exposure-us", "numbers")),
        (("simulate", "wall", "--gain-db", "0,0"), 2, ("--gain-db", "twice")),
        (("simulate", "wall", "--pair", "1.5"), 2, ("--pair", "whole")),
        (("simulate", "wall", "--pair", "500"), 2, ("pair 500", "0 to 119")),
        (("simulate", "wall", "--gain-db", "90"), 2, ("90 dB", "47.99")),
        (("simulate", "wall", "--exposure-us", "-5"), 2, ("exposure_us", "-5")),
        (("simulate", "replay:x"), 2, ("replay:x", "sim:tunnel")),
        (("evaluate",), 2, ("nothing to evaluate",)),
        (("info", "no/such/run"), 1, ("no/such/run",)),
        (("train", "none.npz", "--out", "x.onnx"), 1, ("none.npz",)),
        (("train", "none.npz", "--net", "map-smal", "--out", "x.onnx"), 2, ("mean 'map-small'",)),
        (("targets", "none", "--metric", "nope", "--out", "x.npz"), 2, ("nope", "path")),
        (("race", "fixed:gain_db=99", "aeag", *SMALL_WALL), 1, ("99", "0..30 dB")),
        (("collect", "--sweep", "4", "--gains", "99", *SMALL_WALL), 2, ("99 dB", "0..30 dB")),
        (("collect", "--sweep", "4", "--poses", "0"), 2, ("--poses", "0")),
        (("collect", "--poses", "3"), 2, ("go with --sweep",)),
        (("collect", "--seeds", "1-2", "--out", "x", *ONE_WORLD), 2, ("--seeds", "seed=9")),
        (
            ("targets", ONE_WORLD[1], "--seeds", "1-2", "--metric", "path", "--out", "x.npz"),
            2,
            ("--seeds", "seed=9"),
        ),
        (
            ("calibrate-aperture", "--auto", "--calibration", "nope.toml", *SMALL_WALL),
            1,
            ("nope.toml",),
        ),
    ],
)
def test_one_line_and_the_exit_code(
    arguments: tuple[str, ...],
    code: int,
    words: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    got, line = complaint(capsys, *arguments)
    assert got == code, line
    for word in words:
        assert word in line
    assert not list(tmp_path.iterdir()), "nothing is left behind"


def test_a_folder_that_exists_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").write_text("precious")
    code, line = complaint(capsys, "race", "aeag", "aeag", *CAMERAS, "--out", tmp_path / "mine")
    assert code == 1
    assert "mine" in line and "exists" in line
    assert (tmp_path / "mine").read_text() == "precious"


def test_a_network_of_the_wrong_shape_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "noise.onnx"
    model.write_bytes(b"this is no network")
    code, line = complaint(capsys, "race", f"network:model={model}", "aeag", *CAMERAS)
    assert code == 1
    assert "noise.onnx" in line


def test_a_recording_cut_short_is_named_and_repaired(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut"
    shutil.copytree(race_folder, cut)
    whole = (cut / "run.mcap").read_bytes()
    (cut / "run.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    code, line = complaint(capsys, "info", cut)
    assert code == 1
    assert "rig recover" in line
    assert run(["recover", str(cut)]) == 0
    assert run(["info", str(cut)]) == 0
    assert run(["verify", str(cut)]) in (0, 3)


def test_a_report_that_cannot_be_written_is_named(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(race_folder, folder)
    (folder / "report.html").unlink()
    (folder / "report.html").mkdir()
    code, line = complaint(capsys, "report", folder)
    assert code == 1
    assert "report.html" in line and "directory" in line
