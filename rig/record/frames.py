"""Any frame of a recording at once, for training and looking: nothing else is read."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any, Self

from mcap.opcode import Opcode

from rig.core.errors import UsageError
from rig.core.types import SIDES, Frame, Lost, Side
from rig.record import codec, topics
from rig.record.codec import Message
from rig.record.container import (
    CHUNK_HEAD_BYTES,
    MESSAGE_HEADER,
    RECORD_HEADER,
    ChunkPlace,
    Container,
    Extent,
    damage,
    plain_chunk_bytes,
    read_chunk,
)
from rig.record.hashes import seal_holds
from rig.record.reader import Recording, open_recording

_HEAD_BYTES = RECORD_HEADER.size + MESSAGE_HEADER.size
_FIRST_GUESS_BYTES = 1 << 12
_SLACK_BYTES = 256


class Frames:
    """Random access to the frames of a recording by their place in it, counted from 0.

    That is the number of their trigger, but behind what a repair has hidden. Opening reads the
    index, some 30 bytes a frame; a frame costs one read and the check of its pixel hash. Use it in
    a `with` block; one thread at a time.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a recording; raises RecordingError like `open_recording`."""
        self.recording: Recording = open_recording(path)
        self._files: list[_File] = []
        try:
            for part in self.recording.parts:
                with damage(part):
                    self._files.append(_File(part))
        except BaseException:
            self.close()
            raise
        self._counts = [file.triggers for file in self._files]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __len__(self) -> int:
        return sum(self._counts)

    def close(self) -> None:
        """Close the files; closing twice is harmless."""
        for file in self._files:
            file.container.close()

    def frame(self, trigger: int, side: Side) -> Frame | Lost:
        """Return one camera's frame, or why it did not come.

        Raises UsageError for a trigger that there is not, RecordingDamaged when the frame is not
        as it was recorded.
        """
        file, index = self._find(trigger)
        with damage(file.container.path):
            return file.frame(index, side)

    def about(self, trigger: int, topic: str) -> dict[str, Any]:
        """Return the small message on `topic`, `/pair` or a frame's settings, without pictures.

        It is not checked against its seal. Raises like `frame`.
        """
        file, index = self._find(trigger)
        with damage(file.container.path):
            return file.about(index, topic)

    def _find(self, trigger: int) -> tuple[_File, int]:
        index = trigger
        for file, count in zip(self._files, self._counts, strict=True):
            if 0 <= index < count:
                return file, index
            index -= count
        raise UsageError(f"{self.recording.path} has no trigger {trigger}, it has {len(self)}")


class _File:
    """One part: where the settings of each frame lie, its picture right behind them."""

    def __init__(self, path: Path) -> None:
        self.container = Container(path)
        summary = self.container.summary()
        wanted = [*map(topics.frame_meta, SIDES), topics.PAIR]
        self._chunks = list(summary.chunks(wanted))
        self._places = {topic: self._find(topic) for topic in wanted}
        counts = {len(chunk) for chunk, _ in self._places.values()}
        if counts != {summary.messages(topics.PAIR)}:
            raise ValueError("the index does not hold the settings of each frame")
        (self.triggers,) = counts
        self._guess_bytes = _FIRST_GUESS_BYTES

    def frame(self, index: int, side: Side) -> Frame | Lost:
        chunks, offsets = self._places[topics.frame_meta(side)]
        chunk = self._chunks[chunks[index]]
        data = self._records(chunk, offsets[index], self._guess_bytes, count=1)
        meta, end = _message(data, 0, topics.frame_meta(side))
        values = topics.FRAME_META_TYPE.unpack(meta.data)
        picture = None
        if values["status"] == "taken":
            needed = _bytes_of(2, data)
            if needed > len(data):
                data = self._records(chunk, offsets[index], needed, count=2)
            picture, end = _message(data, end, topics.image(side))
            self._guess_bytes = end + _SLACK_BYTES
        bound = picture.data if picture else b""
        if not seal_holds(meta.data, meta.topic.encode(), bound):
            raise ValueError(f"the {side} picture of trigger {index} is not the one recorded")
        return codec.to_shot(values, picture, side)

    def about(self, index: int, topic: str) -> dict[str, Any]:
        chunks, offsets = self._places[topic]
        chunk = self._chunks[chunks[index]]
        data = self._records(chunk, offsets[index], _FIRST_GUESS_BYTES, count=1)
        message, _ = _message(data, 0, topic)
        return topics.TOPICS[topic].unpack(message.data)

    def _records(
        self, chunk: ChunkPlace, offset: int, guess_bytes: int, *, count: int
    ) -> memoryview:
        """Return the bytes from a message on: it and those behind it, at least `count`."""
        head = self.container.bytes_at(chunk.start, RECORD_HEADER.size + CHUNK_HEAD_BYTES)
        extent = Extent(Opcode.CHUNK, chunk.start, chunk.size)
        if plain_chunk_bytes(head) is None:
            return read_chunk(self.container.body(extent)).records[offset:]
        start = chunk.start + RECORD_HEADER.size + CHUNK_HEAD_BYTES + offset
        data = self.container.buffer_at(start, min(guess_bytes, extent.end - start))
        while (needed := _bytes_of(count, data)) > len(data):
            if needed > extent.end - start:
                raise ValueError(f"the message at byte {start} runs over the end of its chunk")
            data = self.container.buffer_at(start, needed)
        return memoryview(data)

    def _find(self, topic: str) -> tuple[array[int], array[int]]:
        """Return chunk number and offset of every message on a topic."""
        numbers, offsets = array("Q"), array("Q")
        for number, chunk in enumerate(self._chunks):
            found = self.container.message_offsets(chunk, topic)
            offsets.extend(found)
            numbers.extend([number] * len(found))
        return numbers, offsets


def _bytes_of(count: int, data: bytearray | memoryview) -> int:
    """Return how long the first `count` records are, or as much of that as `data` tells."""
    at = 0
    for _ in range(count):
        if at + RECORD_HEADER.size > len(data):
            return at + RECORD_HEADER.size
        _, length = RECORD_HEADER.unpack_from(data, at)
        at += RECORD_HEADER.size + length
    return at


def _message(data: memoryview, at: int, topic: str) -> tuple[Message, int]:
    opcode, length = RECORD_HEADER.unpack_from(data, at)
    end = at + RECORD_HEADER.size + length
    if opcode != Opcode.MESSAGE or length < MESSAGE_HEADER.size or end > len(data):
        raise ValueError(f"there is no message on {topic} where the index says")
    _, sequence, time_ns, _ = MESSAGE_HEADER.unpack_from(data, at + RECORD_HEADER.size)
    return Message(topic, sequence, time_ns, data[at + _HEAD_BYTES : end]), end
