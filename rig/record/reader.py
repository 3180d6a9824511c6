"""Opens a recording and gives its triggers back, one at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode

from rig.core.errors import RecordingError
from rig.core.types import PairRecord
from rig.record import codec, topics
from rig.record.codec import Message
from rig.record.container import Container, Summary, damage, find
from rig.record.header import RUN, RunHeader, from_parts


@dataclass(frozen=True, slots=True)
class Recording:
    """A finished recording; its length is the number of triggers."""

    path: Path
    header: RunHeader
    metadata: Mapping[str, Mapping[str, str]]
    triggers: int

    def __len__(self) -> int:
        return self.triggers

    def records(self) -> Iterator[PairRecord]:
        """Yield every trigger in order, holding one chunk at a time in memory.

        The pictures are writable and share the chunk's memory. Raises RecordingDamaged at the
        first thing that is not as it was written.
        """
        with damage(self.path), Container(self.path) as container:
            count = 0
            for group in triggers(container.messages()):
                yield codec.decode(group)
                count += 1
            if count != self.triggers:
                raise ValueError(f"{self.triggers} triggers claimed, {count} found")


def open_recording(path: Path | str) -> Recording:
    """Open a recording by its folder, its `.mcap` file or its `metadata.yaml`.

    Raises RecordingError when there is none, RecordingDamaged when it is cut short or corrupt.
    """
    file = find(Path(path))
    with damage(file), Container(file) as container:
        summary = container.summary()
        metadata = {
            m.name: container.at(m.offset, Opcode.METADATA).metadata for m in summary.metadata
        }
        if RUN not in metadata:
            raise RecordingError(f"{file} was not recorded by rig; it has no {RUN} metadata")
        header = from_parts(metadata, _attachments(container, summary))
        return Recording(file, header, metadata, summary.messages(topics.PAIR))


def triggers(messages: Iterable[Message]) -> Iterator[dict[str, Message]]:
    """Yield the messages of each trigger by topic; `/pair` closes a trigger.

    Raises ValueError when triggers are mixed or not closed, or a topic is there twice.
    """
    group: dict[str, Message] = {}
    for message in messages:
        if message.topic in topics.PER_RUN:
            continue
        if message.topic in group:
            raise ValueError(f"trigger {message.sequence} has {message.topic} twice")
        group[message.topic] = message
        if message.topic == topics.PAIR:
            if any(each.sequence != message.sequence for each in group.values()):
                raise ValueError(f"trigger {message.sequence} is mixed with another one")
            yield group
            group = {}
    if group:
        raise ValueError(f"trigger {next(iter(group.values())).sequence} is not closed by /pair")


def _attachments(container: Container, summary: Summary) -> dict[str, bytes]:
    return {
        index.name: container.at(index.offset, Opcode.ATTACHMENT).data
        for index in summary.attachments
    }
