"""The commands as a script calls them: what they write, print, and exit with."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rig.cli.main import run
from rig.cli.provenance import file_sha256
from rig.core.types import Settings
from rig.experiments import known_bounds
from rig.experiments.known_bounds import Bound, Constant, Reach, Replayed, remember
from rig.models.shipped import shipped_networks
from rig.record.reader import open_recording


def said(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_a_race_leaves_three_files(race_folder: Path) -> None:
    assert {"run.mcap", "summary.json", "report.html"} <= {p.name for p in race_folder.iterdir()}
    summary = json.loads((race_folder / "summary.json").read_text())
    assert summary["schema"] == "rig.summary/1"
    assert summary["frames"] == summary["pairs_complete"] == 14
    assert summary["drops"] == {}
    assert summary["left"]["controller"] == "aeag"
    assert set(summary["right"]["orb"]) == {"median", "min", "mean", "p5", "blind_frames"}
    assert summary["right"]["exposure_us"] == [2000.0, 2000.0, 2000.0]
    assert summary["world_version"].startswith("tunnel/")


def test_the_same_seed_gives_the_same_settings_and_pictures(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = json.loads((race_folder / "summary.json").read_text())
    arguments = ["--frames", "6", "--seed", "3", "--out", tmp_path / "again", "-q"]
    rivals = (summary["left"]["controller"], summary["right"]["controller"])
    code, _, _ = said(capsys, "race", *rivals, "--cameras", summary["cameras"], *arguments)
    assert code == 0
    again = open_recording(tmp_path / "again").records()
    for first, second in zip(open_recording(race_folder).records(), again, strict=False):
        assert first.asked == second.asked
        for a, b in zip(first.shot, second.shot, strict=True):
            assert a.used == b.used
            assert a.image.tobytes() == b.image.tobytes()


def test_swap_gives_left_the_secondary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--frames", "3", "--cameras", "sim:tunnel?size=320x240", "--out", tmp_path / "s"]
    code, out, _ = said(capsys, "race", "aeag", "fixed:exposure_us=500,gain_db=0", "--swap",
                        "--json", *arguments)  # fmt: skip
    assert code == 0
    assert json.loads(out)["left"]["controller"] == "aeag"
    recording = open_recording(tmp_path / "s")
    assert recording.header.controllers.secondary == "aeag"


def test_seeds_are_compared_over_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--frames", "13", "--cameras", "sim:tunnel?size=320x240", "--json"]
    out = tmp_path / "many"
    seeds = ("--seeds", "1,2", "--out", out)
    code, text, _ = said(capsys, "race", "aeag", "aeag", *seeds, *arguments, "-q")
    assert code == 0
    values = json.loads(text)
    assert values == json.loads((out / "evaluation.json").read_text())
    assert [run["seed"] for run in values["runs"]] == [1, 2]
    assert (out / "2" / "report.html").is_file()
    assert "aeag vs aeag" in values["differences"]
    page = (out / "report.html").read_text()
    assert page.count("seed 1:") == page.count("seed 2:") == 2
    code, text, _ = said(capsys, "evaluate", out, "--json", "-q")
    assert code == 0
    assert json.loads(text) == values, "a folder of runs is its runs, in their order"


def test_verify_finds_a_run_sound(race_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = said(capsys, "verify", race_folder, "--json")
    assert code == 0
    assert json.loads(out) == {"sound": True, "pairs": 14, "lost": {}, "false_claims": []}


def test_info_tells_rate_and_settings(
    race_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = said(capsys, "info", race_folder / "run.mcap")
    assert code == 0
    assert "sim:tunnel" in out and "aeag" in out


def test_evaluate_ranks_controllers(race_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = said(capsys, "evaluate", race_folder, "--json")
    assert code == 0
    values = json.loads(out)
    assert values["schema"] == "rig.evaluation/1"
    assert values["runs"][0] == json.loads((race_folder / "summary.json").read_text())
    (pair,) = values["paired"].values()
    assert pair["ci95"] is None, "one run claims no significance"
    (apart,) = values["differences"].values()
    assert apart["orb"]["mean"]["ci95"] is None
    assert apart["viso2"]["runs"] == 1


def test_evaluate_makes_a_league_table_of_many_runs(
    race_folder: Path,
    collect_folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(race_folder, tmp_path / "again")
    runs = (race_folder, tmp_path / "again", collect_folder)
    league, options = tmp_path / "league", ("--front-end", "orb", "-q")
    code, out, _ = said(capsys, "evaluate", *runs, *options, "--out", league)
    assert code == 0
    lines = out.splitlines()
    assert lines[-1] == f"report: {league / 'report.html'}"
    assert (league / "report.html").is_file()
    values = json.loads((league / "evaluation.json").read_text())
    assert len(values["runs"]) == 3
    code, _, error = said(capsys, "evaluate", *runs, *options, "--out", league)
    assert code == 1
    assert "exists" in error
    assert lines[0] == "SIMULATED: 3 of 3 runs"
    assert lines[1].split()[0] == "controller"
    places = [line.split() for line in lines[2:5]]
    assert [row[0] for row in places] == ["1", "2", "3"]
    medians = [float(row[3]) for row in places]
    assert medians == sorted(medians, reverse=True)
    duel = next(line for line in lines if line.startswith("aeag vs fixed"))
    assert "median ratio" in duel
    assert "95 %" in duel


def test_ways_are_written_one_file_a_side_and_the_true_one(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, again = tmp_path / "ways", tmp_path / "run"
    shutil.copytree(race_folder, again)
    code, _, _ = said(capsys, "evaluate", race_folder, again, "--trajectories", folder, "-q")
    assert code == 0
    both = [
        f"{name}-{whose}.tum" for name in ("run", "run_2") for whose in ("left", "right", "truth")
    ]
    assert sorted(path.name for path in folder.iterdir()) == sorted(both)
    true = np.loadtxt(folder / "run-truth.tum")
    assert true.shape == (14 - 9, 8)
    assert true[:, 0] == pytest.approx(np.arange(9, 14) / 10)
    assert np.linalg.norm(true[:, 4:], axis=1) == pytest.approx(1)
    told = np.loadtxt(folder / "run-left.tum")
    assert set(told[:, 0]) <= set(true[:, 0])
    assert (folder / "run_2-left.tum").read_bytes() == (folder / "run-left.tum").read_bytes()


def test_a_failed_evaluation_leaves_no_folder(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "note.txt").write_text("no film")
    arguments = (tmp_path / "note.txt", "--out", tmp_path / "league")
    code, _, error = said(capsys, "evaluate", race_folder, *arguments, "--front-end", "orb")
    assert code == 1
    assert "note.txt: cannot be read as a video" in error
    assert not (tmp_path / "league").exists()


def test_trajectories_need_the_front_end_that_tells_them(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("--front-end", "orb", "--trajectories", tmp_path / "ways")
    code, _, error = said(capsys, "evaluate", race_folder, *arguments)
    assert code == 2
    assert "--trajectories needs odometry" in error
    assert not (tmp_path / "ways").exists()


def test_evaluate_takes_a_folder_of_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wide = np.random.default_rng(0).integers(0, 256, (60, 100), np.uint8)
    wide = cv2.resize(wide, (800, 480), interpolation=cv2.INTER_NEAREST)
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), wide[:, 8 * k : 8 * k + 640])
    code, out, _ = said(capsys, "evaluate", tmp_path, "--json")
    assert code == 0
    told = json.loads(out)["pictures"][str(tmp_path)]
    assert told["pictures"] == 3
    assert told["orb"]["min"] > 100


def test_report_writes_the_page_anew(race_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = race_folder / "report.html"
    before = page.read_bytes()
    page.unlink()
    code, out, _ = said(capsys, "report", race_folder)
    assert code == 0
    assert page.read_bytes() == before
    assert out.rstrip().endswith(f"report: {page}")


def test_several_reports_are_one_document(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        shutil.copytree(race_folder, folder)
    code, out, _ = said(capsys, "report", *folders, "--json")
    assert code == 0
    told = json.loads((race_folder / "summary.json").read_text())
    assert [run["left"]["orb"] for run in json.loads(out)["runs"]] == [told["left"]["orb"]] * 2


def test_a_recording_named_twice_is_refused(
    race_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, problem = said(capsys, "evaluate", race_folder, race_folder / "run.mcap")
    assert code == 2
    assert "named twice" in problem


def test_a_controller_that_fails_is_not_ranked_without_a_word(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    cameras = "sim:wall?size=64x48"  # too small for the network's cells
    code, out, _ = said(
        capsys, "race", "ours", "aeag", "--cameras", cameras, "--frames", 12, "--out", folder
    )
    assert code == 0
    assert "ours failed on 12 pictures, where its last settings held" in out
    told = json.loads((folder / "summary.json").read_text())
    assert (told["left"]["held"], told["right"]["held"]) == (12, 0)
    _, out, _ = said(capsys, "evaluate", folder)
    assert out.startswith("SIMULATED: 1 of 1 runs\nours failed on 12 pictures")


def test_a_drive_whose_bound_is_known_is_told_as_a_share_of_it(
    race_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(known_bounds, "cache_folder", lambda: tmp_path / "cache")
    told = json.loads((race_folder / "summary.json").read_text())
    assert "bound" not in told and "of_bound" not in told["left"]
    folder = tmp_path / "run"
    shutil.copytree(race_folder, folder)
    best = Bound(
        cameras=told["cameras"],
        grid=(10, 5),
        best_median=800,
        best_min=0,
        best_constant=Constant(Settings(1000.0, 0.0), 1.0, 0),
        steadiest_constant=Constant(Settings(1000.0, 0.0), 1.0, 0),
        replayed=Replayed(790.0, 0.0),
        reach=Reach(),
        pairs=4,
        world_version=told["world_version"],
    )
    remember(best)
    code, out, _ = said(capsys, "report", folder)
    assert code == 0
    assert "a median of 800 and a minimum of 0" in out
    near = json.loads((folder / "summary.json").read_text())
    assert near["bound"] == {"best_median": 800, "best_min": 0}
    share = near["left"]["of_bound"]
    assert share == {"median_pct": near["left"]["orb"]["median"] / 8, "min_pct": None}
    assert f"{share['median_pct']:.0f} % of the median" in (folder / "report.html").read_text()
    code, out, _ = said(capsys, "evaluate", folder, "--json")
    means = json.loads(out)["by_controller"]
    assert means["aeag"]["of_bound"] == share | {"runs": 1}
    for other in ("orb:features=900", "orb,features=900"):
        _, out, _ = said(capsys, "evaluate", folder, "--json", "--front-end", other)
        assert "of_bound" not in json.loads(out)["by_controller"]["aeag"]
    remember(replace(best, pairs=5))
    said(capsys, "report", folder)
    assert "bound" not in json.loads((folder / "summary.json").read_text()), "not the whole drive"


def test_collect_to_targets(
    collect_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "hybrid.npz"
    code, text, _ = said(capsys, "targets", collect_folder, "--out", out, "--json")
    assert code == 0
    assert json.loads(text)["poses"] == 11
    assert out.is_file()


def test_a_network_leads_the_next_collection(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The iterative collection of thesis chapter 6; the recording says which network it was."""
    folder, model = tmp_path / "second", shipped_networks()["ours"]
    arguments = ("--leader", f"network:model={model}", "--cameras", "sim:road?size=320x240")
    code, _, _ = said(capsys, "collect", *arguments, "--frames", 4, "--out", folder)
    assert code == 0
    header = open_recording(folder).header
    assert header.controllers.primary == f"network:model={model}"
    assert header.models == {header.controllers.primary: file_sha256(model)}


def test_collecting_stays_on_the_training_worlds(collect_folder: Path) -> None:
    assert "split=train" in open_recording(collect_folder).header.cameras
