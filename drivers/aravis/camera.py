"""One camera of the pair: settings in, proven frames out."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal, NoReturn

from rig.core.errors import CameraError, CameraLost, GrabTimeout
from rig.core.protocols import Clock
from rig.core.types import Auto, Command, Frame, Limits, PixelFormat, Settings
from rig.core.units import NS_PER_S
from rig.drivers import blackfly
from rig.drivers.aravis.binding import Opened, Picture, Spoiled
from rig.drivers.aravis.times import ClockFit, TriggerLog
from rig.drivers.blackfly import CameraType, Done, Step, Value, carry_out

_LOG = logging.getLogger(__name__)

PIXEL_FORMATS: Mapping[str, PixelFormat] = {"BayerRG8": "bayer_rggb8", "Mono8": "mono8"}

INTERRUPTIBLE_S = 0.2
"""The longest wait inside Aravis: Ctrl-C is heard only between waits."""

_SPOILT_BY = {"timeout": "packets missing", "missing packets": "packets missing"}

_EXPOSURE_TOLERANCE_US = 1.0
_GAIN_TOLERANCE_DB = 0.1
_CLOCK_TRIES = 200
"""One look does on an idle computer; on a busy one most looks are too slow to be exact."""


Trigger = Literal["software", "line"]


@dataclass(slots=True)
class Counts:
    """What the camera counted: edges on its input, exposures, pictures its own queue dropped."""

    edges: int | None
    exposures: int | None
    overflows: int | None


class ArmedCamera:
    """An opened camera; every frame is named after the trigger that began its exposure."""

    def __init__(self, opened: Opened, kind: CameraType, log: TriggerLog, clock: Clock) -> None:
        self.log = log
        self._opened = opened
        self._kind = kind
        self._clock = clock
        self._fit = ClockFit(clock, self._latch) if self._can_latch() else None
        self._limits = Limits()
        self._pixel_format: PixelFormat = "mono8"
        self._packet_bytes: int | None = None
        self._trigger: Trigger = "software"
        self._asked: Command | None = None
        self._applied: Command | None = None
        self._last_id: int | None = None
        self._last_sequence = -1
        self._late = 0
        self._counted = Counts(None, None, None)
        self._counted_at = 0

    @property
    def serial(self) -> str:
        """Return the serial number."""
        return self._opened.serial

    @property
    def on_usb(self) -> bool:
        """Return whether this is a USB3 Vision camera."""
        return self._opened.on_usb

    @property
    def limits(self) -> Limits:
        """Return the settings that this camera takes, as its nodes say."""
        return self._limits

    @property
    def size_px(self) -> tuple[int, int]:
        """Return the width and height of a picture."""
        nodes = self._opened.nodes
        return int(nodes.read("Width")), int(nodes.read("Height"))

    @property
    def clock_error_ns(self) -> int:
        """Return how far the camera's times may be off the computer's; 0 where it has none."""
        return self._fit.error_ns if self._fit is not None else 0

    def configure(self, setup: blackfly.Setup, packet_bytes: int | None) -> None:
        """Bring the camera into a known state."""
        nodes = self._opened.nodes
        words = nodes.entries("PixelFormat")
        pixel = next((word for word in PIXEL_FORMATS if word in words), None)
        if pixel is None:
            raise CameraError(
                f"{self.serial}: offers {', '.join(words)}, none of {', '.join(PIXEL_FORMATS)}"
            )
        self._pixel_format = PIXEL_FORMATS[pixel]
        self.carry_out(*blackfly.open_steps(nodes, setup, pixel))
        self.carry_out(*blackfly.chunk_steps())
        self._limits = blackfly.read_limits(nodes, self._kind)
        self._packet_bytes = packet_bytes
        if self._fit is not None:
            self._fit.refit(tries=_CLOCK_TRIES)

    def wait_for(self, trigger: Trigger, *steps: Step) -> None:
        """Carry out the steps of this camera's part, and count what triggers it."""
        self._trigger = trigger
        self.carry_out(*steps)
        try:
            self.carry_out(*blackfly.counter_steps("Line3" if trigger == "line" else None))
        except CameraLost:
            raise
        except CameraError as error:
            _LOG.info("%s: counts no edges or exposures: %s", self.serial, error)

    def carry_out(self, *steps: Step) -> list[Done]:
        """Carry out steps on the camera's nodes."""
        return carry_out(self._opened.nodes, steps, self._kind)

    def start(self) -> None:
        """Arm the camera with a new stream: in an old one Aravis drops ids that begin again."""
        self._last_id, self._last_sequence = None, self.log.count - 1
        self._opened.open_stream(self._packet_bytes)
        self._opened.start()
        self._remember_counts()

    def stop(self) -> None:
        """Stop; frames under way are gone."""
        self._opened.stop()
        self._opened.close_stream()

    def close(self) -> None:
        """Stop and let go of the camera, whatever it says; one that is gone is not asked."""
        gone = self._opened.control_lost
        if not gone:
            try:
                self._opened.stop()
            except CameraError as error:
                _LOG.debug("%s: while closing: %s", self.serial, error)
                gone = isinstance(error, CameraLost)
        self._opened.close(say_goodbye=not gone)

    def limit_exposure(self, exposure_us_max: float) -> None:
        """Allow no exposure longer than this."""
        low_us, high_us = self._limits.exposure_us
        self._limits = replace(self._limits, exposure_us=(low_us, min(high_us, exposure_us_max)))

    def present(self) -> Settings:
        """Return the settings that stand in the nodes."""
        nodes = self._opened.nodes
        return Settings(float(nodes.read(self._node("ExposureTime"))), self._read_gain())

    def apply(self, command: Command) -> Command:
        """Set what the next exposure uses; return the command as the camera rounded it."""
        self._check_control()
        if command == self._asked and self._applied is not None:
            return self._applied
        with self._blaming_control():
            return self._apply(command)

    def _apply(self, command: Command) -> Command:
        was_auto = isinstance(self._asked, Auto)
        self._asked = self._applied = None
        if isinstance(command, Auto):
            applied: Command = self._apply_auto(command)
        else:
            steps = (*(blackfly.manual_steps() if was_auto else ()),)
            done = self.carry_out(*steps, *blackfly.settings_steps(command.clamp(self._limits)))
            applied = _settings(done[-2].now, done[-1].now)
        self._asked, self._applied = command, applied
        return applied

    def fire(self) -> None:
        """Start one exposure by software."""
        self._check_control()
        with self._blaming_control():
            self._opened.nodes.execute("TriggerSoftware")

    def keep_clock(self) -> None:
        """Measure the camera's clock again when the last time is long ago."""
        if self._fit is not None:
            self._check_control()
            with self._blaming_control():
                self._fit.keep_fresh()

    def grab(self, timeout_s: float) -> Frame:
        """Wait for a frame; raises GrabTimeout with what the camera's counters tell."""
        deadline_ns = self._clock.now_ns() + round(timeout_s * NS_PER_S)
        while True:
            self._check_control()
            left_s = (deadline_ns - self._clock.now_ns()) / NS_PER_S
            arrived = self.next_picture(min(max(left_s, 0.0), INTERRUPTIBLE_S))
            if isinstance(arrived, Picture):
                frame = self._prove(arrived)
                if frame is not None:
                    return frame
            elif isinstance(arrived, Spoiled):
                self._check_control()  # a camera that is pulled out spoils its pictures first
                self._refuse(arrived)
            elif left_s <= 0:
                cause = self._why_no_frame()
                raise GrabTimeout(f"{self.serial}: no frame within {timeout_s:g} s; {cause}", cause)

    def next_picture(self, timeout_s: float) -> Picture | Spoiled | None:
        """Return the next picture as it comes, unproven; None when none came in time."""
        assert self._opened.stream is not None
        return self._opened.stream.pop(timeout_s)

    def _prove(self, picture: Picture) -> Frame | None:
        """Return the picture as the frame of its trigger; None for one that belongs to none."""
        host_ns = self._clock.now_ns()
        if self._repeated(picture.frame_id):
            _LOG.warning("%s: frame id %d came again, ignored", self.serial, picture.frame_id)
            return None
        start_ns = self._start_ns(picture.timestamp_ns, host_ns)
        sequence = self.log.sequence_of(start_ns, self.clock_error_ns)
        if sequence is None or sequence <= self._last_sequence:
            _LOG.warning("%s: a picture that no trigger began, ignored", self.serial)
            return None
        self._last_id, self._last_sequence = picture.frame_id, sequence
        return Frame(
            image=picture.image,
            pixel_format=self._pixel_format,
            sequence=sequence,
            device_time_ns=start_ns,
            host_time_ns=host_ns,
            used=self._used(picture, sequence),
        )

    def _start_ns(self, timestamp_ns: int, host_ns: int) -> int:
        """Return the computer's time of an exposure; its arrival for a camera without a clock."""
        return host_ns if self._fit is None else self._fit.to_host_ns(timestamp_ns)

    def _used(self, picture: Picture, sequence: int) -> Settings:
        """Return the settings that the picture was taken with; say so when they came late."""
        if picture.used is None:
            return self.present()
        asked = self._applied
        if isinstance(asked, Settings) and not _alike(picture.used, asked):
            self._late += 1
            if self._late == 1:
                _LOG.warning(
                    "%s: settings came late: trigger %d used %s, not %s; measure with rig latency",
                    self.serial,
                    sequence,
                    _spell(picture.used),
                    _spell(asked),
                )
        return picture.used

    def _repeated(self, frame_id: int) -> bool:
        """Note gaps in the camera's own count; return whether it did not move on."""
        if self._last_id is None:
            return False
        step = steps_between(self._last_id, frame_id)
        if step > 1:
            _LOG.info("%s: %d frames were exposed and did not come", self.serial, step - 1)
        return step <= 0

    def _refuse(self, spoiled: Spoiled) -> None:
        """Raise for a picture of the present trigger that is not whole; pass over older ones."""
        if spoiled.timestamp_ns > 0:
            start_ns = self._start_ns(spoiled.timestamp_ns, self._clock.now_ns())
            sequence = self.log.sequence_of(start_ns, self.clock_error_ns)
            if sequence is None or sequence < self.log.count - 1:
                return
        cause = f"picture incomplete ({_SPOILT_BY.get(spoiled.status, spoiled.status)})"
        raise GrabTimeout(
            f"{self.serial}: {cause}: check the cable and the link's load, see rig doctor", cause
        )

    def _why_no_frame(self) -> str:
        """Return the cause by the counters, the same few words each time; raises CameraLost."""
        if self.log.count == self._counted_at:
            return "no trigger under way"
        if not self._opened.still_ours():
            self._lost_control()
        before, fired = self._counted, self.log.count - self._counted_at
        now = self._read_counts()
        self._counted, self._counted_at = now, self.log.count
        if _grown(before.overflows, now.overflows):
            return "dropped in the camera: its transfer queue overflowed"
        missed_exposure = _behind(before.exposures, now.exposures, fired)
        if self._trigger == "line" and _behind(before.edges, now.edges, fired):
            return "no edge on the trigger wire"
        if missed_exposure:
            return "trigger ignored by the camera"
        return "exposed, but the picture did not come" if now.exposures is not None else "no frame"

    def _remember_counts(self) -> None:
        self._counted, self._counted_at = self._read_counts(), self.log.count

    def _read_counts(self) -> Counts:
        return Counts(
            self._counter("Counter0") if self._trigger == "line" else None,
            self._counter("Counter1"),
            self._integer("TransferQueueOverflowCount"),
        )

    def _counter(self, name: str) -> int | None:
        nodes = self._opened.nodes
        if not (nodes.has("CounterSelector") and nodes.has("CounterValue")):
            return None
        nodes.write("CounterSelector", name)
        return self._integer("CounterValue")

    def _integer(self, name: str) -> int | None:
        nodes = self._opened.nodes
        return int(nodes.read(name)) if nodes.has(name) else None

    def _apply_auto(self, auto: Auto) -> Auto:
        limits = auto.limits.within(self._limits)
        asked = replace(auto, limits=limits, start=auto.start.clamp(limits))
        done = {step.node: step.now for step in self.carry_out(*blackfly.auto_steps(asked))}
        exposure, gain = done[self._node("ExposureTime")], done[self._node("Gain")]
        target = done.get("AutoExposureTargetGreyValue")
        exact = target == blackfly.percent(asked.target_dn)
        return Auto(
            Limits(
                _ends(done, "AutoExposureExposureTime", limits.exposure_us),
                _ends(done, "AutoExposureGain", limits.gain_db),
            ),
            target_dn=asked.target_dn if exact else _number(target) * 255.0 / 100.0,
            damping=_number(done.get("AutoExposureControlLoopDamping", asked.damping)),
            start=_settings(exposure, gain),
            metering=blackfly.metering_of(done, asked.metering),
            priority=asked.priority if "AutoExposureControlPriority" in done else "gain",
        )

    def _can_latch(self) -> bool:
        return self._kind.resolve(self._opened.nodes, "TimestampLatch") is not None

    def _latch(self) -> tuple[int, int, int]:
        nodes = self._opened.nodes
        latch, value = self._node("TimestampLatch"), self._node("TimestampLatchValue")
        before_ns = self._clock.now_ns()
        nodes.execute(latch)
        after_ns = self._clock.now_ns()
        return before_ns, int(nodes.read(value)), after_ns

    def _read_gain(self) -> float:
        return max(float(self._opened.nodes.read(self._node("Gain"))), 0.0)

    def _node(self, name: str) -> str:
        found = self._kind.resolve(self._opened.nodes, name)
        assert found is not None
        return found

    @contextmanager
    def _blaming_control(self) -> Iterator[None]:
        """Turn a refusal into CameraLost when the reason is that the camera dropped us."""
        try:
            yield
        except CameraLost:
            raise
        except CameraError:
            if self._opened.still_ours():
                raise
            self._lost_control()

    def _lost_control(self) -> NoReturn:
        self._opened.lose()
        raise CameraLost(
            f"{self.serial}: no longer listens to this program; check the cable, the power, "
            "and that no other program took the camera"
        )

    def _check_control(self) -> None:
        if self._opened.control_lost:
            self._lost_control()


def steps_between(last_id: int, frame_id: int) -> int:
    """Return how far a frame id moved on; ids of 16 bits start again at 0 or 1.

    >>> steps_between(7, 8), steps_between(65535, 1), steps_between(65535, 0), steps_between(5, 5)
    (1, 1, 1, 0)
    """
    step = frame_id - last_id
    if step < 0 and last_id <= 0xFFFF:
        wrapped = step + 0x10000
        return wrapped - 1 if frame_id > 0 and wrapped > 1 else wrapped
    return step


def _alike(used: Settings, asked: Settings) -> bool:
    near = abs(used.exposure_us - asked.exposure_us) <= _EXPOSURE_TOLERANCE_US
    return near and abs(used.gain_db - asked.gain_db) <= _GAIN_TOLERANCE_DB


def _spell(settings: Settings) -> str:
    return f"{settings.exposure_us:g} us {settings.gain_db:g} dB"


def _behind(before: int | None, now: int | None, fired: int) -> bool:
    return before is not None and now is not None and now - before < fired


def _grown(before: int | None, now: int | None) -> bool:
    return before is not None and now is not None and now > before


def _number(value: Value | None) -> float:
    assert isinstance(value, int | float)
    return float(value)


def _settings(exposure: Value | None, gain: Value | None) -> Settings:
    return Settings(_number(exposure), max(_number(gain), 0.0))


def _ends(
    done: Mapping[str, Value | None], name: str, asked: tuple[float, float]
) -> tuple[float, float]:
    low, high = done.get(f"{name}LowerLimit"), done.get(f"{name}UpperLimit")
    return (
        asked[0] if low is None else _number(low),
        asked[1] if high is None else _number(high),
    )
