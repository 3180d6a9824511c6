"""From a `sim:` address to two simulated cameras in a simulated world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rig.config import CameraModel, load_camera_model
from rig.core.errors import UsageError
from rig.core.types import SIDES
from rig.drivers.addresses import Address, read_option, unknown
from rig.drivers.scenes import worlds
from rig.drivers.scenes.optics import Optics
from rig.drivers.scenes.scene import Scene
from rig.drivers.scenes.step import SteppedScene, read_light_step
from rig.drivers.simulated.options import (
    DEFAULTS,
    DEPTH,
    LIGHT_STEP,
    OPTICS_OPTIONS,
    SIMULATION_OPTIONS,
    STAND,
    on,
)
from rig.drivers.simulated.source import Drive, SimulatedSource, simulate
from rig.drivers.simulated.standing import read_standing

Values = Mapping[str, Any]
"""What the words of SIMULATION_OPTIONS mean."""


def open_simulation(address: Address, *, seed: int, split: str) -> SimulatedSource:
    """Open the simulated pair; see `rig.drivers.registry.open_source`."""
    _check_names(address)
    values = _values(address, seed, split)
    model = load_camera_model(values["camera"])
    _check_size(address, values["size"], model)
    scene = _scene(address, values, model)
    drive = _drive(address, values, model, seed)
    resolved = _resolved(address, values, drive)
    if LIGHT_STEP in address.options:
        step = read_option(address, LIGHT_STEP, address.options[LIGHT_STEP], read_light_step)
        scene = SteppedScene(scene, step.factor, drive.scene_time_s(step.pair))
        resolved[LIGHT_STEP] = str(step)
    return simulate(scene, drive, str(Address(address.scheme, address.name, resolved)))


def _check_names(address: Address) -> None:
    """Refuse a world or an option that there is not."""
    if address.name not in worlds.NAMES:
        raise unknown("world", address.name, worlds.NAMES, f"--cameras sim:{address.name}")
    of_all = (*SIMULATION_OPTIONS, *OPTICS_OPTIONS, LIGHT_STEP, DEPTH, STAND)
    known = (*of_all, *worlds.WORLD_OPTIONS.get(address.name, ()))
    for option in address.options:
        if option not in known:
            raise unknown("option", option, known, f"sim:{address.name}")


def _values(address: Address, seed: int, split: str) -> Values:
    words = DEFAULTS | {"seed": str(seed), "split": split}
    if address.name in worlds.SPEEDS_MPS:
        words["speed_mps"] = str(worlds.SPEEDS_MPS[address.name])
    words |= dict(address.options)
    return {
        name: read_option(address, name, words[name], read)
        for name, read in SIMULATION_OPTIONS.items()
    }


def _of_world(address: Address) -> dict[str, str]:
    """Return the options that only this world has, as they are written."""
    own = worlds.WORLD_OPTIONS.get(address.name, ())
    return {name: word for name, word in address.options.items() if name in own}


def _scene(address: Address, values: Values, model: CameraModel) -> Scene:
    width_px, height_px = values["size"]
    return worlds.open_world(
        address.name,
        seed=values["seed"],
        split=values["split"],
        width_px=width_px,
        height_px=height_px,
        speed_mps=values["speed_mps"],
        optics=_optics(address, model),
        **_of_world(address),
    )


def _optics(address: Address, model: CameraModel) -> Optics | None:
    """Return what the options ask for; None for an ideal lens with the model's own aperture."""
    asked = {
        name: read_option(address, name, address.options[name], OPTICS_OPTIONS[name])
        for name in _optics_named(address)
    }
    if not asked:
        return None
    usual = model.lens.f_number
    f_numbers = asked.pop("f_number", (usual, usual))
    light = {side: (usual / n) ** 2 for side, n in zip(SIDES, f_numbers, strict=True)}
    return Optics(light=light, **asked)


def _optics_named(address: Address) -> list[str]:
    own = _of_world(address)
    return [name for name in OPTICS_OPTIONS if name in address.options and name not in own]


def _drive(address: Address, values: Values, model: CameraModel, seed: int) -> Drive:
    drive = Drive(
        model=model,
        noise_seed=seed,
        rate_hz=values["rate_hz"],
        latency_frames=values["latency_frames"],
        decision_ms=values["decision_ms"],
        depth=read_option(address, DEPTH, address.options.get(DEPTH, "off"), on),
    )
    if STAND not in address.options:
        return drive
    standing = read_option(address, STAND, address.options[STAND], read_standing)
    place_s = standing.step_m / values["speed_mps"]
    return replace(drive, triggers_a_place=standing.triggers, place_s=place_s)


def _resolved(address: Address, values: Values, drive: Drive) -> dict[str, str]:
    """Return every option that the drive has, spelled so that it opens the same drive again."""
    resolved = {name: _spell(value) for name, value in values.items()} | _of_world(address)
    kept = [*_optics_named(address), *([STAND] if STAND in address.options else [])]
    resolved |= {name: address.options[name] for name in kept}
    return resolved | ({DEPTH: "on"} if drive.depth else {})


def _check_size(address: Address, size_px: tuple[int, int], model: CameraModel) -> None:
    """Refuse a picture that is no smaller copy of the camera's, or that cuts a Bayer cell."""
    width_px, height_px = size_px
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
