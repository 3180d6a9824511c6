"""A trigger as messages, and back: what every topic holds is decided here."""

from __future__ import annotations

import math
import numbers
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig.core.types import (
    SIDES,
    Auto,
    Command,
    Decision,
    Diagnostics,
    Frame,
    Intrinsics,
    Limits,
    Lost,
    Pair,
    PairRecord,
    PixelFormat,
    Settings,
    Side,
    Truth,
)
from rig.core.units import NS_PER_S
from rig.record import topics
from rig.record.cdr import Buffer
from rig.record.hashes import HASH_BYTES, NOTHING, Summed, sealed, summed

NAN = math.nan
DEPTH_ENCODING = "32FC1"
PIXEL_FORMATS: tuple[PixelFormat, ...] = ("bayer_rggb8", "mono8")


@dataclass(frozen=True, slots=True)
class Message:
    """One message of one trigger: CDR in `data`, and after it, of a picture to write, `tail`.

    A picture that was read is whole in `data`; one to be written is its head in `data` and its
    pixels in `tail`, a view of the frame.
    """

    topic: str
    sequence: int
    log_time_ns: int
    data: Buffer
    tail: Summed = NOTHING

    @property
    def parts(self) -> tuple[Buffer | Summed, ...]:
        """Return the bytes of the message in order."""
        return (self.data, self.tail) if len(self.tail) else (self.data,)

    @property
    def size(self) -> int:
        """Return how many bytes the message has."""
        return len(self.data) + len(self.tail)

    def joined(self) -> Message:
        """Return the message as it is read back: whole in `data`."""
        return Message(
            self.topic, self.sequence, self.log_time_ns, b"".join((self.data, self.tail.data))
        )


@dataclass(frozen=True, slots=True)
class Tie:
    """What ties a trigger to the one before it: its time and its chain hash."""

    time_ns: int = 0
    chain: int = 0


def encode(record: PairRecord, before: Tie) -> tuple[list[Message], Tie]:
    """Return the messages of one trigger in file order, and the tie for the next one.

    A frame's messages are logged at its device time; what has no time of its own takes that of
    the frame that came, or of the trigger before.
    """
    times = [shot.device_time_ns for shot in record.shot if isinstance(shot, Frame)]
    moment_ns = times[0] if times else before.time_ns
    small: list[Message] = []
    messages: list[Message] = []
    for side in SIDES:
        meta, *picture = _frame_messages(record, side, moment_ns)
        small.append(meta)
        messages += [meta, *picture]
    rest = [*_decision_messages(record, moment_ns), *_truth_messages(record, moment_ns)]
    pair = _pair_message(record, moment_ns)
    chain = chain_parts(before.chain, [*small, *rest])
    closed = Message(pair.topic, pair.sequence, moment_ns, sealed(bytes(pair.data), *chain))
    after = Tie(moment_ns, chain_hash(closed))
    return [*messages, *rest, closed], after


def chain_parts(previous: int, messages: list[Message]) -> list[Buffer]:
    """Return what `chain_hash` covers besides `/pair` itself: all but the pictures, in order."""
    parts: list[Buffer] = [struct.pack("<Q", previous)]
    for message in messages:
        parts += [message.topic.encode(), message.data]
    return parts


def chain_hash(pair: Message) -> int:
    """Return the chain hash that a `/pair` message claims."""
    return int.from_bytes(bytes(pair.data[-HASH_BYTES:]), "little")


def camera_info(side: Side, intrinsics: Intrinsics, time_ns: int) -> Message:
    """Return the message that tells viewers about a camera's geometry."""
    fx, fy, cx, cy = intrinsics.fx_px, intrinsics.fy_px, intrinsics.cx_px, intrinsics.cy_px
    values = {
        "header": _header(time_ns, topics.optical_frame(side)),
        "height": intrinsics.height_px,
        "width": intrinsics.width_px,
        "distortion_model": "plumb_bob",
        "d": list(intrinsics.distortion),
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }
    return Message(topics.camera_info(side), 0, time_ns, topics.CAMERA_INFO_TYPE.pack(values))


def _frame_messages(record: PairRecord, side: Side, moment_ns: int) -> Iterator[Message]:
    shot: Frame | Lost = getattr(record.shot, side)
    frame = shot if isinstance(shot, Frame) else None
    time_ns = frame.device_time_ns if frame else moment_ns
    header = _header(time_ns, topics.optical_frame(side))
    picture = _image(frame, header, record.trigger, side) if frame else None
    values = {
        "header": header,
        "trigger": record.trigger,
        "frame_id": shot.sequence,
        "pose_index": record.pose_index,
        "status": "taken" if frame else "lost",
        "cause": shot.cause if isinstance(shot, Lost) else "",
        "asked": _command(getattr(record.asked, side)),
        "applied": _command(getattr(record.applied, side)),
        "used": _settings(frame.used if frame else None),
        "device_time_ns": frame.device_time_ns if frame else 0,
        "host_time_ns": frame.host_time_ns if frame else 0,
        "pixel_hash": 0,
    }
    topic = topics.frame_meta(side)
    bound = picture.parts if picture else ()
    data = sealed(topics.FRAME_META_TYPE.pack(values), topic.encode(), *bound)
    yield Message(topic, record.trigger, time_ns, data)
    if picture:
        yield picture


def _image(frame: Frame, header: Mapping[str, Any], trigger: int, side: Side) -> Message:
    """Return the picture's message, its pixels a view of the frame."""
    if frame.image.dtype != np.uint8 or frame.image.ndim != 2:
        raise ValueError(f"frame {frame.sequence} is not a uint8 picture of two dimensions")
    height, width = frame.image.shape
    pixels = np.ascontiguousarray(frame.image).reshape(-1).data
    head, tail = topics.IMAGE_TYPE.pack_head(
        {
            "header": header,
            "height": height,
            "width": width,
            "encoding": frame.pixel_format,
            "is_bigendian": 0,
            "step": width,
            "data": pixels,
        }
    )
    return Message(topics.image(side), trigger, frame.device_time_ns, head, summed(tail))


def _decision_messages(record: PairRecord, moment_ns: int) -> Iterator[Message]:
    for side in SIDES:
        decision: Decision | None = getattr(record.decisions, side)
        if decision is not None:
            values = {
                "header": _header(moment_ns, topics.optical_frame(side)),
                "trigger": record.trigger,
                "controller": decision.controller,
                "command": _command(decision.command),
                "latency_ms": decision.latency_ms,
                "diagnostics": [_diagnostic(*item) for item in decision.diagnostics.items()],
            }
            data = topics.DECISION_TYPE.pack(values)
            yield Message(topics.decision(side), record.trigger, moment_ns, data)


def _truth_messages(record: PairRecord, moment_ns: int) -> Iterator[Message]:
    truth = record.truth
    if truth is None:
        return
    header = _header(moment_ns, topics.WORLD_FRAME)
    pose = {
        "position": dict(zip("xyz", truth.position_m, strict=True)),
        "orientation": dict(zip("xyzw", truth.orientation_xyzw, strict=True)),
    }
    light = {"header": header, "light_cd_m2": truth.light_cd_m2}
    for topic, kind, values in (
        (topics.POSE, topics.POSE_TYPE, {"header": header, "pose": pose}),
        (topics.LIGHT, topics.LIGHT_TYPE, light),
    ):
        yield Message(topic, record.trigger, moment_ns, kind.pack(values))
    if truth.depth_m is not None:
        yield _depth_message(truth.depth_m, record.trigger, moment_ns)


def _depth_message(depth_m: NDArray[np.float32], trigger: int, moment_ns: int) -> Message:
    """Return a depth picture as REP 118 has it: metres, infinite where there is nothing."""
    height, width = depth_m.shape
    values = {
        "header": _header(moment_ns, topics.optical_frame("primary")),
        "height": height,
        "width": width,
        "encoding": DEPTH_ENCODING,
        "is_bigendian": 0,
        "step": 4 * width,
        "data": np.ascontiguousarray(depth_m, "<f4").tobytes(),
    }
    return Message(topics.DEPTH, trigger, moment_ns, topics.IMAGE_TYPE.pack(values))


def _pair_message(record: PairRecord, moment_ns: int) -> Message:
    values = {
        "header": _header(moment_ns, ""),
        "sequence": record.trigger,
        "pose_index": record.pose_index,
        "complete": record.complete,
        "cause": record.cause,
        "offset_known": record.offset_ns is not None,
        "offset_ns": record.offset_ns or 0,
        "chain_hash": 0,
    }
    return Message(topics.PAIR, record.trigger, moment_ns, topics.PAIR_TYPE.pack(values))


def _header(time_ns: int, frame_id: str) -> dict[str, Any]:
    if time_ns < 0:
        raise ValueError(f"time {time_ns} ns is before the run's clock began")
    sec, nanosec = divmod(time_ns, NS_PER_S)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def _settings(settings: Settings | None) -> dict[str, float]:
    if settings is None:
        return {"exposure_us": NAN, "gain_db": NAN}
    return {"exposure_us": settings.exposure_us, "gain_db": settings.gain_db}


def _command(command: Command) -> dict[str, Any]:
    auto = command if isinstance(command, Auto) else None
    exposure_us, gain_db = (
        (auto.limits.exposure_us, auto.limits.gain_db) if auto else ((NAN, NAN), (NAN, NAN))
    )
    return {
        "mode": "auto" if auto else "settings",
        "settings": _settings(command.start if isinstance(command, Auto) else command),
        "exposure_us_lo": exposure_us[0],
        "exposure_us_hi": exposure_us[1],
        "gain_db_lo": gain_db[0],
        "gain_db_hi": gain_db[1],
        "target_dn": auto.target_dn if auto else NAN,
        "damping": auto.damping if auto else NAN,
        "metering": auto.metering if auto else "",
        "priority": auto.priority if auto else "",
    }


def _diagnostic(key: str, value: float | str) -> dict[str, Any]:
    is_number = isinstance(value, numbers.Real)
    return {
        "key": key,
        "is_number": is_number,
        "number": float(value) if is_number else NAN,
        "text": "" if is_number else str(value),
    }


def decode(messages: Mapping[str, Message]) -> PairRecord:
    """Return the record that the messages of one trigger, by topic, hold.

    Images are views into the messages. Raises KeyError, ValueError or struct.error for messages
    that `encode` could not have written.
    """
    pair = topics.PAIR_TYPE.unpack(messages[topics.PAIR].data)
    metas = Pair(
        *(topics.FRAME_META_TYPE.unpack(messages[topics.frame_meta(s)].data) for s in SIDES)
    )
    if bool(pair["complete"]) != (pair["cause"] == ""):
        raise ValueError(f"trigger {pair['sequence']} is complete with cause {pair['cause']!r}")
    return PairRecord(
        trigger=pair["sequence"],
        pose_index=pair["pose_index"],
        asked=Pair(*(_to_command(meta["asked"]) for meta in metas)),
        applied=Pair(*(_to_command(meta["applied"]) for meta in metas)),
        shot=Pair(
            *(
                to_shot(meta, messages.get(topics.image(s)), s)
                for meta, s in zip(metas, SIDES, strict=True)
            )
        ),
        decisions=Pair(*(_to_decision(messages.get(topics.decision(s))) for s in SIDES)),
        offset_ns=pair["offset_ns"] if pair["offset_known"] else None,
        cause=pair["cause"],
        truth=_to_truth(*map(messages.get, (topics.POSE, topics.LIGHT, topics.DEPTH))),
    )


def to_shot(meta: Mapping[str, Any], picture: Message | None, side: Side) -> Frame | Lost:
    """Return the frame, or the lost one, that a frame's settings and its picture tell of.

    Raises ValueError when they do not fit.
    """
    status: Literal["taken", "lost"] = meta["status"]
    if status == "lost" and picture is None:
        return Lost(meta["frame_id"], meta["cause"])
    if status != "taken" or picture is None:
        found = "without" if picture is None else "with"
        raise ValueError(
            f"{side} frame of trigger {meta['trigger']} is {status!r} {found} a picture"
        )
    image = topics.IMAGE_TYPE.unpack(picture.data)
    if image["encoding"] not in PIXEL_FORMATS or image["step"] != image["width"]:
        raise ValueError(f"{side} picture of trigger {meta['trigger']} is {image['encoding']!r}")
    pixels = np.frombuffer(image["data"], dtype=np.uint8)
    return Frame(
        image=pixels.reshape(image["height"], image["width"]),
        pixel_format=image["encoding"],
        sequence=meta["frame_id"],
        device_time_ns=meta["device_time_ns"],
        host_time_ns=meta["host_time_ns"],
        used=_to_settings(meta["used"]),
    )


def _to_settings(values: Mapping[str, float]) -> Settings:
    return Settings(values["exposure_us"], values["gain_db"])


def _to_command(values: Mapping[str, Any]) -> Command:
    settings = _to_settings(values["settings"])
    if values["mode"] == "settings":
        return settings
    if values["mode"] != "auto":
        raise ValueError(f"{values['mode']!r} is no mode of a command")
    exposure_us = (values["exposure_us_lo"], values["exposure_us_hi"])
    gain_db = (values["gain_db_lo"], values["gain_db_hi"])
    return Auto(
        Limits(exposure_us, gain_db),
        values["target_dn"],
        values["damping"],
        settings,
        values["metering"],
        values["priority"],
    )


def _to_decision(message: Message | None) -> Decision | None:
    if message is None:
        return None
    values = topics.DECISION_TYPE.unpack(message.data)
    diagnostics: Diagnostics = {
        each["key"]: each["number"] if each["is_number"] else each["text"]
        for each in values["diagnostics"]
    }
    command = _to_command(values["command"])
    return Decision(values["controller"], command, values["latency_ms"], diagnostics)


def _to_truth(pose: Message | None, light: Message | None, depth: Message | None) -> Truth | None:
    if pose is None or light is None:
        return None
    where = topics.POSE_TYPE.unpack(pose.data)["pose"]
    position, orientation = where["position"], where["orientation"]
    return Truth(
        (position["x"], position["y"], position["z"]),
        (orientation["x"], orientation["y"], orientation["z"], orientation["w"]),
        topics.LIGHT_TYPE.unpack(light.data)["light_cd_m2"],
        None if depth is None else _to_depth(depth),
    )


def _to_depth(message: Message) -> NDArray[np.float32]:
    image = topics.IMAGE_TYPE.unpack(message.data)
    if image["encoding"] != DEPTH_ENCODING or image["step"] != 4 * image["width"]:
        raise ValueError(f"the depth of trigger {message.sequence} is {image['encoding']!r}")
    depth_m = np.frombuffer(image["data"], "<f4")
    return depth_m.reshape(image["height"], image["width"])
