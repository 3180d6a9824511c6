"""`verify` finds every claim that the bytes do not bear out."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from record_samples import frame, half, mispaired, neither, record, write

from rig.core.types import MAX_PAIR_OFFSET_NS, Frame, Pair, PairRecord, Settings
from rig.record.container import RECORD_HEADER, Container, chunk_records, read_chunk
from rig.record.info import info
from rig.record.verify import verify


def test_a_clean_run_is_sound(tmp_path: Path) -> None:
    found = verify(write(tmp_path, [record(t) for t in range(5)]))
    assert (found.sound, found.pairs, found.lost, found.false_claims) == (True, 5, {}, [])


def test_losses_are_counted_by_cause(tmp_path: Path) -> None:
    found = verify(write(tmp_path, [record(0), half(1), neither(2), half(3), mispaired(4)]))
    assert found.sound
    assert found.pairs == 1
    assert found.lost == {"secondary: no frame in 0.5 s": 2, "both gone": 1, "offset 2 ms": 1}


def late(trigger: int) -> PairRecord:
    offset_ns = MAX_PAIR_OFFSET_NS + 1
    shot = Pair(frame(trigger), frame(trigger, offset_ns))
    return replace(record(trigger), shot=shot, offset_ns=offset_ns)


@pytest.mark.parametrize(
    ("records", "claim"),
    [
        ([record(0), record(2)], "trigger 2: follows trigger 0"),
        ([record(1)], "trigger 1: follows trigger -1"),
        ([replace(record(0), offset_ns=41)], "offset 41 ns, the frames are 40 ns apart"),
        ([late(0)], "complete, but the frames are 500001 ns apart"),
        ([replace(half(0), cause="")], "complete, but a frame is missing"),
        ([replace(record(0), shot=Pair(frame(1), frame(1, 40)))], "primary frame is number 1"),
        ([record(1), replace(record(0), trigger=2)], "not later than the one before"),
    ],
)
def test_a_false_record_is_found(tmp_path: Path, records: list[PairRecord], claim: str) -> None:
    found = verify(write(tmp_path, records))
    assert not found.sound
    assert any(claim in each for each in found.false_claims), found.false_claims


def test_a_camera_that_ignores_settings_is_a_fact_not_a_lie(tmp_path: Path) -> None:
    ignored = replace(record(1), applied=Pair(Settings(5.0, 0.0), Settings(700.5, 3.0)))
    file = write(tmp_path, [record(0), ignored])
    assert verify(file).sound
    found = info(file)
    assert (found.primary.settings_not_taken, found.secondary.settings_not_taken) == (1, 0)


Edit = Callable[[dict[tuple[str, int], slice], bytearray], None]


def edit_messages(file: Path, edit: Edit) -> None:
    """Change message bodies in place and make every chunk's checksum right again."""
    data = bytearray(file.read_bytes())
    with Container(file) as container:
        names = {id_: topic for topic, id_ in container.summary().channels.items()}
        extents = [e for e in container.extents() if e.opcode == Opcode.CHUNK]
    where: dict[tuple[str, int], slice] = {}
    head = RECORD_HEADER.size
    for extent in extents:
        body = data[extent.start + head : extent.end]
        records = read_chunk(body).records
        start = extent.end - len(records)
        for opcode, offset, message in chunk_records(records):
            if opcode == Opcode.MESSAGE:
                id_, sequence = struct.unpack_from("<HI", message)
                first = start + offset + head + 22
                place = slice(first, first + len(message) - 22)
                where[names[id_], sequence] = place
    edit(where, data)
    for extent in extents:
        chunk = data[extent.start + head : extent.end]
        crc = zlib.crc32(read_chunk(chunk).records)
        struct.pack_into("<I", data, extent.start + head + 24, crc)
    file.write_bytes(data)


def swap(a: tuple[str, int], b: tuple[str, int]) -> Edit:
    def edit(where: dict[tuple[str, int], slice], data: bytearray) -> None:
        first, second = bytes(data[where[a]]), bytes(data[where[b]])
        assert len(first) == len(second)
        data[where[a]], data[where[b]] = second, first

    return edit


def flip(message: tuple[str, int], at: int) -> Edit:
    def edit(where: dict[tuple[str, int], slice], data: bytearray) -> None:
        start = where[message].start + (
            at if at >= 0 else where[message].stop - where[message].start + at
        )
        data[start] ^= 1

    return edit


def swap_pixels(a: tuple[str, int], b: tuple[str, int]) -> Edit:
    def edit(where: dict[tuple[str, int], slice], data: bytearray) -> None:
        size = 24 * 32
        first, second = (slice(where[m].stop - size, where[m].stop) for m in (a, b))
        data[first], data[second] = bytes(data[second]), bytes(data[first])

    return edit


@pytest.mark.parametrize(
    "edit",
    [
        swap_pixels(("/primary/image_raw", 0), ("/primary/image_raw", 1)),
        swap_pixels(("/primary/image_raw", 1), ("/secondary/image_raw", 1)),
        swap(("/primary/image_raw", 0), ("/primary/image_raw", 2)),
        swap(("/primary/frame_meta", 0), ("/primary/frame_meta", 1)),
        swap(("/primary/decision", 0), ("/primary/decision", 2)),
        swap(("/ground_truth/pose", 0), ("/ground_truth/pose", 1)),
        flip(("/primary/image_raw", 1), -1),
        flip(("/primary/image_raw", 1), 24),
        flip(("/secondary/frame_meta", 1), 60),
        flip(("/pair", 1), 30),
        flip(("/ground_truth/light", 2), -1),
        flip(("/secondary/decision", 0), -5),
        flip(("/primary/camera_info", 0), 100),
    ],
)
def test_a_change_is_found_though_checksums_were_rewritten(tmp_path: Path, edit: Edit) -> None:
    file = write(tmp_path, [record(t) for t in range(3)])
    edit_messages(file, lambda where, data: None)
    assert verify(file).sound
    edit_messages(file, edit)
    found = verify(file)
    assert not found.sound
    assert found.false_claims


def rewrite(file: Path, topic_of: Callable[[str], str]) -> Path:
    """Write a recording anew, every checksum right, with its messages on other topics."""
    out = file.with_name("rewritten.mcap")
    with file.open("rb") as old, out.open("wb") as new:
        reader, writer = make_reader(old), Writer(new, compression=CompressionType.NONE)
        writer.start(reader.get_header().profile, reader.get_header().library)
        channels: dict[int, int] = {}
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for each in reader.iter_attachments():
            writer.add_attachment(
                each.create_time, each.log_time, each.name, each.media_type, each.data
            )
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    topic_of(channel.topic), channel.message_encoding, number, channel.metadata
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()
    return out


def other_camera(topic: str) -> str:
    swapped = {"primary": "secondary", "secondary": "primary"}
    return "/".join(swapped.get(part, part) for part in topic.split("/"))


def test_cameras_exchanged_in_a_file_are_found(tmp_path: Path) -> None:
    file = write(tmp_path, [record(t) for t in range(3)])
    assert verify(rewrite(file, str)).sound
    found = verify(rewrite(file, other_camera))
    assert not found.sound
    assert any("trigger 0: the primary picture" in claim for claim in found.false_claims)


def test_a_whole_trigger_exchanged_for_another_run_is_found(tmp_path: Path) -> None:
    """Two runs alike but for one trigger: its messages are sealed, yet not into this chain."""
    records = [record(t) for t in range(3)]
    other = replace(records[1], shot=Pair(replace_pixels(records[1].shot.primary), frame(1, 40)))
    file = write(tmp_path / "a", records)
    foreign = write(tmp_path / "b", [records[0], other, records[2]]).read_bytes()

    def edit(where: dict[tuple[str, int], slice], data: bytearray) -> None:
        for (topic, trigger), place in where.items():
            if trigger == 1 and topic != "/pair":
                data[place] = foreign[place]

    edit_messages(file, edit)
    assert any("trigger 1" in claim for claim in verify(file).false_claims)


def replace_pixels(shot: object) -> Frame:
    assert isinstance(shot, Frame)
    return replace(shot, image=255 - shot.image)


def test_a_flipped_bit_under_a_checksum_is_found(tmp_path: Path) -> None:
    file = write(tmp_path, [record(t) for t in range(3)])
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    found = verify(file)
    assert not found.sound
    assert "checksum of the chunk" in found.false_claims[0]


def test_info_says_what_is_in_the_file(tmp_path: Path) -> None:
    found = info(write(tmp_path, [record(0), half(1), neither(2), record(3)])).as_dict()
    assert found["triggers"] == 4
    assert found["pairs_complete"] == 2
    assert found["drops"] == {"secondary: no frame in 0.5 s": 1, "both gone": 1}
    assert found["primary"]["exposure_us"] == (700.5, 700.5, 700.5)
    assert found["primary"]["frames"] == 3
    assert found["duration_s"] == pytest.approx(0.3)
    assert found["secondary"]["controller"] == "shin"
    assert not found["recovered"]
    empty = info(write(tmp_path / "empty", []))
    assert (empty.triggers, empty.duration_s, empty.primary.exposure_us) == (0, 0.0, None)
