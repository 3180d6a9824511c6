"""`rig calibrate-response`: response curve and noise of both cameras, as models to simulate."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from rig.calibration.files import to_toml, today
from rig.calibration.plots import response_plot
from rig.calibration.response.bracket import LONGEST_US, Bracket
from rig.calibration.response.twin import Twin, camera_model, make_twin
from rig.cli.calibration import DEFAULT_CALIBRATION, CalibrationOptions, tell
from rig.cli.drive import announce
from rig.cli.interrupt import stop_on_signal
from rig.cli.options import chosen_cameras, make_folder, run_folder
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions, live_page
from rig.config import CameraModel, load_camera_model
from rig.core.errors import CalibrationError, UsageError
from rig.core.protocols import Source
from rig.core.types import SIDES, THESIS_LIMITS, Frame, Intrinsics, Limits, Pair
from rig.drivers.registry import open_source
from rig.pair import CameraPair, both_frames
from rig.web.slot import Glimpse

DEFAULT_CAMERAS = "sim:wall"
DEFAULT_BASE = "blackfly-s-u3-31s4"
PLOT = "response.svg"
MOST_SCATTER = 0.1
ALLOWED = Limits((1.0, LONGEST_US), THESIS_LIMITS.gain_db)

Brackets = Pair[Bracket]


def calibrate_response(
    *,
    base: str = DEFAULT_BASE,
    luminance_cd_m2: float | None = None,
    tolerance_dn: float = 0.5,
    options: CalibrationOptions = DEFAULT_CALIBRATION,
    web: WebOptions = DEFAULT_WEB,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Measure response curve, black level and noise, and write a camera model for the simulation.

    Both cameras look at a blank bright surface under steady light and stand still. Their exposures
    go from the shortest to saturation at three gains; nothing has to be done. primary.toml and
    secondary.toml are loaded by `--cameras 'sim:tunnel?camera=primary.toml'`.

    Parameters
    ----------
    base:
        Camera model, by name or file, for what a bracket cannot tell: lens, timing, pattern noise.
    luminance_cd_m2:
        Luminance of the surface, from a meter: then the model's f-number is set by it.
    tolerance_dn:
        Largest root-mean-square difference between the curve and the means that passes.
    """
    if luminance_cd_m2 is not None and not luminance_cd_m2 > 0:
        raise UsageError(f"--luminance-cd-m2 must be above 0, got {luminance_cd_m2:g}")
    folder = run_folder(options.out, "calibrate-response")
    model = load_camera_model(base)
    address = chosen_cameras(options.cameras, DEFAULT_CAMERAS)
    with closing(open_source(address, seed=options.seed, split="test")) as source:
        check_base(model, source.intrinsics.primary)
        announce(source, options.frames, terminal)
        brackets = take_brackets(source, options.frames, web, terminal)
        serials = Pair(*(camera.serial for camera in source.cameras))
    twins = Pair(*(make_twin(bracket.steps, model.converter.bits) for bracket in brackets))
    make_folder(folder)
    write_models(folder, twins, model, serials, luminance_cd_m2)
    curves = Pair(*(twin.curve.dn(np.linspace(0, 1, 256)) for twin in twins))
    (folder / PLOT).write_text(response_plot(curves), encoding="utf-8")
    residual = max(twin.residual_dn for twin in twins)
    passed = residual <= tolerance_dn and all(t.noise.scatter <= MOST_SCATTER for t in twins)
    told: dict[str, object] = {
        side: named(twin, folder / f"{side}.toml") for side, twin in zip(SIDES, twins, strict=True)
    }
    file = folder / f"{SIDES[0]}.toml"
    return tell(terminal, words(twins), file, residual, tolerance_dn, passed, told)


def check_base(model: CameraModel, seen: Intrinsics) -> None:
    """Raise CalibrationError when the base model's pictures have another shape than these."""
    picture = model.picture
    if seen.width_px * picture.height_px != seen.height_px * picture.width_px:
        raise CalibrationError(
            f"--base {model.name} has pictures of {picture.width_px}x{picture.height_px}, these "
            f"cameras of {seen.width_px}x{seen.height_px}, another shape; name a model of their "
            "kind, or a file, with --base"
        )


def take_brackets(
    source: Source, frames: int | None, web: WebOptions, terminal: Terminal
) -> Brackets:
    """Take pairs until both brackets are whole; raises CalibrationError when that cannot be."""
    pair = CameraPair(source, ALLOWED)
    brackets = Pair(*(Bracket(s, limits) for s, limits in zip(SIDES, pair.limits, strict=True)))
    with ExitStack() as stack:
        stop = stack.enter_context(stop_on_signal("leaving the calibration"))
        view = stack.enter_context(live_page(web, terminal, source.address))
        advance = stack.enter_context(terminal.progress("bracket", None))
        while not all(bracket.done for bracket in brackets):
            if stop.requested:
                raise KeyboardInterrupt
            if frames is not None and pair.triggers >= frames:
                raise CalibrationError(
                    f"the bracket was cut short by --frames {frames} ({brackets.primary.hint}); "
                    "leave it away, or allow about 350"
                )
            pair.apply(Pair(*(bracket.settings for bracket in brackets)))
            seen = both_frames(pair.shoot())
            if seen is None:
                continue
            for bracket, frame in zip(brackets, seen, strict=True):
                bracket.see(frame)
            advance(*(sum(part) for part in zip(*(b.progress for b in brackets), strict=True)))
            if view is not None:
                shown = page_state(brackets, seen)
                view.slot.put(Glimpse(Pair[Frame | None](*seen), partial(dict[str, Any], shown)))
    return brackets


def page_state(brackets: Brackets, frames: Pair[Frame]) -> dict[str, Any]:
    """Return what the page shows."""
    return {
        "title": "response calibration: keep the cameras and the light still",
        "status": brackets.primary.hint,
        "values": [
            ["doing", *(bracket.hint for bracket in brackets)],
            ["exposure", *(f"{frame.used.exposure_us:.0f} us" for frame in frames)],
            ["gain", *(f"{frame.used.gain_db:.1f} dB" for frame in frames)],
            ["mean", *(f"{frame.image.mean():.1f}" for frame in frames)],
        ],
    }


def write_models(
    folder: Path,
    twins: Pair[Twin],
    base: CameraModel,
    serials: Pair[str],
    luminance_cd_m2: float | None,
) -> None:
    """Write one camera model a camera; each says what of it was not measured."""
    lens = "" if luminance_cd_m2 is not None else "lens, "
    for side, twin, serial in zip(SIDES, twins, serials, strict=True):
        model = camera_model(twin, base, f"{base.name} {serial}", luminance_cd_m2)
        text = (
            f"# Measured by rig calibrate-response on {today()}, camera {serial}.\n"
            f"# Not measured but taken from {base.name}: picture, controls, {lens}timing, and of\n"
            "# the pixel all but full_well_e and read_noise_e.\n\n"
        )
        values = msgspec.to_builtins(model)
        (folder / f"{side}.toml").write_text(text + to_toml(values), encoding="utf-8")


def named(twin: Twin, file: Path) -> Mapping[str, object]:
    """Return every quantity of one camera under its name and unit."""
    return {
        "file": str(file),
        "bits": twin.bits,
        "conversion_gain_e_per_dn": twin.e_per_dn,
        "read_noise_e": twin.noise.read_noise_e,
        "full_well_e": twin.noise.full_well_e,
        "black_level_dn": twin.black_level_dn,
        "response": msgspec.to_builtins(twin.curve.response),
        "electrons_per_s": twin.electrons_per_s,
        "gains_db": twin.gains_db,
        "residual_dn": twin.residual_dn,
        "debevec_difference_dn": twin.debevec_difference_dn,
        "noise_scatter": twin.noise.scatter,
    }


def words(twins: Pair[Twin]) -> str:
    """Return the result as lines for a person."""
    lines = []
    for side, twin in zip(SIDES, twins, strict=True):
        curve = msgspec.to_builtins(twin.curve.response)
        gamma = f" {curve['gamma']:.3f}" if "gamma" in curve else ""
        lines += [
            f"{side}: response {curve['curve']}{gamma}, within {twin.residual_dn:.2f} of 255 "
            f"(Debevec's: {twin.debevec_difference_dn:.2f})",
            f"  {twin.e_per_dn:.3f} e- per step of {twin.bits} bits, read noise "
            f"{twin.noise.read_noise_e:.2f} e-, full well {twin.noise.full_well_e:.0f} e-, black "
            f"level {twin.black_level_dn:.1f}",
        ]
        if twin.noise.scatter > MOST_SCATTER:
            lines.append(
                f"  the noise is {twin.noise.scatter:.0%} off photon transfer: something beside "
                "light and readout makes noise; switch denoising and sharpening off"
            )
    return "\n".join(lines)
