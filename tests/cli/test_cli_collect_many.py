"""Bulk collection: a folder of drives with a manifest that goes on, and sweeps of places."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig.cli.main import run
from rig.core.errors import UsageError
from rig.drivers.registry import open_source
from rig.experiments.bound import find_bound
from rig.record.reader import open_recording

ROAD = "sim:road?size=320x240"


def test_a_folder_of_drives_goes_on_and_refuses_other_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "data"
    words = ["collect", "--cameras", ROAD, "--frames", "3", "--workers", "1", "--out", str(out)]
    assert run([*words, "--seeds", "1", "-q"]) == 0
    before = (out / "road-1" / "run.mcap").stat().st_mtime_ns
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["drives"]["road-1"]["pairs"] == 3

    manifest["drives"]["road-2"] = {**manifest["drives"]["road-1"], "seed": 2}
    del manifest["drives"]["road-2"]["pairs"]
    (out / "manifest.json").write_text(json.dumps(manifest))
    (out / "road-2").mkdir()
    assert run([*words, "--seeds", "1-2"]) == 0
    assert "2 drives, 1 of them there already" in capsys.readouterr().err
    assert (out / "road-1" / "run.mcap").stat().st_mtime_ns == before
    assert len(open_recording(out / "road-2")) == 3

    assert run([*words, "--seeds", "1", "--leader", "mean"]) == 1
    assert "was recorded with leader 'aeag', not 'mean'" in capsys.readouterr().err
    (out / "manifest.json").write_text("{}")
    assert run([*words, "--seeds", "1"]) == 1
    assert "is no manifest" in capsys.readouterr().err


def test_a_sweep_stands_still_and_takes_all_exposures(tmp_path: Path) -> None:
    words = ["--sweep", "6", "--poses", "2", "--step-m", "1.5", "-q", "--out", str(tmp_path / "s")]
    assert run(["collect", "--cameras", ROAD, *words]) == 0
    records = list(open_recording(tmp_path / "s").records())
    assert [record.pose_index for record in records] == [0, 0, 0, 1, 1, 1]
    used = [shot.used for record in records[:3] for shot in record.shot]
    assert [settings.gain_db for settings in used] == [10.0] * 6
    exposures_us = [settings.exposure_us for settings in used]
    assert exposures_us == sorted(exposures_us)
    assert (exposures_us[0], exposures_us[-1]) == (75.0, 30_000.0)
    travelled = [records[i].truth.position_m[0] for i in (0, 2, 3)]  # type: ignore[union-attr]
    assert travelled[0] == travelled[1] < travelled[2]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--seeds", "1-2"], "--seeds needs --out"),
        (["--workers", "2"], "--workers goes with --seeds"),
        (["--sweep", "5"], "--sweep must be an even number from 2, got 5"),
        (["--sweep", "4", "--frames", "9"], "--frames does not go with --sweep"),
        (["--sweep", "4", "--step-m", "0"], "stand must be triggers and metres"),
        (["--sweep", "4", "--gains", "90"], "is outside the camera's"),
    ],
)
def test_what_cannot_be_meant_is_one_line(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["collect", "--cameras", ROAD, *words]) == 2
    assert told in capsys.readouterr().err


def test_an_address_says_where_it_stands() -> None:
    source = open_source(f"{ROAD}&stand=3@1.5&seed=1", seed=1)
    assert "stand=3@1.5" in source.address
    assert source.drive_triggers is not None and source.drive_triggers % 3 == 0
    assert [source.pose_index(trigger) for trigger in range(4)] == [0, 0, 0, 1]
    with pytest.raises(UsageError, match="leave out stand="):
        find_bound(f"{ROAD}&stand=3@1.5")
