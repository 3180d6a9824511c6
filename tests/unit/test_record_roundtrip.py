"""What is written is what is read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from record_samples import (
    DECISION,
    HEADER,
    TRUTH,
    assert_same,
    half,
    mispaired,
    neither,
    record,
    write,
)

from rig.core.errors import RecordingDamaged, RecordingError
from rig.core.types import Pair, PairRecord
from rig.record.reader import open_recording
from rig.record.verify import verify
from rig.record.writer import without_pictures


@pytest.mark.parametrize(
    "records",
    [
        [],
        [record(0)],
        [record(0), half(1), neither(2), mispaired(3), record(4)],
        [neither(0), record(1)],
        [replace(record(0), decisions=Pair(replace(DECISION, diagnostics={}), None), truth=None)],
    ],
)
def test_records_come_back_as_they_were(tmp_path: Path, records: list[PairRecord]) -> None:
    recording = open_recording(write(tmp_path, records))
    assert recording.header == HEADER
    assert len(recording) == len(records)
    found = list(recording.records())
    assert len(found) == len(records)
    for a, b in zip(found, records, strict=True):
        assert_same(a, b)


def test_depth_comes_back_where_it_was_recorded(tmp_path: Path) -> None:
    depth_m = np.random.default_rng(0).uniform(1.0, 50.0, (24, 32)).astype(np.float32)
    depth_m[0] = np.inf
    with_depth = replace(record(0), truth=replace(TRUTH, depth_m=depth_m))
    file = write(tmp_path, [with_depth, record(1)])
    first, second = open_recording(file).records()
    assert first.truth is not None and second.truth is not None
    assert np.array_equal(first.truth.depth_m, depth_m)  # type: ignore[arg-type]
    assert second.truth.depth_m is None
    assert verify(file).sound
    lost = without_pictures(with_depth, "full")
    assert lost.truth == TRUTH and lost.truth.depth_m is None


def test_a_recording_is_named_by_folder_file_or_metadata(tmp_path: Path) -> None:
    file = write(tmp_path / "run", [record(0)])
    for name in (file, file.parent, file.parent / "metadata.yaml", str(file)):
        assert open_recording(name).path == file


def test_an_existing_recording_is_never_overwritten(tmp_path: Path) -> None:
    file = write(tmp_path, [record(0)])
    before = file.read_bytes()
    with pytest.raises(RecordingError, match="exists already"):
        write(tmp_path, [record(1)])
    assert file.read_bytes() == before


def test_the_same_records_give_the_same_bytes(tmp_path: Path) -> None:
    records = [record(0), half(1)]
    assert (
        write(tmp_path / "a", records).read_bytes() == write(tmp_path / "b", records).read_bytes()
    )


def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="does not exist"):
        open_recording(tmp_path / "none.mcap")
    with pytest.raises(RecordingError, match="holds no"):
        open_recording(tmp_path)
    text = tmp_path / "text.mcap"
    text.write_text("hello")
    with pytest.raises(RecordingDamaged, match="no MCAP file"):
        open_recording(text)


def test_a_cut_recording_names_the_next_step(tmp_path: Path) -> None:
    file = write(tmp_path, [record(0), record(1)])
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(RecordingDamaged, match=f"cut short; try: rig recover {file}"):
        open_recording(file)
