"""`rig info`: what a person asks first, without reading the pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from record_samples import frame, half, record, write

from rig.cli.main import run
from rig.core.types import PairRecord
from rig.experiments.thumbnails import WIDTH_PX
from rig.record import container, sink


def bright(trigger: int, level_dn: int) -> PairRecord:
    given = record(trigger)
    picture = replace(frame(trigger), image=np.full((24, 32), level_dn, np.uint8))
    return replace(given, shot=given.shot._replace(primary=picture))


def test_thumbnails_show_the_run_from_end_to_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records = [bright(t, 5 * t) for t in range(29)] + [half(29)]
    write(tmp_path / "run", records)
    out = tmp_path / "sheet.png"
    assert run(["info", str(tmp_path / "run"), "--thumbnails", str(out), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)["thumbnails"]["triggers"]
    assert (shown[0], shown[-1], len(shown)) == (0, 29, 8)
    sheet = cv2.imread(str(out))
    assert sheet is not None
    assert sheet.shape == (2 * WIDTH_PX * 24 // 32, 8 * WIDTH_PX, 3)
    levels = sheet[80, WIDTH_PX // 2 :: WIDTH_PX, 0].tolist()[:-1]
    assert levels == [5 * trigger for trigger in shown[:-1]]
    assert sheet[-80, -WIDTH_PX // 2].tolist() == [60, 60, 60]  # the last secondary is lost
    assert run(["info", str(tmp_path / "run"), "--thumbnails", str(out)]) == 1
    assert "nothing is overwritten" in capsys.readouterr().err


def test_info_reads_settings_and_no_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1)
    large = np.zeros((1536, 2048), np.uint8)
    big = [
        replace(record(t), shot=type(record(t).shot)(*(replace(f, image=large) for f in pair(t))))
        for t in range(6)
    ]
    size = write(tmp_path / "run", big).stat().st_size
    read = 0
    preadv = container.os.preadv

    def counted(fd: int, buffers: Sequence[bytearray], start: int) -> int:
        nonlocal read
        read += sum(map(len, buffers))
        return preadv(fd, buffers, start)

    monkeypatch.setattr(container.os, "preadv", counted)
    assert run(["info", str(tmp_path / "run"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["triggers"] == 6
    assert read < 3 * large.nbytes < size / 3


def pair(trigger: int) -> list:
    return [frame(trigger), frame(trigger, 40)]
