"""`rig calibrate-intrinsics`: focal lengths, distortion and baseline from views of a board."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from rig.calibration.board import Board, parse_board
from rig.calibration.export import kalibr_camchain, ros_camera_info
from rig.calibration.files import of_fit, today
from rig.calibration.intrinsics import RigFit, fit_rig
from rig.calibration.pairs import GreyPair, count_in_folder, of_folder, of_recording
from rig.calibration.plots import residual_plot
from rig.calibration.views import UNMOVED, ViewCollection
from rig.cli.calibration import (
    DEFAULT_CALIBRATION,
    DEFAULT_KNOWN,
    CalibrationOptions,
    KnownOptions,
    earlier,
    store,
    tell,
)
from rig.cli.drive import announce
from rig.cli.interrupt import stop_on_signal
from rig.cli.options import chosen_cameras, make_folder, run_folder
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions, live_page
from rig.core.errors import CalibrationError, RigError
from rig.core.protocols import Source
from rig.core.types import SIDES, Auto, Frame, Pair, Settings
from rig.drivers.registry import open_source
from rig.pair import CameraPair, both_frames
from rig.record.reader import open_recording
from rig.vision.bayer import to_grey
from rig.web.slot import Glimpse

DEFAULT_CAMERAS = "sim:chessboard"
PLOT = "residuals.svg"


def calibrate_intrinsics(
    pictures: Path | None = None,
    /,
    *,
    board: str = "chessboard:9x6",
    square_mm: float = 30.0,
    tolerance_px: float = 0.5,
    options: CalibrationOptions = DEFAULT_CALIBRATION,
    known: KnownOptions = DEFAULT_KNOWN,
    web: WebOptions = DEFAULT_WEB,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Measure focal lengths, distortion and the baseline of both cameras from views of a board.

    Live, or from a recording or a folder of pictures; the terminal says where the board is still
    missing. Ctrl-C ends the collecting and computes with what there is.

    Parameters
    ----------
    pictures:
        A recording, or a folder with left01.png and right01.png, or with folders primary and
        secondary; the cameras live when absent.
    board:
        chessboard:COLUMNSxROWS in inner corners, or charuco:COLUMNSxROWS in squares.
    square_mm:
        Side of one printed square.
    tolerance_px:
        Largest root-mean-square reprojection error that passes.
    """
    wanted = parse_board(board, square_mm)
    folder, before = run_folder(options.out, "calibrate-intrinsics"), earlier(known)
    if pictures is None:
        serials, collection = look_live(wanted, options, web, terminal)
    else:
        serials, collection = look_back(pictures, wanted, terminal)
    fit = fit_rig(collection)
    make_folder(folder)
    file = store(folder, of_fit(fit, serials, known.lens, today()), before)
    write_exports(folder, fit)
    passed = fit.residual_px <= tolerance_px and fit.sync.passed
    return tell(
        terminal, words(fit, collection), file, fit.residual_px, tolerance_px, passed,
        named(fit, collection),
    )  # fmt: skip


def look_live(
    board: Board, options: CalibrationOptions, web: WebOptions, terminal: Terminal
) -> tuple[Pair[str], ViewCollection]:
    """Watch the cameras until there are enough views of everything."""
    address = chosen_cameras(options.cameras, DEFAULT_CAMERAS)
    with (
        closing(open_source(address, seed=options.seed, split="test")) as source,
        stop_on_signal("computing with what was seen") as stop,
        live_page(web, terminal, source.address) as view,
    ):
        frames = options.frames if options.frames is not None else source.drive_triggers
        announce(source, frames, terminal)
        lens = source.intrinsics.primary
        collection = ViewCollection(board, (lens.width_px, lens.height_px))
        for pair, seen in live_pairs(source, frames):
            told = guide(collection, pair, terminal)
            if view is not None:
                shown = page_state(collection, seen, told)
                view.slot.put(Glimpse(Pair[Frame | None](*seen), partial(dict[str, Any], shown)))
            if stop.requested or (options.frames is None and not collection.missing):
                break
        return Pair(*(camera.serial for camera in source.cameras)), collection


def live_pairs(source: Source, frames: int | None) -> Iterator[tuple[GreyPair, Pair[Frame]]]:
    """Yield what the cameras see, each exposing by itself: at most 15 ms, against blur."""
    pair = CameraPair(source)
    limits = pair.limits.primary
    longest_us = min(limits.exposure_us[1], 15_000.0)
    command = Auto(limits=type(limits)((limits.exposure_us[0], longest_us), limits.gain_db),
                   damping=0.0, start=Settings(longest_us, 0.0))  # fmt: skip
    pair.apply(Pair(command, command))
    while frames is None or pair.triggers < frames:
        trigger = pair.triggers
        shot = pair.shoot()
        seen = both_frames(shot)
        if seen is not None:
            greys = Pair(*(to_grey(frame.image, frame.pixel_format) for frame in seen))
            yield GreyPair(trigger, greys, shot.offset_ns), seen


def look_back(pictures: Path, board: Board, terminal: Terminal) -> tuple[Pair[str], ViewCollection]:
    """Look through a recording or a folder of pictures."""
    if not pictures.exists():
        raise RigError(f"{pictures}: no such recording or folder; check the path")
    if pictures.is_dir() and not any(pictures.glob("*.mcap")):
        count, pairs = count_in_folder(pictures), of_folder(pictures)
        serials = Pair("unknown-primary", "unknown-secondary")
    else:
        recording = open_recording(pictures)
        count, pairs, serials = len(recording), of_recording(recording), recording.header.serials
    collection: ViewCollection | None = None
    with terminal.progress("looking for the board", count) as advance:
        for done, pair in enumerate(pairs, start=1):
            height_px, width_px = pair.greys.primary.shape
            collection = collection or ViewCollection(board, (width_px, height_px))
            if collection.size_px != (width_px, height_px):
                raise CalibrationError(
                    f"{pictures}: pair {pair.trigger} is {width_px}x{height_px}, others are "
                    f"{collection.size_px[0]}x{collection.size_px[1]}; use pictures of one size"
                )
            guide(collection, pair, terminal)
            advance(done)
    if collection is None:
        raise CalibrationError(f"{pictures}: has no complete pair; record the board again")
    return serials, collection


def guide(collection: ViewCollection, pair: GreyPair, terminal: Terminal) -> str:
    """Look at one pair and say what it was worth and what is missing most; return that."""
    complaint = collection.offer(pair.trigger, pair.greys, pair.offset_ns)
    state = complaint or f"view {len(collection.views)}"
    if complaint != UNMOVED:
        terminal.say(f"pair {pair.trigger}: {state}; next: {todo(collection)}")
    return state


def todo(collection: ViewCollection) -> str:
    """Return what is missing most."""
    missing = collection.missing
    return missing[0] if missing else "enough of everything"


def page_state(collection: ViewCollection, frames: Pair[Frame], told: str) -> dict[str, Any]:
    """Return what the page shows."""
    return {
        "title": "intrinsic calibration: show the board everywhere, near and tilted",
        "status": f"{len(collection.views)} views",
        "big": str(len(collection.views)),
        "level": "warn" if collection.missing else "good",
        "hint": todo(collection),
        "values": [
            ["exposure", *(f"{frame.used.exposure_us:.0f} us" for frame in frames)],
            ["parts covered", *(f"{int((c > 0).sum())} of {c.size}" for c in collection.coverage)],
        ],
        "notes": [told, *collection.missing],
    }


def write_exports(folder: Path, fit: RigFit) -> None:
    """Write the files that other tools read, and the residual plot."""
    for side in SIDES:
        (folder / f"{side}.yaml").write_text(ros_camera_info(fit, side), encoding="utf-8")
    (folder / "camchain.yaml").write_text(kalibr_camchain(fit), encoding="utf-8")
    (folder / PLOT).write_text(residual_plot(fit), encoding="utf-8")


def named(fit: RigFit, collection: ViewCollection) -> dict[str, object]:
    """Return every quantity under its name and unit."""
    cameras: dict[str, object] = {
        side: {
            "fx_px": float(camera.matrix[0, 0]),
            "fy_px": float(camera.matrix[1, 1]),
            "cx_px": float(camera.matrix[0, 2]),
            "cy_px": float(camera.matrix[1, 2]),
            "fx_sigma_px": camera.fx_sigma_px,
            "distortion": camera.distortion.tolist(),
            "residual_px": camera.residual_px,
        }
        for side, camera in zip(SIDES, fit.cameras, strict=True)
    }
    return {
        "width_px": fit.size_px[0],
        "height_px": fit.size_px[1],
        **cameras,
        "baseline_mm": fit.stereo.baseline_m * 1e3,
        "baseline_sigma_mm": fit.stereo.baseline_sigma_m * 1e3,
        "rotation": fit.stereo.rotation.ravel().tolist(),
        "translation_m": fit.stereo.translation_m.tolist(),
        "stereo_residual_px": fit.stereo.residual_px,
        "sync": {
            "passed": fit.sync.passed,
            "largest_offset_us": fit.sync.largest_offset_us,
            "stereo_over_single_residual": fit.sync.stereo_ratio,
        },
        "views": len(fit.kept),
        "dropped": [{"pair": view.trigger, "reason": view.reason} for view in fit.dropped],
        "refused": dict(collection.refused),
        "missing": collection.missing,
    }


def words(fit: RigFit, collection: ViewCollection) -> str:
    """Return the calibration as lines for a person."""
    lines = [f"{len(fit.kept)} views of {fit.board}, residual {fit.residual_px:.3f} px"]
    lines += [f"  dropped pair {view.trigger}: {view.reason}" for view in fit.dropped]
    for side, camera in zip(SIDES, fit.cameras, strict=True):
        k = camera.matrix
        lines.append(
            f"{side}: focal length {k[0, 0]:.2f} +- {camera.fx_sigma_px:.2f} px, centre "
            f"{k[0, 2]:.2f}, {k[1, 2]:.2f}, residual {camera.residual_px:.3f} px"
        )
    stereo = fit.stereo
    lines.append(
        f"baseline {stereo.baseline_m * 1e3:.2f} +- {stereo.baseline_sigma_m * 1e3:.2f} mm"
    )
    told = "the cameras expose together" if fit.sync.passed else (
        "the cameras do NOT expose together: check the trigger wire, then `rig latency`"
    )  # fmt: skip
    lines.append(f"sync: {told} (stereo residual {fit.sync.stereo_ratio:.2f} x the single one)")
    if collection.missing:
        lines.append(f"could be better: {'; '.join(collection.missing[:3])}")
    return "\n".join(lines)
