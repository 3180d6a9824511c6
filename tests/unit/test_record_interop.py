"""Readers that are not ours decode every message of a recording, pixels exact."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from record_samples import AUTO, COUNTS, HEADER, INTRINSICS, TRUTH, frame, half, record, write
from rosbags.highlevel import AnyReader

from rig.record import cdr, topics

RECORDS = [record(0), half(1), record(2)]


def check(messages: dict[str, list[object]]) -> None:
    """Check decoded messages, of whichever reader, by topic."""
    assert {topic: len(found) for topic, found in messages.items()} == COUNTS
    images: list[object] = messages["/primary/image_raw"]
    for trigger, image in enumerate(images):
        expected = frame(trigger)
        assert (image.height, image.width, image.step) == (24, 32, 32)  # type: ignore[attr-defined]
        assert image.encoding == "bayer_rggb8"  # type: ignore[attr-defined]
        assert bytes(image.data) == expected.image.tobytes()  # type: ignore[attr-defined]


def test_the_official_mcap_reader_decodes_everything(tmp_path: Path) -> None:
    messages: dict[str, list] = {}
    logged: list[tuple[str, int, int]] = []
    with write(tmp_path, RECORDS).open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            messages.setdefault(channel.topic, []).append(decoded)
            logged.append((channel.topic, message.sequence, message.log_time))
    check(messages)
    meta, lost = messages["/primary/frame_meta"][2], messages["/secondary/frame_meta"][1]
    assert meta.applied.settings.exposure_us == meta.used.exposure_us == 700.5
    assert meta.asked.settings.exposure_us == 700.0
    assert (lost.status, lost.cause) == ("lost", "no frame in 0.5 s")
    assert math.isnan(lost.used.gain_db)
    assert lost.asked.mode == "auto"
    assert lost.asked.target_dn == AUTO.target_dn
    decision = messages["/primary/decision"][0]
    assert {d.key: d.number if d.is_number else d.text for d in decision.diagnostics} == {
        "score": 0.1,
        "state": "expanding",
    }
    pose = messages["/ground_truth/pose"][0].pose
    assert (pose.position.x, pose.position.y, pose.position.z) == TRUTH.position_m
    assert pose.orientation.w == TRUTH.orientation_xyzw[3]
    assert [pair.complete for pair in messages["/pair"]] == [True, False, True]
    for (topic, *_), (following, *_) in pairwise(logged):
        if following.endswith("image_raw"):
            assert topic == following.replace("image_raw", "frame_meta")
    assert ("/secondary/image_raw", 2, 200_000_040) in logged
    assert ("/secondary/frame_meta", 2, 200_000_040) in logged


def test_rosbags_decodes_everything_from_the_folder(tmp_path: Path) -> None:
    write(tmp_path, RECORDS)
    messages: dict[str, list] = {}
    with AnyReader([tmp_path]) as reader:
        for connection, _, data in reader.messages():
            decoded = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append(decoded)
        counted = {each.topic: each.msgcount for each in reader.connections if each.msgcount}
    assert counted == COUNTS
    check(messages)
    camera = messages["/primary/camera_info"][0]
    assert np.allclose(camera.k[[0, 2, 4, 5]], [28.2, 16.0, INTRINSICS.fy_px, 12.0])
    assert (camera.width, camera.height) == (32, 24)
    assert messages["/ground_truth/light"][0].light_cd_m2 == TRUTH.light_cd_m2


def test_the_header_is_there_for_people(tmp_path: Path) -> None:
    with write(tmp_path, RECORDS).open("rb") as file:
        reader = make_reader(file)
        metadata = {each.name: each.metadata for each in reader.iter_metadata()}
        attachments = {each.name: each.data for each in reader.iter_attachments()}
    assert metadata["rig.run"]["cameras"] == HEADER.cameras
    assert metadata["rig.models"] == {"ours": "ff00"}
    assert metadata["rig.camera.primary"]["serial"] == "1001"
    assert metadata["rig.totals"]["lost: secondary: no frame in 0.5 s"] == "1"
    assert b'"leader": "ae"' in attachments["options.json"]


def test_every_definition_holds_all_that_it_needs() -> None:
    for kind in set(topics.TOPICS.values()):
        sections = kind.definition.split(f"{'=' * 80}\nMSG: ")
        given = {section.splitlines()[0] for section in sections[1:]}
        needed = {line.split()[0].split("[")[0] for line in kind.definition.splitlines() if line}
        assert {name for name in needed if "/" in name} == given


def test_the_documentation_holds_the_definitions_as_they_are() -> None:
    text = (Path(__file__).parents[2] / "docs" / "recording.md").read_text()
    for file in (Path(cdr.__file__).parent / "msg" / "rig_msgs").glob("*.msg"):
        assert file.read_text() in text, file.name
    for topic in topics.TOPICS:
        shown = topic.replace("/primary/", "/P/").replace("/secondary/", "/P/")
        assert f"`{shown}`" in text
