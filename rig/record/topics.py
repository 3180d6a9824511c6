"""The topics of a recording: names, message types and coordinate frames."""

from __future__ import annotations

from collections.abc import Mapping

from rig.core.types import SIDES, Side
from rig.record.cdr import MessageType, message_type

IMAGE_TYPE = message_type("sensor_msgs/Image")
CAMERA_INFO_TYPE = message_type("sensor_msgs/CameraInfo")
FRAME_META_TYPE = message_type("rig_msgs/FrameMeta")
DECISION_TYPE = message_type("rig_msgs/Decision")
PAIR_TYPE = message_type("rig_msgs/PairMeta")
POSE_TYPE = message_type("geometry_msgs/PoseStamped")
LIGHT_TYPE = message_type("rig_msgs/Light")

PAIR = "/pair"
POSE = "/ground_truth/pose"
LIGHT = "/ground_truth/light"
DEPTH = "/ground_truth/depth"


def image(side: Side) -> str:
    """Return the topic of a camera's pictures."""
    return f"/{side}/image_raw"


def camera_info(side: Side) -> str:
    """Return the topic of a camera's intrinsics."""
    return f"/{side}/camera_info"


def frame_meta(side: Side) -> str:
    """Return the topic that says with which settings each picture was taken."""
    return f"/{side}/frame_meta"


def decision(side: Side) -> str:
    """Return the topic of the decisions for a camera."""
    return f"/{side}/decision"


def optical_frame(side: Side) -> str:
    """Return the coordinate frame of a camera: x right, y down, z forward."""
    return f"{side}_optical"


WORLD_FRAME = "world"

TOPICS: Mapping[str, MessageType] = {
    **{camera_info(side): CAMERA_INFO_TYPE for side in SIDES},
    **{frame_meta(side): FRAME_META_TYPE for side in SIDES},
    **{image(side): IMAGE_TYPE for side in SIDES},
    **{decision(side): DECISION_TYPE for side in SIDES},
    POSE: POSE_TYPE,
    LIGHT: LIGHT_TYPE,
    PAIR: PAIR_TYPE,
    DEPTH: IMAGE_TYPE,
}
"""Every topic of a recording, in the order in which the channels are numbered."""

IMAGES = frozenset({*map(image, SIDES), DEPTH})
"""Topics whose messages are pictures."""

PER_RUN = frozenset(camera_info(side) for side in SIDES)
"""Topics with one message a run, outside of any trigger."""
