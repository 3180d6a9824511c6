"""`rig collect --seeds`: a recording for each world in one folder, and a manifest of them all."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from rig.bulk import Workers, run_tasks
from rig.cli.collect import Collection, collect_drive
from rig.cli.exits import LOSSES, OK
from rig.cli.options import RunOptions, chosen_cameras, refuse_own_seed
from rig.cli.race import parse_seeds
from rig.cli.terminal import Terminal
from rig.cli.web import DEFAULT_WEB
from rig.core.errors import RigError, UsageError
from rig.drivers.addresses import parse_address

MANIFEST = "manifest.json"
SCHEMA = "rig.manifest/1"

Entry = dict[str, Any]


def collect_many(
    wanted: Collection, seeds: str, workers: int | None, run: RunOptions, terminal: Terminal
) -> int:
    """Record every drive that the manifest does not hold as finished, several at once.

    Drives of other worlds or leaders may join the same folder by another command. What an earlier
    run began and did not finish is recorded anew.
    """
    if run.out is None:
        raise UsageError("--seeds needs --out: the folder in which all drives are kept")
    refuse_own_seed(run.cameras)
    manifest = Manifest(run.out)
    plan = _plan(wanted, run, parse_seeds(seeds))
    left = {name: entry for name, entry in plan.items() if not manifest.finished(name, entry)}
    manifest.begin(left)
    terminal.say(f"{len(plan)} drives, {len(plan) - len(left)} of them there already: {run.out}")
    work = partial(_record, wanted, run)
    with terminal.progress("drives", len(plan)) as advance:
        for done, (name, found) in enumerate(run_tasks(work, left, Workers(workers)), 1):
            manifest.finish(name, found)
            advance(len(plan) - len(left) + done, len(plan))
    pairs = sum(entry["pairs"] for entry in manifest.entries.values())
    lost = any(entry["pairs"] < entry["triggers"] for entry in manifest.entries.values())
    terminal.result(
        f"{len(manifest.entries)} drives, {pairs} pairs: {run.out / MANIFEST}",
        {"file": str(run.out / MANIFEST), "drives": len(manifest.entries), "pairs": pairs},
    )
    return LOSSES if lost else OK


class Manifest:
    """What was recorded, and how, by the name of each drive's folder."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._path = folder, folder / MANIFEST
        if folder.exists() and not self._path.exists():
            raise RigError(f"--out {folder} exists and holds no {MANIFEST}: name a new folder")
        self.entries: dict[str, Entry] = self._read() if self._path.exists() else {}

    def finished(self, name: str, planned: Entry) -> bool:
        """Return whether a drive is there; raises RigError for another one of that name."""
        entry = self.entries.get(name)
        if entry is None:
            return False
        for key, value in planned.items():
            if entry.get(key) != value:
                raise RigError(
                    f"{self._folder / name} was recorded with {key} {entry.get(key)!r}, not "
                    f"{value!r}: name a new --out"
                )
        return "pairs" in entry

    def begin(self, planned: Mapping[str, Entry]) -> None:
        """Write down what is to come and clear away what was begun."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for name in planned:
            if name not in self.entries and (self._folder / name).exists():
                raise RigError(f"{self._folder / name} is not in {MANIFEST}: name a new --out")
            shutil.rmtree(self._folder / name, ignore_errors=True)
        self.entries |= planned
        self._write()

    def finish(self, name: str, found: Entry) -> None:
        """Add what a recorded drive came to."""
        self.entries[name] = self.entries[name] | found
        self._write()

    def _read(self) -> dict[str, Entry]:
        try:
            values = json.loads(self._path.read_text(encoding="utf-8"))
            if values["schema"] != SCHEMA:
                raise ValueError(f"schema {values['schema']!r}")
            return dict(values["drives"])
        except (ValueError, KeyError, TypeError) as error:
            raise RigError(f"{self._path} is no manifest ({error}): name a new --out") from error

    def _write(self) -> None:
        unfinished = self._path.with_suffix(".part")
        values = {"schema": SCHEMA, "drives": self.entries}
        unfinished.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(self._path)


def _plan(wanted: Collection, run: RunOptions, seeds: list[int]) -> dict[str, Entry]:
    """Return what is asked for, by the name of each drive's folder."""
    cameras = chosen_cameras(run.cameras)
    world = parse_address(cameras).name
    led = {"perturb": wanted.perturb, "leader": wanted.leader}
    how = asdict(wanted.sweep) if wanted.sweep.sweep else led
    options = {"cameras": cameras, "frames": run.frames, **how}
    return {f"{world}-{seed}": {**options, "seed": seed} for seed in seeds}


def _record(wanted: Collection, run: RunOptions, entry: Entry) -> Entry:
    """Record one drive; raises RigError when it was interrupted."""
    assert run.out is not None
    world = parse_address(entry["cameras"]).name
    folder = run.out / f"{world}-{entry['seed']}"
    here = replace(run, seed=entry["seed"], out=folder)
    drive = collect_drive(wanted, here, DEFAULT_WEB, Terminal(quiet=True))
    if drive.interrupted:
        raise RigError(f"{folder} was interrupted; the same command records it anew")
    return {"triggers": drive.run.triggers, "pairs": drive.run.complete}
