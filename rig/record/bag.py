"""Writes `metadata.yaml`, which `ros2 bag` wants beside a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rig.record import topics
from rig.record.container import BAG_FILE, Container, Summary, damage


def describe(path: Path) -> None:
    """Write `metadata.yaml` (rosbag2 version 5) beside a finished recording.

    It is JSON, which is YAML too. Raises OSError, or RecordingDamaged for an unfinished file.
    """
    with damage(path), Container(path) as container:
        information = _information(path.name, container.summary())
    text = json.dumps({"rosbag2_bagfile_information": information}, indent=2)
    (path.parent / BAG_FILE).write_text(text + "\n")


def _information(name: str, summary: Summary) -> dict[str, Any]:
    start_ns = summary.statistics.message_start_time
    span = {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": summary.statistics.message_end_time - start_ns},
        "message_count": summary.statistics.message_count,
    }
    counted = [
        {
            "topic_metadata": {
                "name": topic,
                "type": kind.ros_name,
                "serialization_format": "cdr",
                "offered_qos_profiles": "",
            },
            "message_count": summary.messages(topic),
        }
        for topic, kind in topics.TOPICS.items()
    ]
    return {
        "version": 5,
        "storage_identifier": "mcap",
        "relative_file_paths": [name],
        **span,
        "topics_with_message_count": counted,
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": name, **span}],
    }
