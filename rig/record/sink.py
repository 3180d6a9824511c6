"""The files of a run while it is being written."""

from __future__ import annotations

import errno
from pathlib import Path

from rig.core.types import PairRecord
from rig.record import codec
from rig.record.container import part_path
from rig.record.header import NEXT, PART, RunHeader, header_hash
from rig.record.part import Part
from rig.record.totals import NAME, Totals

CHUNK_BYTES = 1 << 20
CHUNK_S = 0.25
PART_BYTES = 16 << 30
_RESERVE_BYTES = 8 << 20


class Sink:
    """Puts triggers into chunks that hold whole triggers only, so that a cut never splits one.

    A chunk closes with the first trigger that fills it to 1 MiB, a `live` one also when it is a
    quarter of a second old; a file with the first trigger that fills it to 16 GiB: the run then
    goes on in `run_1.mcap` and so on. OSError from any method but `close_file` leaves a file that
    ends in an unfinished record: close it and recover it.
    """

    def __init__(self, path: Path, header: RunHeader, *, live: bool) -> None:
        self._path = path
        self._header = header
        self._live = live
        self._last = codec.Tie(chain=header_hash(header))
        self._totals = Totals()
        self._number = 0
        self._part = self._open({})

    @property
    def triggers(self) -> int:
        """Return the number of triggers written."""
        return self._totals.triggers

    @property
    def full(self) -> bool:
        """Return whether the disk is full and only the room kept back is left."""
        return self._part.full

    def take(self, record: PairRecord) -> None:
        """Write one trigger; raises ValueError, with nothing written, for what cannot be packed."""
        messages, last = codec.encode(record, self._last)
        if self._part.size >= PART_BYTES and not self.full:
            self._split()
        self._last = last
        self._part.take(messages, last.time_ns, CHUNK_BYTES)
        self._totals.add(record.cause)
        self.hand_over()

    def hand_over(self) -> None:
        """Give the disk what it has not got for a while, so that lost power costs little."""
        if self._live:
            self._part.close_older_than(CHUNK_S)

    def finish(self) -> None:
        """Write the last chunk, the totals and the index."""
        self._part.finish(self._last.time_ns, NAME, self._totals.to_metadata())

    def close_file(self) -> None:
        """Bring the last file to the disk; raises OSError."""
        self._part.close()

    def _open(self, facts: dict[str, dict[str, str]]) -> Part:
        return Part(
            part_path(self._path, self._number),
            self._header,
            facts,
            reserve_bytes=_RESERVE_BYTES,
            live=self._live,
        )

    def _split(self) -> None:
        """Go on in a new file; without room for one the old one simply grows."""
        number = self._number + 1
        tie = {
            "number": str(number),
            "first_trigger": str(self.triggers),
            "chain": f"{self._last.chain:016x}",
        }
        before = self._part
        self._number = number
        try:
            self._part = self._open({PART: tie})
        except OSError as error:
            self._number = number - 1
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            return
        try:
            before.finish(self._last.time_ns, NEXT, {"file": self._part.path.name})
        finally:
            before.close()
