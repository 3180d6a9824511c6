"""Writes `metadata.yaml`, which `ros2 bag` wants beside a recording."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.record import topics
from rig.record.container import BAG_FILE, Container, damage, parts


def describe(first: Path) -> None:
    """Write `metadata.yaml` (rosbag2 version 5) beside a finished recording.

    It is JSON, which is YAML too. Raises OSError, or RecordingDamaged for an unfinished file.
    """
    described = [_part(file) for file in parts(first)]
    text = json.dumps({"rosbag2_bagfile_information": _information(described)}, indent=2)
    (first.parent / BAG_FILE).write_text(text + "\n")


@dataclass(frozen=True, slots=True)
class _Part:
    """What `metadata.yaml` says of one file."""

    name: str
    start_ns: int
    end_ns: int
    counts: dict[str, int]


def _part(file: Path) -> _Part:
    with damage(file), Container(file) as container:
        summary = container.summary()
    counts = {topic: summary.messages(topic) for topic in topics.TOPICS}
    statistics = summary.statistics
    return _Part(file.name, statistics.message_start_time, statistics.message_end_time, counts)


def _span(files: list[_Part]) -> dict[str, Any]:
    start_ns = min(part.start_ns for part in files)
    return {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": max(part.end_ns for part in files) - start_ns},
        "message_count": sum(sum(part.counts.values()) for part in files),
    }


def _information(files: list[_Part]) -> dict[str, Any]:
    counted = [
        {
            "topic_metadata": {
                "name": topic,
                "type": kind.ros_name,
                "serialization_format": "cdr",
                "offered_qos_profiles": "",
            },
            "message_count": sum(part.counts[topic] for part in files),
        }
        for topic, kind in topics.TOPICS.items()
    ]
    return {
        "version": 5,
        "storage_identifier": "mcap",
        "relative_file_paths": [part.name for part in files],
        **_span(files),
        "topics_with_message_count": counted,
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": part.name, **_span([part])} for part in files],
    }
