"""`rig latency`: after how many frames settings have effect, measured."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

from rig.cli.exits import INTERRUPTED, OK
from rig.cli.interrupt import stop_on_signal
from rig.cli.options import chosen_cameras, is_simulated
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import CameraError, UsageError
from rig.core.types import SIDES, Pair
from rig.drivers.registry import open_source
from rig.experiments.latency import CameraLatency, measure

_BAR = 30
_MODES = ("next-frame", "free-run")


def latency(
    *,
    cameras: str | None = None,
    steps: int = 12,
    seed: int = 0,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Step the exposure, and count the frames until one was taken with it, by mode and camera.

    0 is the very next frame. The camera's word is checked against the brightness of its pictures.
    Cameras behind Aravis are measured waiting for triggers and running freely, unless the address
    names a mode.

    Parameters
    ----------
    cameras:
        Address of the camera pair; sim:tunnel when absent.
    steps:
        How many steps each mode is measured by.
    seed:
        Seeds the world and the noise.
    """
    if steps < 1:
        raise UsageError(f"--steps must be 1 or more, got {steps}")
    address = chosen_cameras(cameras)
    results: dict[str, Any] = {}
    with stop_on_signal("stopping after this step") as stop:
        for mode, of_mode in by_mode(address):
            with (
                closing(open_source(of_mode, seed=seed, split="test")) as source,
                terminal.progress(f"stepping, {mode}", steps) as advance,
            ):
                for done, found in enumerate(measure(source, steps), start=1):
                    results[mode] = as_values(found)
                    advance(done)
                    if stop.requested:
                        return INTERRUPTED
    lines = [line for mode, found in results.items() for line in histogram(mode, found)]
    words = "\n".join([f"SIMULATED: {address}", *lines] if is_simulated(address) else lines)
    terminal.result(words, {"cameras": address, "modes": results})
    silent = [s for found in results.values() for s in found.values() if s["without_effect"]]
    if silent:
        raise CameraError(
            f"{silent[0]['serial']}: {silent[0]['without_effect']} of {steps} steps had no effect "
            "within 12 frames; check that ExposureAuto is off and nobody else writes settings"
        )
    return OK


def by_mode(address: str) -> Iterator[tuple[str, str]]:
    """Yield the modes to measure, each with the address that opens it."""
    if not address.startswith(("aravis:", "gige:")):
        yield "next-frame", address
        return
    name, _, query = address.partition("?")
    words = [word for word in query.split("&") if word]
    named = next((w.removeprefix("mode=") for w in words if w.startswith("mode=")), None)
    others = [word for word in words if not word.startswith("mode=")]
    for mode in _MODES if named is None else (named,):
        yield mode, f"{name}?{'&'.join([*others, f'mode={mode}'])}"


def as_values(found: Pair[CameraLatency]) -> dict[str, Any]:
    """Return what was found as named values."""
    return {
        side: {
            "serial": camera.serial,
            "frames_to_effect": {str(frames): n for frames, n in sorted(camera.frames.items())},
            "without_effect": camera.without_effect,
            "disputed_by_brightness": camera.disputed,
        }
        for side, camera in zip(SIDES, found, strict=True)
    }


def histogram(mode: str, found: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of one mode."""
    for side, camera in found.items():
        counted = camera["frames_to_effect"]
        yield f"{mode}, {side} {camera['serial']}: {spelt(counted)}"
        most = max(counted.values(), default=1)
        for frames, count in counted.items():
            yield f"  {frames:>2} {'#' * max(round(_BAR * count / most), 1):<{_BAR}} {count}"
        if camera["disputed_by_brightness"]:
            yield f"  {camera['disputed_by_brightness']} steps looked otherwise in the pictures"


def spelt(counted: dict[str, int]) -> str:
    """Return a histogram in words."""
    if not counted:
        return "settings had no effect"
    usual = max(counted, key=lambda frames: counted[frames])
    if set(counted) == {"0"}:
        return "settings reach the very next frame"
    sure = "" if len(counted) == 1 else "mostly "
    return f"settings come {sure}{usual} {'frame' if usual == '1' else 'frames'} late"
