"""What is known of a run before its first trigger, and how it is kept in the file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from rig.core.errors import RecordingError
from rig.core.types import SIDES, Intrinsics, Pair, Side
from rig.record.hashes import fingerprint
from rig.record.totals import NAME as TOTALS

SCHEMA = "rig.recording/2"
RUN, VERSIONS, MODELS = "rig.run", "rig.versions", "rig.models"
PART, NEXT, RECOVERY = "rig.part", "rig.next", "rig.recovery"
"""Where a later file of a run begins, which file goes on, and that the end of one was lost."""
OPTIONS, CALIBRATION = "options.json", "calibration.toml"
_HASH = "header_hash"
_CAMERA = "rig.camera.{}"


@dataclass(frozen=True, slots=True)
class RunHeader:
    """Who recorded what with which software, written before the first trigger.

    `cameras` is the resolved address, `world_version` is empty for real cameras, `controllers`
    are names, `options` holds every resolved option and `models` the SHA-256 of each network.
    `calibration` is the text of the cameras' calibration.toml, empty without one.
    """

    command: str
    cameras: str
    seed: int
    world_version: str
    versions: Mapping[str, str]
    git: str
    serials: Pair[str]
    intrinsics: Pair[Intrinsics]
    controllers: Pair[str]
    options: Mapping[str, str]
    models: Mapping[str, str]
    calibration: str = ""


def to_metadata(header: RunHeader) -> dict[str, dict[str, str]]:
    """Return the MCAP metadata records of a header, by name; with the last one it is whole."""
    parts = _parts(header)
    parts[RUN][_HASH] = f"{header_hash(header):016x}"
    return parts


def header_hash(header: RunHeader) -> int:
    """Return the hash of all that a header says: the chain over the triggers starts with it."""
    parts = json.dumps(_parts(header), sort_keys=True).encode()
    return fingerprint(parts, *to_attachments(header).values())


def _parts(header: RunHeader) -> dict[str, dict[str, str]]:
    cameras = {
        _camera(side): {
            "serial": serial,
            "controller": controller,
            **_lens(intrinsics),
        }
        for side, serial, controller, intrinsics in zip(
            SIDES, header.serials, header.controllers, header.intrinsics, strict=True
        )
    }
    run = {
        "schema": SCHEMA,
        "command": header.command,
        "cameras": header.cameras,
        "seed": str(header.seed),
        "world_version": header.world_version,
        "git": header.git,
    }
    return {**cameras, VERSIONS: dict(header.versions), MODELS: dict(header.models), RUN: run}


def to_attachments(header: RunHeader) -> dict[str, bytes]:
    """Return the MCAP attachments of a header, by name."""
    options = json.dumps(dict(header.options), indent=2, sort_keys=True).encode()
    calibration = {CALIBRATION: header.calibration.encode()} if header.calibration else {}
    return {OPTIONS: options, **calibration}


_BEGINNING = frozenset({*map(_CAMERA.format, SIDES), VERSIONS, MODELS, RUN})
NEEDED = _BEGINNING | {OPTIONS}
"""Names of the metadata and attachments without which a file does not say what it is."""
METADATA = _BEGINNING | {PART, NEXT, RECOVERY, TOTALS}
ATTACHMENTS = frozenset({OPTIONS, CALIBRATION})
"""Names of all that the rig puts into a file; others are left unread."""


def from_parts(
    metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]
) -> RunHeader:
    """Return the header that `metadata` and `attachments` hold.

    Raises KeyError or ValueError when something is missing or is not what it must be, and
    RecordingError for another version of the schema.
    """
    run, cameras = metadata[RUN], Pair(*(metadata[_camera(side)] for side in SIDES))
    if run["schema"] != SCHEMA:
        raise RecordingError(f"the recording is {run['schema']!r}, this rig reads {SCHEMA!r}")
    options = json.loads(attachments[OPTIONS])
    if not isinstance(options, dict):
        raise ValueError(f"{OPTIONS} is not a table")
    header = RunHeader(
        command=run["command"],
        cameras=run["cameras"],
        seed=int(run["seed"]),
        world_version=run["world_version"],
        versions=dict(metadata[VERSIONS]),
        git=run["git"],
        serials=Pair(*(camera["serial"] for camera in cameras)),
        intrinsics=Pair(*map(_intrinsics, cameras)),
        controllers=Pair(*(camera["controller"] for camera in cameras)),
        options={str(name): str(value) for name, value in options.items()},
        models=dict(metadata[MODELS]),
        calibration=attachments.get(CALIBRATION, b"").decode(),
    )
    if run[_HASH] != f"{header_hash(header):016x}":
        raise ValueError("what the run says about itself was changed")
    return header


def _camera(side: Side) -> str:
    return _CAMERA.format(side)


def _lens(intrinsics: Intrinsics) -> dict[str, str]:
    """Return intrinsics as words; the distortion only where there is one."""
    values = asdict(intrinsics)
    distortion = values.pop("distortion")
    words = {name: str(value) for name, value in values.items()}
    return words | ({"distortion": ",".join(map(str, distortion))} if any(distortion) else {})


def _intrinsics(camera: Mapping[str, str]) -> Intrinsics:
    k1, k2, p1, p2, k3 = (float(word) for word in camera.get("distortion", "0,0,0,0,0").split(","))
    return Intrinsics(
        width_px=int(camera["width_px"]),
        height_px=int(camera["height_px"]),
        fx_px=float(camera["fx_px"]),
        fy_px=float(camera["fy_px"]),
        cx_px=float(camera["cx_px"]),
        cy_px=float(camera["cy_px"]),
        distortion=(k1, k2, p1, p2, k3),
    )
