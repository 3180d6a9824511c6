"""The aperture calibration's parts: looks, ratio, metering, lock, linearity, and the hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.calibration.aperture.guide import ApertureGuide
from rig.calibration.aperture.hand import Hand
from rig.calibration.aperture.history import History
from rig.calibration.aperture.linearity import linearity
from rig.calibration.aperture.lock import Lock
from rig.calibration.aperture.meter import BRIGHT_DN, Meter
from rig.calibration.aperture.reading import Reading, direction, ratio_stops
from rig.calibration.aperture.surface import Look, histogram, look
from rig.cli.aperture_display import screen
from rig.cli.big import big
from rig.core.errors import CalibrationError
from rig.core.types import Frame, Limits, Pair, Settings
from rig.core.units import gain_factor

LIMITS = Limits()
EXACT = [Pair(0.0, 0.0)] * 3
FINE = Look(120.0, 0.0, 0.01)


def frame(image: np.ndarray, settings: Settings, number: int = 0) -> Frame:
    return Frame(image, "bayer_rggb8", number, number * 100_000_000, 0, settings)


def picture(
    settings: Settings, dn_per_ms: float, rng: np.random.Generator, gamma: float = 1.0
) -> np.ndarray:
    """Return a noisy blank surface, black level 4."""
    signal = dn_per_ms * settings.exposure_us / 1e3 * gain_factor(settings.gain_db)
    share = np.clip((4 + signal + rng.normal(0, 1.5, (120, 160))) / 255, 0, 1)
    return np.rint(255 * share ** (1 / gamma)).astype(np.uint8)


def guided(dn_per_ms: Pair[float], frames: int, gamma: float = 1.0) -> ApertureGuide:
    """Return the guide after some pairs of two cameras that nobody turns."""
    guide, rng = ApertureGuide(LIMITS, 0.02, 1.0), np.random.default_rng(0)
    for number in range(frames):
        used = guide.settings
        shots = (frame(picture(used, dn, rng, gamma), used, number) for dn in dn_per_ms)
        guide.see(Pair(*shots))
        if guide.result is not None:
            break
    return guide


def test_equal_cameras_lock_with_an_honest_uncertainty() -> None:
    guide = guided(Pair(20.0, 20.1), 200)
    assert guide.result is not None
    assert guide.result.passed
    off = guide.result.linear.ratio_stops - math.log2(20.1 / 20.0)
    assert 0 < guide.result.linear.error_stops < 0.003
    assert abs(off) < 3 * guide.result.linear.error_stops
    assert guide.result.plot.count("<polyline") == 2


def test_unequal_cameras_do_not_lock_and_are_told_to_turn() -> None:
    guide = guided(Pair(20.0, 30.0), 100)
    assert guide.result is None and not guide.locked
    assert guide.hint == "CLOSE"
    assert guide.reading is not None
    assert guide.reading.ratio_stops == pytest.approx(math.log2(1.5), abs=0.01)


def test_a_gamma_camera_fails_the_linearity_check() -> None:
    guide = guided(Pair(20.0, 20.0), 200, gamma=2.2)
    assert guide.result is not None
    assert not guide.result.passed
    assert guide.result.linear.worst_stops > 0.05


def test_a_ring_that_moves_while_it_is_locked_must_be_turned_again() -> None:
    guide, rng = ApertureGuide(LIMITS, 0.02, 0.5), np.random.default_rng(0)
    for number in range(60):
        used, dn = guide.settings, 26.0 if guide.locked else 20.0
        shots = (frame(picture(used, each, rng), used, number) for each in (20.0, dn))
        guide.see(Pair(*shots))
    assert guide.result is None


def test_a_dim_surface_is_metered_by_gain_once_the_exposure_is_at_its_end() -> None:
    guide = guided(Pair(0.5, 0.5), 60)
    assert guide.result is not None
    assert guide.result.settings.exposure_us == 30_000.0
    assert guide.result.settings.gain_db > 10
    assert guide.result.means_dn.primary == pytest.approx(BRIGHT_DN, rel=0.25)


def test_a_surface_that_is_too_bright_is_named() -> None:
    meter = Meter(Settings(1_000.0, 0.0), LIMITS)
    with pytest.raises(CalibrationError, match="too bright even at the shortest exposure: take"):
        for _ in range(30):
            meter.see(Pair(Look(255.0, 1.0, 0.0), FINE))


def test_light_that_jumps_is_named() -> None:
    meter, rng = Meter(Settings(1_000.0, 0.0), LIMITS), np.random.default_rng(0)
    with pytest.raises(CalibrationError, match="is the light steady"):
        for _ in range(30):
            mean = float(rng.choice([30.0, 250.0]))
            meter.see(Pair(Look(mean, 0.0, 0.0), Look(mean, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (Look(250.0, 0.2, 0.0), "saturated: take light away"),
        (Look(5.0, 0.0, 0.0), "too dark: add light"),
        (Look(120.0, 0.0, 0.3), "uneven surface: light it from both sides"),
    ],
)
def test_what_speaks_against_a_reading_is_named(bad: Look, words: str) -> None:
    (told,) = Reading(0.0, Pair(FINE, bad)).warnings
    assert told.startswith(words)


def test_light_from_one_side_is_uneven_and_a_lens_that_falls_off_is_not() -> None:
    y, x = np.mgrid[-1:1:480j, -1:1:640j]
    dim_corners = 120 * (1 - 0.25 * (x**2 + y**2))
    one_side = 120 * (1 + 0.1 * x)
    settings = Settings(1_000.0, 0.0)
    assert look(frame(dim_corners.astype(np.uint8), settings)).uneven < 0.02
    assert look(frame(one_side.astype(np.uint8), settings)).uneven > 0.1


def test_a_histogram_sums_to_one_and_says_where_the_pixels_are() -> None:
    image = np.full((48, 64), 90, np.uint8)
    image[:12] = 200
    shares = histogram(frame(image, Settings(1_000.0, 0.0)))
    assert shares.sum() == pytest.approx(1.0)
    assert (shares[90], shares[200]) == (0.75, 0.25)


def test_the_ratio_is_that_of_the_light_without_black_levels() -> None:
    assert ratio_stops(Pair(104.0, 205.0), Pair(4.0, 5.0)) == pytest.approx(1.0)


@pytest.mark.parametrize(("stops", "word"), [(0.3, "CLOSE"), (-0.3, "OPEN"), (0.01, "HOLD")])
def test_the_direction_is_that_of_the_secondarys_ring(stops: float, word: str) -> None:
    assert direction(stops, 0.02) == word


def test_the_lock_wants_an_unbroken_time() -> None:
    lock, second_ns = Lock(0.02, 2.0), 1_000_000_000
    assert not lock.see(0.01, 0)
    assert not lock.see(0.01, second_ns)
    assert not lock.see(0.05, 2 * second_ns)
    assert not lock.see(0.01, 3 * second_ns)
    assert not lock.see(-0.01, 4 * second_ns)
    assert lock.see(0.0, 5 * second_ns)
    assert lock.readings == 3


def test_a_line_is_linear_and_a_bend_is_not() -> None:
    exposures = [350.0, 700.0, 1_000.0]
    line = [Pair(4 + 0.1 * t, 5 + 0.1 * t) for t in exposures]
    found = linearity(exposures, line, EXACT)
    assert found.worst_stops < 1e-9
    assert found.black_dn == pytest.approx((4.0, 5.0))
    assert found.ratios_stops == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    bent = [Pair(10 * t**0.45, 0.1 * t) for t in exposures]
    assert linearity(exposures, bent, EXACT).worst_stops > 0.05


def test_a_hand_finds_the_place_on_a_ring_of_any_scale() -> None:
    for degrees_per_stop in (10.0, 30.0, 90.0):
        hand, stops = Hand(0.02), -1.3
        for _ in range(60):
            stops += hand.next_degrees(stops) / degrees_per_stop
        assert abs(stops) <= 0.02


def test_a_ring_that_is_stuck_is_named() -> None:
    hand = Hand(0.02)
    with pytest.raises(CalibrationError, match=r"does not change the pictures .* \+0\.50 stops"):
        for _ in range(20):
            hand.next_degrees(0.5)


def test_the_history_is_high_where_the_ratio_was_far_from_zero() -> None:
    history = History()
    history.stops.extend([1.0, -0.5, 0.0])
    assert history.line(80) == "█▅▁"
    assert history.line(2) == "█▁"


@pytest.mark.parametrize(("columns", "lines"), [(80, 24), (132, 50), (40, 12)])
def test_a_person_reads_ratio_and_direction_from_two_metres(columns: int, lines: int) -> None:
    """On a laptop 80 x 24 cells are 2.6 by 5 mm: 9 rows are 45 mm high, as on a departure board."""
    guide = guided(Pair(20.0, 30.0), 20)
    rows = screen(guide, True, columns, lines).split("\n")
    assert len(rows) < lines
    ratio = f"{guide.reading.ratio_stops:+.2f}" if guide.reading else ""
    half = max((lines - 5) // 2, 5)
    for words in (ratio, "CLOSE"):
        drawn = big(words, columns, half)
        assert len(drawn) >= 5 and max(map(len, drawn)) <= columns
        text = "\n".join(rows)
        assert all(row.rstrip() in text for row in drawn[: lines - 14])
