"""Recomputes every claim of a recording from its bytes."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rig.core.errors import RecordingDamaged
from rig.core.types import MAX_PAIR_OFFSET_NS, SIDES, Frame, Intrinsics, Lost, PairRecord, Side
from rig.core.units import NS_PER_S
from rig.record import codec, topics, totals
from rig.record.codec import Message
from rig.record.container import Container, Summary, damage
from rig.record.hashes import seal_holds
from rig.record.header import PART, RECOVERY, header_hash
from rig.record.reader import Recording, metadata_of, open_recording, triggers
from rig.record.totals import Totals

_MAX_CLAIMS = 100


@dataclass(frozen=True, slots=True)
class Verification:
    """What the bytes say: `pairs` complete, `lost` by cause, and every claim that is false."""

    sound: bool
    pairs: int
    lost: Mapping[str, int]
    false_claims: list[str]


def verify(path: Path | str) -> Verification:
    """Recompute pictures, pairing, order and accounting of a recording.

    At most 100 false claims are listed. Raises RecordingError when there is no recording,
    RecordingDamaged when it is cut or has no readable index.
    """
    recording = open_recording(path)
    audit = _Audit(recording, chain=header_hash(recording.header))
    for part in recording.parts:
        with damage(part), Container(part) as container:
            audit.begin(container)
            try:
                with damage(part):
                    for group in triggers(audit.seen(container.messages())):
                        audit.trigger(group)
            except RecordingDamaged as error:
                audit.claims.append(f"after {audit.totals.triggers} triggers: {error.__cause__}")
            audit.end_part(container.summary())
    audit.end()
    claims = audit.claims[:_MAX_CLAIMS]
    return Verification(not claims, audit.totals.complete, audit.totals.lost, claims)


@dataclass(slots=True)
class _Audit:
    """Goes through a recording once and collects what is false."""

    recording: Recording
    chain: int
    claims: list[str] = field(default_factory=list)
    totals: Totals = field(default_factory=Totals)
    counts: Counter[str] = field(default_factory=Counter)
    expected: int = 0
    times_ns: dict[Side, int] = field(default_factory=dict)

    def seen(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Pass messages on, counted, with those that belong to no trigger checked."""
        for message in messages:
            self.counts[message.topic] += 1
            if message.log_time_ns != _stamp_ns(message):
                self.claims.append(f"{message.topic} {message.sequence} is logged at another time")
            if message.topic in topics.PER_RUN:
                self.claims += _camera_info(message, self.recording)
            yield message

    def trigger(self, group: Mapping[str, Message]) -> None:
        """Check one trigger against itself and against the one before."""
        pair = group[topics.PAIR]
        number = pair.sequence
        if number != self.expected:
            self._false(number, f"follows trigger {self.expected - 1}")
        self.expected = number + 1
        if not _chain_holds(self.chain, group):
            self._false(number, "its messages or their order are not those that were recorded")
        self.chain = codec.chain_hash(pair)
        for side in SIDES:
            if not _frame_holds(side, group):
                self._false(number, f"the {side} picture does not belong to its settings")
        try:
            record = codec.decode(group)
        except (ValueError, KeyError, struct.error) as error:
            self._false(number, f"cannot be decoded: {error}")
            return
        self.totals.add(record.cause)
        for claim in (*_numbers(record, number), *_pairing(record), *self._frames(record)):
            self._false(number, claim)

    def begin(self, container: Container) -> None:
        """Check that a later part goes on where the one before ended."""
        metadata = metadata_of(container, container.summary().metadata)
        if PART in metadata and metadata[PART]["chain"] != f"{self.chain:016x}":
            self.claims.append(f"{container.path.name} does not go on from the part before")

    def end_part(self, summary: Summary) -> None:
        """Check the counts that a file claims for itself."""
        for topic in topics.TOPICS:
            claimed, found = summary.messages(topic), self.counts[topic]
            if claimed != found:
                self.claims.append(f"the index claims {claimed} messages on {topic}, {found} found")
        self.counts.clear()

    def end(self) -> None:
        """Check the counts that the last file claims for the whole run."""
        metadata = self.recording.metadata
        if totals.NAME in metadata:
            try:
                claimed_totals = Totals.from_metadata(metadata[totals.NAME])
            except (KeyError, ValueError) as error:
                self.claims.append(f"the totals of the run cannot be read: {error}")
                return
            if claimed_totals != self.totals:
                self.claims.append(f"the run claims {claimed_totals}, found {self.totals}")
        elif RECOVERY not in metadata:
            self.claims.append("the run did not say how many triggers it had")

    def _frames(self, record: PairRecord) -> Iterator[str]:
        for side, shot, intrinsics in zip(
            SIDES, record.shot, self.recording.header.intrinsics, strict=True
        ):
            if isinstance(shot, Lost):
                if not shot.cause:
                    yield f"the {side} frame is lost without a cause"
                continue
            if shot.image.shape != (intrinsics.height_px, intrinsics.width_px):
                yield f"the {side} picture has {shot.image.shape}, not the size of its intrinsics"
            if shot.device_time_ns <= self.times_ns.get(side, -1):
                yield f"the {side} frame is not later than the one before"
            self.times_ns[side] = shot.device_time_ns

    def _false(self, trigger: int, claim: str) -> None:
        self.claims.append(f"trigger {trigger}: {claim}")


def _chain_holds(previous: int, group: Mapping[str, Message]) -> bool:
    pictures = {topics.image(side) for side in SIDES}
    small = [m for topic, m in group.items() if topic not in pictures and topic != topics.PAIR]
    return seal_holds(group[topics.PAIR].data, *codec.chain_parts(previous, small))


def _frame_holds(side: Side, group: Mapping[str, Message]) -> bool:
    topic, picture = topics.frame_meta(side), group.get(topics.image(side))
    if topic not in group:
        return False
    return seal_holds(group[topic].data, topic.encode(), picture.data if picture else b"")


def _numbers(record: PairRecord, number: int) -> Iterator[str]:
    if record.trigger != number:
        yield f"/pair says it is trigger {record.trigger}"
    for side, shot in zip(SIDES, record.shot, strict=True):
        if record.complete and shot.sequence != number:
            yield f"the {side} frame is number {shot.sequence}"


def _pairing(record: PairRecord) -> Iterator[str]:
    primary, secondary = record.shot
    if not (isinstance(primary, Frame) and isinstance(secondary, Frame)):
        if record.complete:
            yield "complete, but a frame is missing"
        if record.offset_ns is not None:
            yield f"offset {record.offset_ns} ns, but a frame is missing"
        return
    offset_ns = secondary.device_time_ns - primary.device_time_ns
    if record.offset_ns != offset_ns:
        yield f"offset {record.offset_ns} ns, the frames are {offset_ns} ns apart"
    if record.complete and abs(offset_ns) > MAX_PAIR_OFFSET_NS:
        yield f"complete, but the frames are {offset_ns} ns apart, over {MAX_PAIR_OFFSET_NS}"


def _camera_info(message: Message, recording: Recording) -> Iterator[str]:
    side: Side = "primary" if message.topic == topics.camera_info("primary") else "secondary"
    intrinsics: Intrinsics = getattr(recording.header.intrinsics, side)
    expected = codec.camera_info(side, intrinsics, message.log_time_ns)
    if bytes(message.data) != expected.data:
        yield f"{message.topic} differs from the run's metadata"


def _stamp_ns(message: Message) -> int:
    """Return the time in the header with which every message of a recording begins."""
    sec, nanosec = struct.unpack_from("<iI", message.data, 4)
    return int(sec) * NS_PER_S + int(nanosec)
