"""From the words after `--cameras` to an opened pair of cameras.

    sim:WORLD?OPTION=VALUE&...      simulated cameras in a simulated world, on a virtual clock
    gige:sim:WORLD?OPTION=VALUE&... the same in real time, behind GigE Vision and Aravis
    aravis:SERIAL,SERIAL            two real cameras, the primary first (docs/hardware.md)
    replay:FILE                     the frames of a recording, as they were taken

Options of `sim:` are those of SIMULATION_OPTIONS and OPTICS_OPTIONS, LIGHT_STEP, DEPTH, and those
that only one world has. The address of an opened source has every option resolved, in alphabetical
order, so opening it again repeats the same drive.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, quote

from rig.config import CameraModel, load_camera_model
from rig.core.errors import UsageError
from rig.core.protocols import Source
from rig.core.types import SIDES

if TYPE_CHECKING:
    from rig.drivers.scenes.optics import Optics
    from rig.drivers.simulated.source import SimulatedSource

SCHEMES = ("sim", "gige", "aravis", "replay")


@dataclass(frozen=True, slots=True)
class Address:
    """An address taken apart: `scheme:name?options`."""

    scheme: str
    name: str
    options: Mapping[str, str]

    def __str__(self) -> str:
        """Return the address with its options in alphabetical order."""
        pairs = (f"{key}={quote(self.options[key], safe='/@:,')}" for key in sorted(self.options))
        query = "&".join(pairs)
        return f"{self.scheme}:{self.name}" + (f"?{query}" if query else "")


def parse_address(text: str) -> Address:
    """Take an address apart; raises UsageError for an unknown scheme or a malformed option."""
    scheme, colon, rest = text.partition(":")
    if not colon:
        example = f"sim:{text or 'tunnel'}"
        raise UsageError(f"--cameras {text!r}: what kind of cameras? Write it as {example}")
    if scheme not in SCHEMES:
        raise _unknown("scheme", scheme, SCHEMES, f"--cameras {text}")
    name, _, query = rest.partition("?")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise UsageError(f"{text}: options are written NAME=VALUE&NAME=VALUE") from error
    options = dict(pairs)
    if len(options) < len(pairs):
        twice = next(key for key, _ in pairs if sum(key == other for other, _ in pairs) > 1)
        raise UsageError(f"{text}: option {twice!r} is given twice; keep one")
    return Address(scheme, name, options)


def open_source(address: str, *, seed: int, split: str = "test") -> Source:
    """Open the cameras that `address` names.

    `seed` makes the noise, and the world unless the address names its own seed; `split` is the
    split unless the address names one. Raises UsageError for a word in the address that is not
    known or a value that cannot be meant, and ConfigError for a bad camera file.
    """
    if address.startswith("replay:"):
        from rig.drivers.replay import open_replay

        return open_replay(Path(address.removeprefix("replay:")))
    parsed = parse_address(address)
    if parsed.scheme == "gige":
        return _open_gige(address.removeprefix("gige:"), seed=seed, split=split)
    if parsed.scheme == "aravis":
        from rig.drivers.aravis.address import open_aravis

        return open_aravis(parsed.name, parsed.options)
    return _open_simulation(parsed, seed=seed, split=split)


def _open_gige(address: str, *, seed: int, split: str) -> Source:
    from rig.drivers.aravis.address import read_mode
    from rig.drivers.simulated.gige.opening import SCHEME, open_over_gige

    inner = parse_address(address)
    if inner.scheme != "sim":
        raise UsageError(f"gige:{address}: only simulated cameras are served; try gige:sim:tunnel")
    mode = read_mode(SCHEME, inner.options.get("mode", "next-frame"))
    others = {name: word for name, word in inner.options.items() if name != "mode"}
    served = replace(inner, options=others)
    return open_over_gige(
        lambda: _open_simulation(served, seed=seed, split=split),
        str(served),
        mode,
        seed=seed,
        split=split,
    )


def _open_simulation(address: Address, *, seed: int, split: str) -> SimulatedSource:
    from rig.drivers.scenes import worlds
    from rig.drivers.scenes.step import SteppedScene, read_light_step
    from rig.drivers.simulated.source import Drive, simulate
    from rig.drivers.simulated.standing import read_standing

    if address.name not in worlds.NAMES:
        raise _unknown("world", address.name, worlds.NAMES, f"--cameras sim:{address.name}")
    of_world = worlds.WORLD_OPTIONS.get(address.name, ())
    known = (*SIMULATION_OPTIONS, *OPTICS_OPTIONS, LIGHT_STEP, DEPTH, STAND, *of_world)
    for option in address.options:
        if option not in known:
            raise _unknown("option", option, known, f"sim:{address.name}")
    special = {name: word for name, word in address.options.items() if name in of_world}
    words = _DEFAULTS | {"seed": str(seed), "split": split}
    if address.name in worlds.SPEEDS_MPS:
        words["speed_mps"] = str(worlds.SPEEDS_MPS[address.name])
    words |= dict(address.options)
    values = {name: _value(address, name, words[name]) for name in SIMULATION_OPTIONS}
    model = load_camera_model(values["camera"])
    width_px, height_px = values["size"]
    _check_size(address, width_px, height_px, model)
    through = {
        name: _read(address, name, address.options[name], read)
        for name, read in OPTICS_OPTIONS.items()
        if name in address.options and name not in special
    }
    scene = worlds.open_world(
        address.name,
        seed=values["seed"],
        split=values["split"],
        width_px=width_px,
        height_px=height_px,
        speed_mps=values["speed_mps"],
        optics=_optics(through, model),
        **special,
    )
    drive = Drive(
        model=model,
        noise_seed=seed,
        rate_hz=values["rate_hz"],
        latency_frames=values["latency_frames"],
        decision_ms=values["decision_ms"],
        depth=DEPTH in address.options and _read(address, DEPTH, address.options[DEPTH], _on),
    )
    stand = {STAND: address.options[STAND]} if STAND in address.options else {}
    if stand:
        standing = _read(address, STAND, stand[STAND], read_standing)
        place_s = standing.step_m / values["speed_mps"]
        drive = replace(drive, triggers_a_place=standing.triggers, place_s=place_s)
    resolved = {name: _spell(value) for name, value in values.items()} | special | stand
    resolved |= {name: address.options[name] for name in through}
    if drive.depth:
        resolved[DEPTH] = "on"
    if LIGHT_STEP in address.options:
        step = _read(address, LIGHT_STEP, address.options[LIGHT_STEP], read_light_step)
        scene = SteppedScene(scene, step.factor, drive.scene_time_s(step.pair))
        resolved[LIGHT_STEP] = str(step)
    return simulate(scene, drive, str(Address(address.scheme, address.name, resolved)))


def _whole(word: str) -> int:
    if not word.isdecimal():
        raise ValueError("a whole number, 0 or more")
    return int(word)


def _duration(word: str) -> float:
    if not (number := _finite(word)) >= 0:
        raise ValueError("a number, 0 or more")
    return number


def _speed(word: str) -> float:
    if not (number := _finite(word)) > 0:
        raise ValueError("a number above 0")
    return number


def _rate(word: str) -> float | None:
    if word == "max":
        return None
    if not (number := _finite(word)) > 0:
        raise ValueError("a number above 0, or max")
    return number


def _finite(word: str) -> float:
    """Return a number; NaN, which no range contains, for a word that is not one."""
    try:
        number = float(word)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def _size(word: str) -> tuple[int, int]:
    found = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", word)
    if not found:
        raise ValueError("WIDTHxHEIGHT in pixels, such as 640x480")
    return int(found[1]), int(found[2])


def _split(word: str) -> str:
    if word not in ("train", "test"):
        raise ValueError("train or test")
    return word


def _camera(word: str) -> str:
    """Return a shipped model's name as it is, and a file's path from the root."""
    return str(Path(word).resolve()) if word.endswith(".toml") else word


SIMULATION_OPTIONS: Mapping[str, Callable[[str], Any]] = {
    "camera": _camera,
    "decision_ms": _duration,
    "latency_frames": _whole,
    "rate_hz": _rate,
    "seed": _whole,
    "size": _size,
    "speed_mps": _speed,
    "split": _split,
}
"""What an option of `sim:` is read with; it raises ValueError with what the option must be."""

DEPTH = "depth"
"""`depth=on` puts the depth of the primary's view into the recording; absent, it stays out."""


def _on(word: str) -> bool:
    if word not in ("on", "off"):
        raise ValueError("on or off")
    return word == "on"


def _share(word: str) -> float:
    if not 0 <= (number := _finite(word)) <= 1:
        raise ValueError("a number from 0 to 1")
    return number


def _cosine_power(word: str) -> float:
    if not 0 <= (number := _finite(word)) <= 4:
        raise ValueError("a number from 0 to 4, where 1 is the cos^4 law")
    return number


def _distortion(word: str) -> tuple[float, ...]:
    numbers = [_finite(part) for part in word.split(",")]
    if len(numbers) > 5 or not all(abs(number) <= 1 for number in numbers):
        raise ValueError("up to five numbers k1,k2,p1,p2,k3 of at most 1")
    return tuple(numbers + [0.0] * (5 - len(numbers)))


def _f_numbers(word: str) -> tuple[float, float]:
    numbers = [_finite(part) for part in word.split(",")]
    if len(numbers) > 2 or not all(0.7 <= number <= 64 for number in numbers):
        raise ValueError("an f-number from 0.7 to 64, or two, PRIMARY,SECONDARY")
    return numbers[0], numbers[-1]


OPTICS_OPTIONS: Mapping[str, Callable[[str], Any]] = {
    "distortion": _distortion,
    "f_number": _f_numbers,
    "glare": _share,
    "vignetting": _cosine_power,
}
"""What stands before the sensor besides an ideal lens; absent, nothing does."""


def _optics(options: Mapping[str, Any], model: CameraModel) -> Optics | None:
    """Return what the options ask for; None for an ideal lens with the model's own aperture."""
    if not options:
        return None
    from rig.drivers.scenes.optics import Optics

    usual = model.lens.f_number
    f_numbers = options.get("f_number", (usual, usual))
    light = {side: (usual / n) ** 2 for side, n in zip(SIDES, f_numbers, strict=True)}
    return Optics(
        light=light, **{name: value for name, value in options.items() if name != "f_number"}
    )


LIGHT_STEP = "light_step"
"""`light_step=10@30` multiplies the light by 10 from pair 30 on; absent, the light stays."""

STAND = "stand"
"""`stand=25@0.3` stands still for 25 triggers every 0.3 m, without blur; absent, it drives."""

_DEFAULTS = {
    "camera": "blackfly-s-u3-31s4",
    "decision_ms": "0",
    "latency_frames": "0",
    "rate_hz": "10",
    "size": "640x480",
    "speed_mps": "13.9",
}


def _value(address: Address, name: str, word: str) -> Any:
    return _read(address, name, word, SIMULATION_OPTIONS[name])


def _read(address: Address, name: str, word: str, read: Callable[[str], Any]) -> Any:
    try:
        return read(word)
    except ValueError as error:
        where = f"{address.scheme}:{address.name}"
        raise UsageError(f"{where}: {name} must be {error}, got {word!r}") from error


def _check_size(address: Address, width_px: int, height_px: int, model: CameraModel) -> None:
    """Refuse a picture that is no smaller copy of the camera's, or that cuts a Bayer cell."""
    full = model.picture
    fits = width_px <= full.width_px and height_px <= full.height_px
    alike = width_px * full.height_px == height_px * full.width_px
    if not (fits and alike and width_px % 2 == 0 and height_px % 2 == 0):
        raise UsageError(
            f"{address.scheme}:{address.name}: size must be even, of the shape of "
            f"{full.width_px}x{full.height_px} and no larger, got {width_px}x{height_px}; "
            "try 320x240, 640x480 or 1024x768"
        )


def _spell(value: object) -> str:
    """Return a value as it is written in an address."""
    if value is None:
        return "max"
    if isinstance(value, tuple):
        return "x".join(str(part) for part in value)
    return f"{value:g}" if isinstance(value, float) and value == float(f"{value:g}") else str(value)


def _unknown(kind: str, word: str, known: Iterable[str], where: str) -> UsageError:
    """Return the error for a word that is not among the `known`."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1)
    hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(names)}"
    return UsageError(f"{where}: unknown {kind} {word!r}; {hint}")
