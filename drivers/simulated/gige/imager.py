"""Pictures by the registers: triggers, lines, counters and chunks around a simulated camera."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import msgspec

from rig.config import CameraModel
from rig.core.types import Auto, Command, Limits, Metering, Priority, Settings
from rig.core.units import NS_PER_S, us_to_ns
from rig.drivers.simulated.camera import Overlap, Shot, SimulatedCamera, TakePicture, Wiring
from rig.drivers.simulated.gige.faults import Faults
from rig.drivers.simulated.gige.features import CHUNKS, Feature
from rig.drivers.simulated.gige.gvsp import Picture, chunk_bytes
from rig.drivers.simulated.gige.registers import Registers
from rig.drivers.simulated.program import round_command
from rig.drivers.simulated.world import Link, Wire, World

Edge = Callable[[bool, int, int], None]
"""Receives an edge: whether it rises, its time in nanoseconds, and the number of its trigger."""

_METERINGS: Mapping[str, Metering] = {"Average": "average", "Partial": "partial", "Spot": "spot"}
_PRIORITIES: Mapping[str, Priority] = {"Gain": "gain", "ExposureTime": "exposure"}
_INSTANT_BYTES_PER_S = 1e18
_EXPOSURE_FEATURES = frozenset(
    {
        "ExposureTime",
        "Gain",
        "ExposureAuto",
        "GainAuto",
        "AutoExposureTargetGreyValue",
        "AutoExposureControlLoopDamping",
        "AutoExposureExposureTimeLowerLimit",
        "AutoExposureExposureTimeUpperLimit",
        "AutoExposureGainLowerLimit",
        "AutoExposureGainUpperLimit",
    }
)
_SIZE_FEATURES = frozenset({"Width", "Height", "ChunkModeActive", "ChunkEnable"})
_FREE_RUN_HEADROOM_NS = 1_000


@dataclass(frozen=True, slots=True)
class Optics:
    """What is behind the registers: a camera model and where its pictures come from."""

    serial: str
    model: CameraModel
    take_picture: TakePicture
    latency_frames: int = 0


@dataclass(slots=True)
class Imager:
    """Takes pictures as the registers say; the frame ids count exposures since the start.

    `epoch_ns` is what the camera's own clock counts from, `id_bits` how far its frame ids count.
    A camera at its own pace that `may_slow_down` waits for a computer that makes its pictures more
    slowly than it exposes.
    """

    world: World
    registers: Registers
    optics: Optics
    faults: Faults
    epoch_ns: int = 0
    id_bits: int = 64
    first_id: int = 0
    may_slow_down: bool = False
    output_wires: dict[int, list[Edge]] = field(default_factory=dict)
    _camera: SimulatedCamera | None = None
    _sequence: int = 0
    _sent: int = 0

    def __post_init__(self) -> None:
        self._tell_size()

    @property
    def taking(self) -> bool:
        """Return whether pictures are being taken."""
        return self._camera is not None

    @property
    def software_triggers(self) -> int:
        """Return how many software triggers, or frames of its own pace, came since the start."""
        return self._sequence

    def now_ns(self) -> int:
        """Return the time of the camera's own clock."""
        return self.world.clock.now_ns() - self.epoch_ns

    def obey(self, feature: Feature) -> None:
        """Do what the writing of a feature sets off."""
        commands = {
            "AcquisitionStart": self.start,
            "AcquisitionStop": self.stop,
            "TriggerSoftware": self.software_trigger,
            "TimestampLatch": self._latch,
        }
        if feature.name in _EXPOSURE_FEATURES:
            self._change_settings()
        elif feature.name in _SIZE_FEATURES:
            self._tell_size()
        elif feature.name in commands:
            commands[feature.name]()

    def start(self) -> None:
        """Begin to take pictures, or wait for triggers."""
        self._sequence = self._sent = 0
        self._camera = self._build()
        command = self._command()
        if isinstance(command, Auto):
            self._camera.apply(command)
        if not self._triggered():
            self._run_free(self.world.clock.now_ns(), self._camera)

    def stop(self) -> None:
        """Stop at once; pictures under way are gone."""
        self._camera = None

    def software_trigger(self) -> None:
        """Take the software trigger, when it is what the camera waits for."""
        self.world.catch_up()
        if self._triggered() and self._source() == "Software":
            self._sequence += 1
            self._expose(self.world.clock.now_ns(), self._sequence - 1)

    def edge_on(self, line: int) -> Edge:
        """Return what receives the edges on one input line."""

        def receive(rising: bool, time_ns: int, sequence: int) -> None:
            if rising and self.faults.lose_edges > 0:
                self.faults.lose_edges -= 1
                return
            if rising:
                self._count(f"Line{line}")
            wanted = {"RisingEdge": rising, "FallingEdge": not rising}
            listens = self._triggered() and self._source() == f"Line{line}"
            if listens and wanted.get(self._selected("TriggerActivation"), True):
                self._after_delay(time_ns, sequence)

        return receive

    def _change_settings(self) -> None:
        """Obey the registers of exposure and gain; what was rounded can be read back."""
        command = self._command()
        if self._camera is not None:
            command = self._camera.apply(command)
        else:
            command = round_command(command, self.optics.model.controls)
        if isinstance(command, Settings):
            self._show(command)

    def next_picture(self) -> Picture | None:
        """Return the next picture that was read out, without waiting; None when there is none."""
        shot = self._camera.next_arrived() if self._camera is not None else None
        if shot is None:
            return None
        self._sent += 1
        if self.faults.lose_pictures > 0:
            self.faults.lose_pictures -= 1
            return None
        if isinstance(self._command(), Auto):
            self._show(shot.used)
        return self._picture(shot)

    def _tell_size(self) -> None:
        """Show the size of a picture with its chunks."""
        size = int(self.registers.number("Width") * self.registers.number("Height"))
        if self.registers.number("ChunkModeActive"):
            size += chunk_bytes([8 for _ in self._enabled_chunks()])
        self.registers.set_number("PayloadSize", size)

    def _latch(self) -> None:
        self.registers.set_number("TimestampLatchValue", self.now_ns())

    def _build(self) -> SimulatedCamera:
        numbers = self.registers.number
        controls = msgspec.structs.replace(
            self.optics.model.controls,
            initial_exposure_us=numbers("ExposureTime"),
            initial_gain_db=numbers("Gain"),
        )
        timing = msgspec.structs.replace(self.optics.model.timing, delivery_s=0.0)
        model = msgspec.structs.replace(self.optics.model, controls=controls, timing=timing)
        output = Wire(self.world, 0, [self._rose], [self._fell])
        link = Link(self.world, _INSTANT_BYTES_PER_S)
        waits = self._triggered() and self._selected("TriggerOverlap") == "Off"
        overlap: Overlap = "off" if waits else "readout"
        return SimulatedCamera(
            self.optics.serial,
            model,
            Wiring(self.world, link, output, software_trigger=True, overlap=overlap),
            self.optics.take_picture,
            self.optics.latency_frames,
        )

    def _selected(self, name: str) -> str:
        """Return a feature of the trigger that starts a frame."""
        frame_start = self.registers.copy_of("TriggerSelector", "FrameStart")
        return self.registers.word_of(name, frame_start)

    def _triggered(self) -> bool:
        return self._selected("TriggerMode") == "On"

    def _source(self) -> str:
        return self._selected("TriggerSource")

    def _after_delay(self, time_ns: int, sequence: int) -> None:
        due_ns = time_ns + us_to_ns(self.registers.number("TriggerDelay"))
        self.world.at(due_ns, lambda now_ns: self._expose(now_ns, sequence))

    def _expose(self, time_ns: int, sequence: int) -> None:
        if self.faults.ignore_triggers > 0:
            self.faults.ignore_triggers -= 1
        elif self._camera is not None:
            self._camera.on_trigger(time_ns, sequence)

    def _run_free(self, time_ns: int, camera: SimulatedCamera) -> None:
        """Expose again and again, at the frame rate where one is set, while `camera` is in use."""
        if self._camera is not camera:
            return
        camera.on_trigger(time_ns, self._sequence)
        self._sequence += 1
        settings = self._show_now()
        shortest_ns = us_to_ns(settings.exposure_us) + round(
            self.optics.model.timing.readout_s * NS_PER_S
        )
        period_ns = shortest_ns + _FREE_RUN_HEADROOM_NS
        if self.registers.number("AcquisitionFrameRateEnable"):
            wanted_ns = round(NS_PER_S / self.registers.number("AcquisitionFrameRate"))
            period_ns = max(wanted_ns, us_to_ns(settings.exposure_us) + _FREE_RUN_HEADROOM_NS)
        next_ns = time_ns + period_ns
        if self.may_slow_down:
            next_ns = max(next_ns, self.world.clock.now_ns())
        self.world.at(next_ns, lambda now_ns: self._run_free(now_ns, camera))

    def _show_now(self) -> Settings:
        return Settings(self.registers.number("ExposureTime"), self.registers.number("Gain"))

    def _rose(self, time_ns: int, sequence: int) -> None:
        self._count("ExposureStart")
        self._drive_lines(True, time_ns, sequence)

    def _fell(self, time_ns: int, sequence: int) -> None:
        self._drive_lines(False, time_ns, sequence)

    def _drive_lines(self, active: bool, time_ns: int, sequence: int) -> None:
        for line, edges in self.output_wires.items():
            is_output = self.registers.word_of("LineMode", line) == "Output"
            if is_output and self.registers.word_of("LineSource", line) == "ExposureActive":
                rising = active != bool(self.registers.number("LineInverter", line))
                for edge in edges:
                    edge(rising, time_ns, sequence)

    def _count(self, event: str) -> None:
        for copy in range(2):
            if self.registers.word_of("CounterEventSource", copy) == event:
                value = self.registers.number("CounterValue", copy)
                self.registers.set_number("CounterValue", value + 1, copy)

    def _command(self) -> Command:
        """Return what the registers ask for."""
        settings = self._show_now()
        exposes = self.registers.word_of("ExposureAuto") == "Continuous"
        amplifies = self.registers.word_of("GainAuto") == "Continuous"
        if not (exposes or amplifies):
            return settings
        numbers = self.registers.number
        low_us = numbers("AutoExposureExposureTimeLowerLimit")
        high_us = numbers("AutoExposureExposureTimeUpperLimit")
        low_db, high_db = (
            numbers("AutoExposureGainLowerLimit"),
            numbers("AutoExposureGainUpperLimit"),
        )
        return Auto(
            Limits(
                (low_us, high_us) if exposes else (settings.exposure_us,) * 2,
                (low_db, high_db) if amplifies else (settings.gain_db,) * 2,
            ),
            target_dn=numbers("AutoExposureTargetGreyValue") * 255.0 / 100.0,
            damping=numbers("AutoExposureControlLoopDamping"),
            start=settings,
            metering=self._metering(),
            priority=_PRIORITIES[self.registers.word_of("AutoExposureControlPriority")],
        )

    def _metering(self) -> Metering:
        """Return what the law looks at: this camera's region is its lower part, or nothing."""
        mode = _METERINGS[self.registers.word_of("AutoExposureMeteringMode")]
        region = self.registers.number("AasRoiEnable") and self.registers.number("AasRoiOffsetY")
        return "lower" if region and mode == "average" else mode

    def _show(self, settings: Settings) -> None:
        self.registers.set_number("ExposureTime", settings.exposure_us)
        self.registers.set_number("Gain", settings.gain_db)

    def _enabled_chunks(self) -> list[str]:
        entries = dict(self.registers.table["ChunkSelector"].entries)
        return [
            name
            for name in CHUNKS
            if name != "Image" and self.registers.number("ChunkEnable", entries[name])
        ]

    def _picture(self, shot: Shot) -> Picture:
        height_px, width_px = shot.image.shape
        stamp_ns = shot.start_ns - self.epoch_ns
        values = {
            "FrameID": struct.pack(">Q", self._frame_id()),
            "ExposureTime": struct.pack(">d", shot.used.exposure_us),
            "Gain": struct.pack(">d", shot.used.gain_db),
            "Timestamp": struct.pack(">Q", stamp_ns),
        }
        chunks: tuple[tuple[int, bytes], ...] = ()
        if self.registers.number("ChunkModeActive"):
            chunks = tuple((CHUNKS[name], values[name]) for name in self._enabled_chunks())
        return Picture(
            block=self.first_id + self._sent,
            timestamp_ns=stamp_ns,
            width_px=width_px,
            height_px=height_px,
            pixel_format=int(self.registers.number("PixelFormat")),
            pixels=shot.image.data.cast("B"),
            chunks=chunks,
        )

    def _frame_id(self) -> int:
        return (self.first_id + self._sent - 1) % (1 << self.id_bits)
