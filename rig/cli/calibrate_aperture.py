"""`rig calibrate-aperture`: turn the secondary's ring until both cameras see the same."""

from __future__ import annotations

import queue
import shutil
import sys
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, Protocol

from cyclopts import Parameter

from rig.calibration.aperture import TOLERANCE_STOPS, Turner
from rig.calibration.aperture_guide import ApertureGuide, ApertureResult
from rig.calibration.files import SCHEMA, today
from rig.cli.big import big, keyboard
from rig.cli.calibration import DEFAULT_CALIBRATION, CalibrationOptions, store, tell
from rig.cli.drive import announce
from rig.cli.interrupt import stop_on_signal
from rig.cli.options import chosen_cameras, make_folder, run_folder
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions, live_page
from rig.config import ApertureCalibration, Calibration
from rig.core.errors import CalibrationError, UsageError
from rig.core.protocols import Source
from rig.core.types import Frame, Pair
from rig.drivers.registry import open_source
from rig.pair import CameraPair
from rig.web.slot import Glimpse, Slot

DEFAULT_CAMERAS = "sim:wall"
PLOT = "histograms.svg"
KEYS = {"o": 5.0, "c": -5.0, "O": 1.0, "C": -1.0}
_LABELS = [["o", "open 5°"], ["c", "close 5°"], ["O", "open 1°"], ["C", "close 1°"]]
_AUTO_FRAMES = 600
_PERSON_PACE_S = 0.1
_SAY_EVERY = 10


class Ring(Protocol):
    """An aperture ring that the program can turn: a simulated one."""

    def turn(self, degrees: float) -> None:
        """Turn it; + opens."""
        ...


def calibrate_aperture(
    *,
    auto: Annotated[bool, Parameter(negative="")] = False,
    tolerance_stops: float = TOLERANCE_STOPS,
    hold_s: float = 2.0,
    options: CalibrationOptions = DEFAULT_CALIBRATION,
    web: WebOptions = DEFAULT_WEB,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Make both lenses let the same light through (thesis 5.1.1), and prove it.

    Both cameras look at a blank bright surface with the same settings. Turn the secondary's ring
    as the display says until it locks; then three exposures check that the cameras are linear.
    The ring of sim:wall is turned with o and c (5 degrees), O and C (1 degree), or by --auto.

    Parameters
    ----------
    auto:
        Let the program turn the simulated ring, by what the pictures show.
    tolerance_stops:
        Largest difference that counts as the same.
    hold_s:
        How long it must stay within the tolerance.
    """
    folder = run_folder(options.out, "calibrate-aperture")
    address = chosen_cameras(options.cameras, DEFAULT_CAMERAS)
    with closing(open_source(address, seed=options.seed, split="test")) as source:
        ring = simulated_ring(source)
        check_somebody_turns(ring, auto, web)
        frames = options.frames or (_AUTO_FRAMES if auto else None)
        announce(source, frames, terminal)
        guide = ApertureGuide(CameraPair(source).limits.primary, tolerance_stops, hold_s)
        session = Session(source, guide, ring, Turner(tolerance_stops) if auto else None)
        result = run(session, frames, web, terminal)
        serials = Pair(*(camera.serial for camera in source.cameras))
    make_folder(folder)
    (folder / PLOT).write_text(result.plot, encoding="utf-8")
    file = store(folder, as_calibration(result, serials, options.lens), options)
    return tell(terminal, words(result), file, abs(result.ratio_stops), tolerance_stops,
                result.passed, named(result))  # fmt: skip


def simulated_ring(source: Source) -> Ring | None:
    """Return the ring of a simulated wall; None where a person must turn a real one."""
    from rig.drivers.scenes.wall import WallScene

    scene = getattr(source, "scene", None)
    return scene.ring if isinstance(scene, WallScene) else None


def check_somebody_turns(ring: Ring | None, auto: bool, web: WebOptions) -> None:
    """Raise UsageError when nobody could turn the ring."""
    if auto and ring is None:
        raise UsageError("--auto turns the simulated ring of sim:wall; these cameras have none")
    if ring is not None and not (auto or web.web or sys.stdin.isatty()):
        raise UsageError(
            "nobody can turn the simulated ring: add --auto or --web, or start in a terminal"
        )


@dataclass(slots=True, eq=False)
class Session:
    """What belongs together while the ring is turned."""

    source: Source
    guide: ApertureGuide
    ring: Ring | None
    turner: Turner | None
    keys: queue.SimpleQueue[str] = field(default_factory=queue.SimpleQueue)

    def press(self, key: str) -> bool:
        """Take a key from the page; it is acted on by the loop."""
        known = self.ring is not None and key in KEYS
        if known:
            self.keys.put(key)
        return known

    def turn(self) -> None:
        """Turn the ring by the keys pressed since, or by what the pictures show."""
        if self.ring is None:
            return
        while not self.keys.empty():
            self.ring.turn(KEYS[self.keys.get()])
        if self.turner is not None and self.guide.turning and self.guide.reading is not None:
            degrees = self.turner.next_degrees(self.guide.reading.ratio_stops)
            if degrees:
                self.ring.turn(degrees)


def run(
    session: Session, frames: int | None, web: WebOptions, terminal: Terminal
) -> ApertureResult:
    """Take pairs until the guide has its result; raises CalibrationError when it never gets one."""
    source, guide = session.source, session.guide
    pair = CameraPair(source)
    by_hand = session.turner is None and not source.real_time
    with ExitStack() as stack:
        stop = stack.enter_context(stop_on_signal())
        pressed = stack.enter_context(keyboard())
        view = stack.enter_context(live_page(web, terminal, session.press))
        while guide.result is None and not stop.requested:
            if frames is not None and pair.triggers >= frames:
                break
            pair.apply(Pair(guide.settings, guide.settings))
            shot = pair.shoot()
            primary, secondary = shot.frames
            if shot.cause or not (isinstance(primary, Frame) and isinstance(secondary, Frame)):
                continue
            guide.see(Pair(primary, secondary))
            for key in pressed():
                session.press(key)
            session.turn()
            show(guide, pair.triggers, terminal)
            if view is not None:
                publish(view.slot, guide, Pair(primary, secondary), session.ring is not None)
            if by_hand:
                time.sleep(_PERSON_PACE_S)
    if guide.result is None:
        raise CalibrationError(not_locked(guide, pair.triggers))
    return guide.result


def not_locked(guide: ApertureGuide, triggers: int) -> str:
    """Return why there is no result, and what to do."""
    if guide.reading is None:
        return f"no light measured within {triggers} triggers; light the surface and start again"
    state = f"{guide.reading.ratio_stops:+.2f} stops"
    told = "; ".join(guide.reading.warnings) or f"{guide.hint}'s ring, then hold still"
    return f"not locked after {triggers} triggers, last {state}: {told}"


def show(guide: ApertureGuide, triggers: int, terminal: Terminal) -> None:
    """Draw the ratio large on a terminal, or say it once a second elsewhere."""
    if terminal.quiet or guide.reading is None:
        return
    ratio = f"{guide.reading.ratio_stops:+.2f}"
    warnings = guide.reading.warnings
    if not sys.stderr.isatty():
        if triggers % _SAY_EVERY == 0:
            terminal.say(" | ".join([f"{ratio} stops", guide.hint, *warnings]))
        return
    columns, lines = shutil.get_terminal_size()
    rows = [big(ratio, columns, max(lines - 8, 5)), "", f"stops   {guide.hint}"]
    rows += [f"! {warning}" for warning in warnings]
    rows += ["", guide.history.spark(columns - 1)]
    print("\033[H\033[2J" + "\n".join(rows), file=sys.stderr, flush=True)


def publish(slot: Slot, guide: ApertureGuide, frames: Pair[Frame], keys: bool) -> None:
    """Leave the state for the page."""
    shown = page_state(guide, frames, keys)
    slot.put(Glimpse(Pair[Frame | None](*frames), partial(dict[str, Any], shown)))


def page_state(guide: ApertureGuide, frames: Pair[Frame], keys: bool) -> dict[str, Any]:
    """Return what the page shows of a calibration."""
    reading = guide.reading
    state: dict[str, Any] = {
        "title": "aperture calibration",
        "status": guide.hint,
        "hint": guide.hint,
        "values": [
            ["exposure", *(f"{frame.used.exposure_us:.0f} us" for frame in frames)],
            ["gain", *(f"{frame.used.gain_db:.1f} dB" for frame in frames)],
        ],
        "history": list(guide.history.stops),
        "keys": _LABELS if keys else [],
    }
    if reading is not None:
        holds = guide.locked or guide.hint == "HOLD"
        state["big"] = f"{reading.ratio_stops:+.2f}"
        state["level"] = "good" if holds and not reading.warnings else "warn"
        state["notes"] = reading.warnings
        state["values"] += [
            ["mean", *(f"{each.mean_dn:.1f}" for each in reading.looks)],
            ["saturated", *(f"{each.saturated:.2%}" for each in reading.looks)],
            ["unevenness", *(f"{each.uneven:.1%}" for each in reading.looks)],
        ]
    return state


def as_calibration(result: ApertureResult, serials: Pair[str], lens: str) -> Calibration:
    """Return the result as it goes into calibration.toml."""
    return Calibration(
        schema=SCHEMA,
        date=today(),
        primary_serial=serials.primary,
        secondary_serial=serials.secondary,
        lens=lens,
        aperture=ApertureCalibration(
            ratio_stops=result.ratio_stops,
            uncertainty_stops=result.uncertainty_stops,
            tolerance_stops=result.tolerance_stops,
            linearity_stops=result.linear.worst_stops,
            exposure_us=result.settings.exposure_us,
            gain_db=result.settings.gain_db,
        ),
    )


def named(result: ApertureResult) -> dict[str, object]:
    """Return every quantity under its name and unit."""
    return {
        "ratio_stops": result.ratio_stops,
        "uncertainty_stops": result.uncertainty_stops,
        "primary_mean_dn": result.means_dn.primary,
        "secondary_mean_dn": result.means_dn.secondary,
        "exposure_us": result.settings.exposure_us,
        "gain_db": result.settings.gain_db,
        "linearity_stops": result.linear.worst_stops,
        "linearity_exposures_us": list(result.linear.exposures_us),
        "linearity_ratios_stops": list(result.linear.ratios_stops),
        "primary_uneven": result.uneven.primary,
        "secondary_uneven": result.uneven.secondary,
        "readings": result.readings,
    }


def words(result: ApertureResult) -> str:
    """Return the result as lines for a person."""
    a, b = result.means_dn
    return (
        f"secondary over primary: {result.ratio_stops:+.4f} +- {result.uncertainty_stops:.4f} "
        f"stops, means {a:.1f} and {b:.1f}\n"
        f"linear within {result.linear.worst_stops:.4f} stops at "
        f"{', '.join(f'{t:.0f}' for t in result.linear.exposures_us)} us\n"
        "lock both rings now"
    )
