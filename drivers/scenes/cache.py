"""Where slow results are kept between runs: arrays by key in the user's cache folder."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import platformdirs
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]


def cache_folder() -> Path:
    """Return RIG_CACHE_DIR where it is set, else the user's cache folder for `rig`."""
    named = os.environ.get("RIG_CACHE_DIR")
    return Path(named) if named else Path(platformdirs.user_cache_dir("rig"))


def cached(kind: str, key: str, make: Callable[[], Arrays]) -> Arrays:
    """Return the arrays stored under `key`, or make and store them.

    `key` names everything that the arrays depend on. A damaged file is made again; two
    processes may make the same file at once, the last one to finish wins with the same bytes.
    """
    digest = hashlib.sha256(key.encode()).hexdigest()[:24]
    path = cache_folder() / kind / f"{digest}.npz"
    arrays = _load(path)
    if arrays is None:
        arrays = make()
        _store(path, arrays)
    return arrays


def _load(path: Path) -> Arrays | None:
    try:
        with path.open("rb") as file, np.load(file) as stored:
            return dict(stored)
    except (FileNotFoundError, ValueError, EOFError, zipfile.BadZipFile):
        return None


def _store(path: Path, arrays: Arrays) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
        np.savez(part, **arrays)  # type: ignore[arg-type]
    Path(part.name).replace(path)
