"""The film: a picture a trigger, the right pixels on either side, plain refusals."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_run import SyntheticRun

from rig.cli.main import run
from rig.core.errors import RigError
from rig.evaluation.front_ends import parse_front_ends
from rig.evaluation.summary import summarise
from rig.evaluation.video import PICTURE_WIDTH_PX, write_video
from rig.record.writer import RecordWriter


def filmed(path: Path, made: SyntheticRun) -> list[NDArray[np.uint8]]:
    write_video(path, made, summarise(made, parse_front_ends("orb")))
    video = cv2.VideoCapture(str(path))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
    pictures = []
    while (read := video.read())[0]:
        pictures.append(np.asarray(read[1], np.uint8))
    video.release()
    return pictures


def test_both_cameras_side_by_side_once_a_trigger(tmp_path: Path) -> None:
    made = SyntheticRun(triggers=16, lost={9: "timeout"})
    pictures = filmed(tmp_path / "film.mp4", made)
    assert len(pictures) == 16
    height_px, width_px = pictures[0].shape[:2]
    assert (width_px, height_px % 2) == (2 * PICTURE_WIDTH_PX + 8, 0)
    records = list(made.records())
    for k in (4, 12):
        for side, left in zip(records[k].shot, (0, PICTURE_WIDTH_PX + 8), strict=True):
            shown = pictures[k][:480, left : left + PICTURE_WIDTH_PX]
            assert shown.mean() == pytest.approx(side.image.mean(), abs=12)  # type: ignore[union-attr]
    assert pictures[9][:480].mean() < 35, "a lost pair is dark"


def test_the_cursor_moves_over_the_curve_of_the_drive(tmp_path: Path) -> None:
    pictures = filmed(tmp_path / "film.mp4", SyntheticRun(triggers=12))
    curve = [picture[-120:] for picture in pictures]
    brightest = [int(part.sum(axis=2).min(axis=0).argmax()) for part in curve]
    assert brightest == sorted(brightest)
    assert brightest[0] < 20
    assert brightest[-1] > 1_260


def test_a_swapped_run_shows_the_left_controller_on_the_left(tmp_path: Path) -> None:
    names = SyntheticRun(triggers=12).names[::-1]
    swapped = SyntheticRun(triggers=12, names=type(SyntheticRun().names)(*names),
                           options={"swap": "true"})  # fmt: skip
    pictures = filmed(tmp_path / "film.mp4", swapped)
    secondary = list(swapped.records())[10].shot.secondary
    shown = pictures[10][:480, :PICTURE_WIDTH_PX]
    assert shown.mean() == pytest.approx(secondary.image.mean(), abs=12)  # type: ignore[union-attr]


def test_what_makes_no_film_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = SyntheticRun(triggers=3)
    with pytest.raises(RigError, match="cannot be written as a film"):
        write_video(tmp_path / "no" / "film.mp4", made, summarise(made))
    (tmp_path / "there.mp4").touch()
    run_folder = tmp_path / "run"
    for arguments, problem, code in (
        ((run_folder, "--video", tmp_path / "film.avi"), "name a file that ends in .mp4", 2),
        ((run_folder, run_folder, "--video", tmp_path / "f.mp4"), "not 2", 2),
        ((run_folder, "--video", tmp_path / "there.mp4"), "nothing is overwritten", 1),
        ((run_folder, "--video", tmp_path / "no" / "f.mp4"), "there is no folder", 1),
        ((), "nothing to report on", 2),
    ):
        assert run(["report", *map(str, arguments)]) == code
        error = capsys.readouterr().err
        assert problem in error
        assert error.count("\n") == 1


def test_the_command_makes_a_film_beside_the_report(tmp_path: Path) -> None:
    made = SyntheticRun(triggers=13)
    with RecordWriter(tmp_path / "run", made.header, real_time=False) as writer:
        for record in made.records():
            writer.write(record)
    film = tmp_path / "film.mp4"
    arguments = ["report", str(tmp_path / "run"), "--video", str(film), "--no-pictures", "-q"]
    assert run(arguments) == 0
    assert film.stat().st_size > 10_000
    page = (tmp_path / "run" / "report.html").read_text()
    assert "<img" not in page
