"""Opens a recording and gives its triggers back, one at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, MetadataIndex

from rig.core.errors import RecordingDamaged, RecordingError
from rig.core.types import PairRecord
from rig.record import codec, topics
from rig.record.codec import Message
from rig.record.container import Container, damage, find, parts
from rig.record.header import (
    ATTACHMENTS,
    METADATA,
    NEXT,
    PART,
    RECOVERY,
    RUN,
    RunHeader,
    from_parts,
)


@dataclass(frozen=True, slots=True)
class Recording:
    """A finished recording; its length is the number of triggers.

    `parts` are its files in order, `path` is the first of them; `metadata` is that of the first
    part with what later parts add at their ends.
    """

    path: Path
    header: RunHeader
    metadata: Mapping[str, Mapping[str, str]]
    triggers: int
    parts: tuple[Path, ...]

    def __len__(self) -> int:
        return self.triggers

    def records(self) -> Iterator[PairRecord]:
        """Yield every trigger in order, holding one chunk at a time in memory.

        The pictures are writable and share the chunk's memory. Raises RecordingDamaged at the
        first thing that is not as it was written.
        """
        count = 0
        for part in self.parts:
            with damage(part), Container(part) as container:
                for group in triggers(container.messages()):
                    yield codec.decode(group)
                    count += 1
        if count != self.triggers:
            raise RecordingDamaged(
                f"{self.path} claims {self.triggers} triggers and holds {count}; "
                f"try: rig recover {self.path}"
            )


def open_recording(path: Path | str) -> Recording:
    """Open a recording by its folder, its `.mcap` file or its `metadata.yaml`.

    Raises RecordingError when there is none, RecordingDamaged when it is cut short or corrupt.
    """
    first = find(Path(path))
    files = parts(first)
    opened = [_open_part(file) for file in files]
    for file, part in zip(files, opened, strict=True):
        if part.header != opened[0].header:
            raise RecordingError(f"{file} is of another run than {first}; keep runs apart")
    metadata = dict(opened[0].metadata)
    for part in opened[1:]:
        metadata |= {name: part.metadata[name] for name in part.metadata if name not in (PART,)}
    _check_end(files[-1], opened[-1].metadata)
    count = sum(part.triggers for part in opened)
    return Recording(first, opened[0].header, metadata, count, tuple(files))


@dataclass(frozen=True, slots=True)
class _OpenedPart:
    """What one file of a run says about itself."""

    header: RunHeader
    metadata: Mapping[str, Mapping[str, str]]
    triggers: int


def _open_part(file: Path) -> _OpenedPart:
    with damage(file), Container(file) as container:
        summary = container.summary()
        metadata = metadata_of(container, summary.metadata)
        if RUN not in metadata:
            raise RecordingError(f"{file} was not recorded by rig; it has no {RUN} metadata")
        header = from_parts(metadata, attachments_of(container, summary.attachments))
        return _OpenedPart(header, metadata, summary.messages(topics.PAIR))


def _check_end(file: Path, metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Raise RecordingError when the last part says that another one follows."""
    if NEXT in metadata and RECOVERY not in metadata:
        following = metadata[NEXT].get("file", "another file")
        raise RecordingError(
            f"{file.with_name(following)} is missing, {file.name} goes on in it; put the parts of "
            "a run into one folder"
        )


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


def metadata_of(
    container: Container, indexes: Iterable[MetadataIndex]
) -> dict[str, dict[str, str]]:
    """Return the run's metadata records by name, of those that an index tells of."""
    found = {each.name: each.offset for each in indexes if each.name in METADATA}
    return {name: container.at(at, Opcode.METADATA).metadata for name, at in found.items()}


def attachments_of(container: Container, indexes: Iterable[AttachmentIndex]) -> dict[str, bytes]:
    """Return the contents of the run's attachments by name, of those that an index tells of."""
    found = {each.name: each.offset for each in indexes if each.name in ATTACHMENTS}
    return {name: container.at(at, Opcode.ATTACHMENT).data for name, at in found.items()}
