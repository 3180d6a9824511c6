"""The bracket of one camera: finds where it saturates, then goes through exposures and gains."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from rig.calibration.aperture.reading import MOST_UNEVEN
from rig.calibration.aperture.surface import look
from rig.calibration.response.step import Step, centre, summarise_step
from rig.core.errors import CalibrationError
from rig.core.types import Frame, Limits, Settings, Side
from rig.core.units import gain_factor

LONGEST_US = 3_000_000.0
GAINS_DB = (0.0, 12.0, 24.0)
FRAMES_EACH = 4

_STEPS = (48, 12, 12)
_BEYOND = 1.1
_START_US = 1_000.0
_WHITE_DN, _ROUNDING_DN = 255.0, 0.5
_PLATEAU = 1.01
_NEAR = 1.06
_FASTER, _SLOWER, _LESS = 4.0, 1.5, 0.25
_HALF_DN = 100.0
_REFERENCE = 0.5
_MOST_FLICKER = 0.01
_MOST_DRIFT = 0.02
_MOST_LATE = 12


@dataclass(slots=True, eq=False)
class Bracket:
    """Takes the next picture with `settings`; `steps` are complete once it is `done`.

    The first and the last step are the same, at half the saturation: they tell a lamp that drifts.
    """

    side: Side
    limits: Limits
    settings: Settings = field(init=False)
    steps: list[Step] = field(default_factory=list)
    top_us: float | None = None
    _dark_us: float = 0.0
    _full_us: float = math.inf
    _full_dn: float = _WHITE_DN - _ROUNDING_DN
    _last_dn: float = 0.0
    _plan: list[Settings] = field(default_factory=list)
    _frames: list[Frame] = field(default_factory=list)
    _late: int = 0

    def __post_init__(self) -> None:
        self.settings = self._at(_START_US, 0.0)

    @property
    def done(self) -> bool:
        """Return whether every step was taken."""
        return bool(self._plan) and len(self.steps) == len(self._plan)

    @property
    def progress(self) -> tuple[int, int]:
        """Return how many steps are done, of how many; (0, 0) before that is known."""
        return len(self.steps), len(self._plan)

    @property
    def hint(self) -> str:
        """Return how far it is, in a few words."""
        if not self._plan:
            return "looking for saturation"
        now = min(len(self.steps) + 1, len(self._plan))
        used = self.settings
        return (
            f"step {now} of {len(self._plan)}: {used.exposure_us:.0f} us at {used.gain_db:.0f} dB"
        )

    def see(self, frame: Frame) -> None:
        """Take one picture; raises CalibrationError when the surface cannot be measured."""
        if self.done or not self._is_fresh(frame):
            return
        if not self._plan:
            self._meter(float(centre(frame).mean()), frame)
            return
        self._frames.append(frame)
        if len(self._frames) == FRAMES_EACH:
            self._finish_step(summarise_step(self._frames))

    def _is_fresh(self, frame: Frame) -> bool:
        """Return whether the settings have reached the picture; free-running cameras take time."""
        used, asked = frame.used, self.settings
        fresh = (
            abs(used.exposure_us - asked.exposure_us) <= 1 + 0.01 * asked.exposure_us
            and abs(used.gain_db - asked.gain_db) <= 0.2
        )
        self._late = 0 if fresh else self._late + 1
        if self._late > _MOST_LATE:
            raise CalibrationError(
                f"{self.side}: asked for {asked.exposure_us:.0f} us and {asked.gain_db:.1f} dB, "
                f"got {used.exposure_us:.0f} us and {used.gain_db:.1f} dB for {_MOST_LATE} "
                "pictures; switch the camera's own exposure control off"
            )
        return fresh

    def _meter(self, mean_dn: float, frame: Frame) -> None:
        """Search for the shortest exposure that saturates, to 6 %."""
        used_us = frame.used.exposure_us
        last_dn, self._last_dn = self._last_dn, mean_dn
        flat = last_dn > _HALF_DN and mean_dn < _PLATEAU * last_dn and used_us > self._dark_us
        if flat and self._full_us == math.inf:
            self._full_dn = min(mean_dn, _WHITE_DN) - _ROUNDING_DN
        if mean_dn >= self._full_dn:
            self._full_us = min(self._full_us, used_us)
        else:
            self._dark_us = max(self._dark_us, used_us)
        if self._full_us < _NEAR * self._dark_us:
            self.top_us = self._full_us
            self._make_plan(self._full_us)
            return
        self.settings = self._at(self._next_us(mean_dn), 0.0)
        if self.settings.exposure_us == used_us:
            raise CalibrationError(self._cannot(mean_dn, used_us))

    def _next_us(self, mean_dn: float) -> float:
        if self._full_us == math.inf:
            return self._dark_us * (_FASTER if mean_dn < _HALF_DN else _SLOWER)
        if self._dark_us == 0.0:
            return self._full_us * _LESS
        return math.sqrt(self._full_us * self._dark_us)

    def _cannot(self, mean_dn: float, used_us: float) -> str:
        if mean_dn >= self._full_dn or self._dark_us == 0.0:
            return (
                f"{self.side}: saturated even at {used_us:.0f} us: too bright; take light away "
                "or close the aperture"
            )
        return (
            f"{self.side}: mean {mean_dn:.0f} of 255 at {used_us / 1e3:.0f} ms, not saturated: too "
            "dark; add light or open the aperture"
        )

    def _make_plan(self, top_us: float) -> None:
        reference = self._at(_REFERENCE * top_us, 0.0)
        plan = [reference]
        for gain_db, count in zip(GAINS_DB, _STEPS, strict=True):
            if gain_db <= self.limits.gain_db[1]:
                longest_us = _BEYOND * top_us / gain_factor(gain_db)
                steps = (self._at(longest_us * (k / count) ** 2, gain_db) for k in range(count + 1))
                plan += dict.fromkeys(steps)
        self._plan = [*plan, reference]
        self.settings = reference

    def _at(self, exposure_us: float, gain_db: float) -> Settings:
        longest_us = min(self.limits.exposure_us[1], LONGEST_US)
        bounds = Limits((self.limits.exposure_us[0], longest_us), self.limits.gain_db)
        return Settings(float(max(round(exposure_us), 1)), gain_db).clamp(bounds)

    def _finish_step(self, step: Step) -> None:
        self._check_even(self._frames[0])
        self._frames.clear()
        self.steps.append(step)
        if step.flicker > _MOST_FLICKER:
            raise CalibrationError(
                f"{self.side}: the light flickers: {step.flicker:.1%} from picture to picture at "
                f"{step.exposure_us:.0f} us; use daylight or a lamp on direct current"
            )
        if not self.done:
            self.settings = self._plan[len(self.steps)]
            return
        drift = step.mean_dn / self.steps[0].mean_dn - 1
        if abs(drift) > _MOST_DRIFT:
            raise CalibrationError(
                f"{self.side}: the light changed by {drift:+.1%} during the bracket; let the lamp "
                "warm up, keep the cameras still, and start again"
            )

    def _check_even(self, frame: Frame) -> None:
        uneven = look(frame).uneven
        if not self.steps and uneven > MOST_UNEVEN:
            raise CalibrationError(
                f"{self.side}: uneven surface: opposite parts differ by {uneven:.0%} of the mean, "
                f"at most {MOST_UNEVEN:.0%}; light it from both sides, or come closer"
            )
