"""`rig match`: any two pictures, both front ends, plain refusals."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from rig.cli.main import run


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("pictures")
    noise = np.random.default_rng(4).integers(0, 256, (480, 660), dtype=np.uint8)
    wide = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    names = folder / "a.png", folder / "b.png"
    for name, x in zip(names, (0, 8), strict=True):
        assert cv2.imwrite(str(name), wide[:, x : x + 640])
    return names


def said(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run(["match", *[str(argument) for argument in arguments]])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_one_front_end_gives_the_published_keys(
    pictures: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = said(capsys, *pictures, "--front-end", "viso2", "--half", "--json")
    assert code == 0
    told = json.loads(out)
    keys = ["front_end", "matches", "inliers", "bucketed", "bucketed_inliers", "ms"]
    assert list(told) == keys
    assert told["front_end"] == "viso2"
    assert told["matches"] >= told["inliers"] > told["bucketed"] >= told["bucketed_inliers"] > 100
    code, out, _ = said(capsys, *pictures, "--front-end", "orb", "--json")
    assert list(json.loads(out)) == ["front_end", "matches", "inliers", "ms"]


def test_both_front_ends_by_default_and_more_at_full_resolution(
    pictures: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    told = json.loads(said(capsys, *pictures, "--json")[1])
    assert list(told) == ["orb", "viso2"]
    half = json.loads(said(capsys, *pictures, "--half", "--json")[1])
    assert told["viso2"]["matches"] > 1.5 * half["viso2"]["matches"]
    lines = said(capsys, *pictures)[1].splitlines()
    assert [line.split()[0] for line in lines] == ["orb", "viso2"]


def test_a_lens_tells_the_motion(
    pictures: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    told = json.loads(said(capsys, *pictures, "--fx", "564", "--json")[1])
    assert isinstance(told["viso2"]["motion"], str)
    assert "motion" not in told["orb"]


def test_pictures_of_two_sizes_match_and_colour_becomes_grey(
    pictures: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = pictures
    small = cv2.imread(str(b))[:400, :600]
    cv2.imwrite(str(tmp_path / "c.png"), small)
    told = json.loads(said(capsys, a, tmp_path / "c.png", "--front-end", "viso2", "--json")[1])
    assert told["inliers"] > 500
    code, _, error = said(capsys, a, tmp_path / "c.png", "--fx", "500")
    assert code == 1
    assert "not one size; --fx describes one lens" in error


@pytest.mark.parametrize(
    ("arguments", "code", "problem"),
    [
        (("nowhere.png",), 1, "nowhere.png: no such picture"),
        (("note.png",), 1, "note.png: cannot be read as a picture"),
        (("tiny.png",), 1, "8 x 8 px is too small"),
        (("a.png", "--cx", "3"), 2, "say nothing without --fx"),
        (("a.png", "--fx", "-3"), 2, "--fx must be above 0 px, got -3.0"),
        (("a.png", "--front-end", "surf"), 2, "unknown front end 'surf'"),
    ],
)
def test_what_cannot_be_matched_is_one_line(
    arguments: tuple[str, ...],
    code: int,
    problem: str,
    pictures: tuple[Path, Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = pictures[0].parent
    (folder / "note.png").write_text("no picture")
    cv2.imwrite(str(folder / "tiny.png"), np.zeros((8, 8), np.uint8))
    found, out, error = said(capsys, pictures[0], folder / arguments[0], *arguments[1:])
    assert found == code
    assert out == ""
    assert problem in error
    assert error.count("\n") == 1
