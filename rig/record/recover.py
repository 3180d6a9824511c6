"""Makes a recording readable again that was cut by a crash, a full disk or lost power."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode

from rig.core.errors import RecordingDamaged, RecordingError
from rig.record import bag, container, header, topics, totals
from rig.record.container import MAGIC, Container, damage
from rig.record.file import give_back, is_held, reserve_path
from rig.record.header import NEXT, RECOVERY
from rig.record.index import Index
from rig.record.reader import attachments_of, metadata_of
from rig.record.scan import Scan

_BEGUN_BYTES = 1 << 20
"""What is known of a run before its first trigger takes a few kilobytes."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """What `recover` found: nothing was changed unless `repaired`."""

    repaired: bool
    triggers: int
    chunks: int
    skipped_chunks: int
    dropped_bytes: int


def recover(path: Path | str) -> Recovery:
    """Repair a recording in place: keep every whole chunk, drop the cut tail, write the index.

    A chunk whose checksum is wrong and a stretch that cannot be read are hidden from readers, not
    removed, where more than two seconds of a run follow. An intact file is left alone. Raises
    RecordingError when it cannot be read or written or is being recorded, RecordingDamaged, with
    nothing changed, when it is no recording or is more than cut.
    """
    first = container.find(Path(path))
    files = container.parts(first)
    for file in files:
        if is_held(file):
            raise RecordingError(f"{file} is being recorded; end that run first")
    try:
        found = list(_recover_parts(files))
        bag.describe(first)
    except OSError as error:
        raise RecordingError(
            f"cannot repair {first}: {error.strerror}; make the disk writable, with a few MB free, "
            f"and run: rig recover {first}"
        ) from error
    return Recovery(
        repaired=any(each.repaired for each in found),
        triggers=sum(each.triggers for each in found),
        chunks=sum(each.chunks for each in found),
        skipped_chunks=sum(each.skipped_chunks for each in found),
        dropped_bytes=sum(each.dropped_bytes for each in found),
    )


def repair_left_behind(runs: Path) -> Iterator[tuple[Path, Recovery | RecordingError]]:
    """Repair each recording below the folder `runs` whose recorder was killed.

    Yields each with what was found, or with why it could not be repaired; one that is damaged
    gives its reserved room back and is not tried again.
    """
    for reserve in sorted(runs.glob("*/*.mcap.reserve")):
        file = reserve.with_suffix("")
        if is_held(file) or not file.exists():
            continue
        first = container.first_part(file)
        try:
            yield first, recover(first)
        except RecordingDamaged as error:
            with suppress(OSError):
                reserve_path(file).unlink()
            yield first, error
        except RecordingError as error:
            yield first, error


def _recover_parts(files: list[Path]) -> Iterator[Recovery]:
    """Repair each file; one that was begun and holds no trigger yet is taken away.

    Its first trigger follows one that may be lost with the end of the file before.
    """
    last = len(files) - 1
    if last > 0 and _holds_no_trigger(files[last]):
        dropped = files[last].stat().st_size
        files[last].unlink()
        reserve_path(files[last]).unlink(missing_ok=True)
        yield Recovery(True, 0, 0, 0, dropped)
        files, last = files[:last], last - 1
    for number, file in enumerate(files):
        yield _recover_file(file, is_last=number == last)


def _holds_no_trigger(file: Path) -> bool:
    """Return whether a later part was cut before its first chunk, as a crash leaves it."""
    size = file.stat().st_size
    if size > _BEGUN_BYTES or (size > len(MAGIC) and file.read_bytes().endswith(MAGIC)):
        return False
    try:
        with damage(file), Container(file) as source:
            found = any(extent.opcode == Opcode.CHUNK for extent in source.extents())
            return not found and Scan(source).next_chunk(0) is None
    except RecordingDamaged:
        return True


def _recover_file(file: Path, *, is_last: bool) -> Recovery:
    with damage(file, "nothing was changed"), Container(file) as source:
        scan = Scan(source)
        scan.run()
        _check_header(source, scan.index)
        _check_channels(source, scan.index)
        triggers = scan.index.count(topics.PAIR)
        ending = scan.index.ending(scan.end, _note(scan, triggers, is_last=is_last))
        intact = not scan.patches and source.bytes_at(scan.end, len(ending) + 1) == ending
        dropped = 0 if intact else scan.unreadable_bytes()
    if not intact:
        give_back(file)
        _rewrite(file, scan.patches, scan.end, ending)
    reserve_path(file).unlink(missing_ok=True)
    return Recovery(not intact, triggers, scan.index.chunks, scan.skipped_chunks, dropped)


def _check_header(source: Container, index: Index) -> None:
    """Raise RecordingDamaged or ValueError when the file does not say what run it is of."""
    missing = header.NEEDED - index.metadata_names - index.attachment_names
    if missing:
        raise RecordingDamaged(
            f"{source.path} ends before the run's first trigger or has lost its {min(missing)}; "
            "nothing to recover"
        )
    metadata = metadata_of(source, index.metadata)
    header.from_parts(metadata, attachments_of(source, index.attachments))


def _check_channels(source: Container, index: Index) -> None:
    """Raise RecordingDamaged when nothing tells any more what some messages are about."""
    if not index.counts.keys() <= index.channels.keys():
        raise RecordingDamaged(
            f"{source.path} has lost its first chunk, which names the topics, and its index, which "
            "names them too; nothing was changed"
        )


def _note(scan: Scan, triggers: int, *, is_last: bool) -> tuple[str, dict[str, str]] | None:
    """Return a metadata record that says so when triggers may be missing; nothing otherwise."""
    ends_well = {RECOVERY, totals.NAME} if is_last else {RECOVERY, totals.NAME, NEXT}
    if not scan.skipped_chunks and scan.index.metadata_names & ends_well:
        return None
    return RECOVERY, {"triggers": str(triggers), "skipped_chunks": str(scan.skipped_chunks)}


def _rewrite(path: Path, patches: list[tuple[int, bytes]], end: int, ending: bytes) -> None:
    with path.open("r+b", buffering=0) as file:
        for start, data in patches:
            os.pwrite(file.fileno(), data, start)
        file.truncate(end)
        file.seek(end)
        while ending:
            ending = ending[file.write(ending) :]
        os.fsync(file.fileno())
