"""Pictures that are too many to hold in memory, until the file that they go to can be written."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


class Spool:
    """Pictures in a file without a name in `folder`: it is gone with the process, however it ends.

    The folder must be there; None is the system's for such files. Raises OSError when its disk is
    full.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - see close

    def append(self, images: NDArray[np.uint8]) -> None:
        """Put pictures, N x ..., behind those that are there."""
        self._file.write(np.ascontiguousarray(images).data)

    def pictures(self, *shape: int) -> NDArray[np.uint8]:
        """Return all pictures, -1 x `shape`, read-only and mapped from the file."""
        self._file.flush()
        return np.memmap(self._file, np.uint8, "r").reshape(-1, *shape)

    def close(self) -> None:
        """Let go of the file; pictures that are mapped stay."""
        self._file.close()
