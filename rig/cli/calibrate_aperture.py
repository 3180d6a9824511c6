"""`rig calibrate-aperture`: turn the secondary's ring until both cameras see the same."""

from __future__ import annotations

import queue
import sys
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, Protocol

from cyclopts import Parameter

from rig.calibration.aperture.guide import ApertureGuide, ApertureResult
from rig.calibration.aperture.hand import Hand
from rig.calibration.aperture.linearity import LINEARITY_STOPS
from rig.calibration.aperture.reading import TOLERANCE_STOPS
from rig.calibration.files import SCHEMA, today
from rig.cli.aperture_display import KEYS, page_state, show
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
from rig.cli.keyboard import keyboard
from rig.cli.options import chosen_cameras, make_folder, run_folder
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions, live_page
from rig.config import ApertureCalibration, Calibration
from rig.core.errors import CalibrationError, UsageError
from rig.core.protocols import Source
from rig.core.types import Frame, Pair
from rig.drivers.registry import open_source
from rig.pair import CameraPair, both_frames
from rig.web.slot import Glimpse

DEFAULT_CAMERAS = "sim:wall"
PLOT = "histograms.svg"
_AUTO_FRAMES = 600
_PERSON_PACE_S = 0.1


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
    known: KnownOptions = DEFAULT_KNOWN,
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
    folder, before = run_folder(options.out, "calibrate-aperture"), earlier(known)
    address = chosen_cameras(options.cameras, DEFAULT_CAMERAS)
    with closing(open_source(address, seed=options.seed, split="test")) as source:
        ring = simulated_ring(source)
        check_somebody_turns(ring, auto, web)
        frames = options.frames or (_AUTO_FRAMES if auto else None)
        announce(source, frames, terminal)
        limits = CameraPair(source).limits
        guide = ApertureGuide(limits.primary.within(limits.secondary), tolerance_stops, hold_s)
        session = Session(source, guide, ring, Hand(tolerance_stops) if auto else None)
        triggers = run(session, frames, web, terminal)
        serials = Pair(*(camera.serial for camera in source.cameras))
    result = guide.result
    if result is None:
        raise CalibrationError(not_locked(guide, triggers))
    make_folder(folder)
    (folder / PLOT).write_text(result.plot, encoding="utf-8")
    file = store(folder, as_calibration(result, serials, known.lens), before)
    return tell(terminal, words(result), file, abs(result.linear.ratio_stops), tolerance_stops,
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
    hand: Hand | None
    keys: queue.SimpleQueue[str] = field(default_factory=queue.SimpleQueue)

    def press(self, key: str) -> bool:
        """Take a key from the terminal or the page; it is acted on by the loop."""
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
        if self.hand is not None and self.guide.turning and self.guide.reading is not None:
            degrees = self.hand.next_degrees(self.guide.reading.ratio_stops)
            if degrees:
                self.ring.turn(degrees)


def run(session: Session, frames: int | None, web: WebOptions, terminal: Terminal) -> int:
    """Take pairs until the guide has its result, or it is ended; return the triggers it took."""
    source, guide = session.source, session.guide
    pair = CameraPair(source)
    in_hand = session.ring is not None and session.hand is None
    with ExitStack() as stack:
        stop = stack.enter_context(stop_on_signal("leaving the calibration"))
        pressed = stack.enter_context(keyboard())
        view = stack.enter_context(live_page(web, terminal, source.address, session.press))
        while guide.result is None and not stop.requested:
            if frames is not None and pair.triggers >= frames:
                break
            pair.apply(Pair(guide.settings, guide.settings))
            seen = both_frames(pair.shoot())
            if seen is None:
                continue
            guide.see(seen)
            for key in pressed():
                session.press(key)
            session.turn()
            show(guide, pair.triggers, in_hand, terminal)
            if view is not None:
                shown = page_state(guide, seen, in_hand)
                view.slot.put(Glimpse(Pair[Frame | None](*seen), partial(dict[str, Any], shown)))
            if in_hand:
                time.sleep(_PERSON_PACE_S)
    if stop.requested and guide.result is None:
        raise KeyboardInterrupt
    return pair.triggers


def not_locked(guide: ApertureGuide, triggers: int) -> str:
    """Return why there is no result, and what to do."""
    if guide.reading is None:
        return f"no light measured within {triggers} triggers; light the surface and start again"
    state = f"{guide.reading.ratio_stops:+.2f} stops"
    turn = f"{guide.hint.lower()} the secondary's ring, then hold still"
    told = "; ".join(guide.reading.warnings) or turn
    return f"not locked after {triggers} triggers, last {state}: {told}"


def as_calibration(result: ApertureResult, serials: Pair[str], lens: str) -> Calibration:
    """Return the result as it goes into calibration.toml."""
    return Calibration(
        schema=SCHEMA,
        date=today(),
        primary_serial=serials.primary,
        secondary_serial=serials.secondary,
        lens=lens,
        aperture=ApertureCalibration(
            ratio_stops=result.linear.ratio_stops,
            uncertainty_stops=result.linear.error_stops,
            tolerance_stops=result.tolerance_stops,
            linearity_stops=result.linear.worst_stops,
            exposure_us=result.settings.exposure_us,
            gain_db=result.settings.gain_db,
        ),
    )


def named(result: ApertureResult) -> dict[str, object]:
    """Return every quantity under its name and unit."""
    return {
        "ratio_stops": result.linear.ratio_stops,
        "uncertainty_stops": result.linear.error_stops,
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
    linear = result.linear
    crooked = (
        ""
        if linear.worst_stops <= LINEARITY_STOPS
        else "\nnot linear: switch gamma off (GammaEnable), or the light is not steady"
    )
    return (
        f"secondary over primary: {linear.ratio_stops:+.4f} +- {linear.error_stops:.4f} "
        f"stops, means {a:.1f} and {b:.1f}\n"
        f"linear within {linear.worst_stops:.4f} stops at "
        f"{', '.join(f'{t:.0f}' for t in linear.exposures_us)} us\n"
        f"lock both rings now{crooked}"
    )
