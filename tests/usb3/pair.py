"""Two USB3 Vision cameras with a trigger wire, on a virtual clock or on the computer's."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

from rig.core.protocols import Clock
from rig.core.types import Pair
from rig.core.units import NS_PER_S, s_to_ns
from rig.drivers.aravis.binding import (
    Opened,
    Picture,
    Spoiled,
    Stream,
    library,
    look_around,
    open_camera,
)
from rig.drivers.aravis.session import Reach
from rig.drivers.simulated.gige import registers
from rig.drivers.simulated.gige.faults import Faults
from rig.drivers.simulated.gige.features import FIRST_ADDRESS, VENDOR, make_table
from rig.drivers.simulated.gige.imager import Imager, Optics
from rig.drivers.simulated.gige.registers import AccessDenied, BadAddress, BadValue, Registers
from rig.drivers.simulated.gige.server import PRIMARY_OUTPUT_LINE, SECONDARY_INPUT_LINE, PairPlan
from rig.drivers.simulated.world import World
from usb3 import u3v
from usb3.bus import bus

FIRST_LABEL = 18284899
"""The serial number that is printed on the first camera; it tells 01170163."""

COMES_S = 20.0
"""How long a picture that was sent may take through Aravis on a busy machine."""

_MAX_UNSENT_PACKETS = 9
_LONGEST_WAIT_S = 0.05


class UsbCamera:
    """Registers and pictures of one camera, as USB3 Vision carries them."""

    def __init__(
        self, plan: PairPlan, side: int, label: str, world: World, changed: threading.Condition
    ) -> None:
        self._plan, self._side, self._world, self._changed = plan, side, world, changed
        self.serial = f"{int(label):08X}"
        self.faults = Faults()
        self.short_pictures = 0
        self.sent = 0
        self.output_wires: dict[int, list[Callable[[bool, int, int], None]]] = {}
        self.wake_up()
        self.plug = bus().attach(VENDOR, plan.model.name, self.serial, self.answer)

    def wake_up(self) -> None:
        """Begin with every register as it is after power-on."""
        plan = self._plan
        table = make_table(plan.model, self.serial, plan.width_px, plan.height_px, plan.hidden)
        identity = registers.Identity(VENDOR, plan.model.name, self.serial, "0.0.0.0")
        self.registers = Registers(table, identity)
        self.imager = Imager(
            self._world,
            self.registers,
            Optics(self.serial, plan.model, plan.take_picture[self._side], plan.latency_frames),
            self.faults,
            epoch_ns=plan.clock_offsets_ns[self._side],
            first_id=plan.first_id,
            output_wires=self.output_wires,
        )
        url = self.registers.read(registers.FIRST_URL, 512).split(b"\0")[0].decode()
        _, xml_at, xml_bytes = url.split(";")
        self._bootstrap = u3v.bootstrap(
            VENDOR, plan.model.name, self.serial, int(xml_at, 16), int(xml_bytes, 16)
        )

    def answer(self, packet: bytes) -> bytes:
        """Obey a command; whoever lets time pass looks again."""
        with self._changed:
            self._world.catch_up()
            told = self._obey(u3v.parse(packet))
            self._changed.notify()
        return told

    def _obey(self, command: u3v.Command) -> bytes:
        try:
            if command.code == u3v.READ:
                return u3v.answer(command, self._read(command.address, command.size))
            self._write(command.address, command.data)
        except BadAddress:
            return u3v.write_answer(command, u3v.INVALID_ADDRESS)
        except AccessDenied:
            return u3v.write_answer(command, u3v.WRITE_PROTECT)
        except BadValue:
            return u3v.write_answer(command, u3v.INVALID_PARAMETER)
        return u3v.write_answer(command)

    def deliver(self) -> None:
        """Send the pictures that were read out."""
        while (picture := self.imager.next_picture()) is not None:
            if self.plug.unsent() >= _MAX_UNSENT_PACKETS:
                lost = self.registers.number("TransferQueueOverflowCount") + 1
                self.registers.set_number("TransferQueueOverflowCount", lost)
                continue
            leader, tail, trailer = u3v.packets(picture)
            pixels = picture.pixels
            if self.short_pictures > 0:
                self.short_pictures -= 1
                pixels = pixels[: len(pixels) // 2]
            self.plug.send(leader)
            self.plug.send(pixels, tail)
            self.plug.send(trailer)
            self.sent += 1

    def _read(self, address: int, size: int) -> bytes:
        if address < FIRST_ADDRESS:
            u3v.tell_size(self._bootstrap, int(self.registers.number("PayloadSize")))
            return bytes(self._bootstrap[address : address + size])
        return self.registers.read(address, size)

    def _write(self, address: int, data: bytes) -> None:
        if address < FIRST_ADDRESS:
            self._bootstrap[address : address + len(data)] = data
            if address == u3v.STREAM_CONTROL and not data[0]:
                self.plug.forget()
            return
        self.registers.store(address, data, locked=self.imager.taking)
        found = self.registers.feature_at(address)
        assert found is not None
        self.imager.obey(found[0])


class UsbPair:
    """Both cameras, wired; `changed` is held by whoever gives a command or lets time pass."""

    def __init__(self, plan: PairPlan, clock: Clock, first_label: int = FIRST_LABEL) -> None:
        self.clock = clock
        self.labels = Pair(str(first_label), str(first_label + 1))
        self.world = World(clock)
        self.changed = threading.Condition(threading.RLock())
        self.cameras = Pair(
            *(
                UsbCamera(plan, side, label, self.world, self.changed)
                for side, label in enumerate(self.labels)
            )
        )
        self.cameras.primary.output_wires[PRIMARY_OUTPUT_LINE] = [self._edge]

    def deliver(self) -> None:
        for camera in self.cameras:
            camera.deliver()

    def run(self, keep_going: Callable[[], bool]) -> None:
        """Let time pass by the computer's clock."""
        with self.changed:
            while keep_going():
                self.world.catch_up()
                self.deliver()
                self.changed.wait(self._wait_s())

    def close(self) -> None:
        for camera in self.cameras:
            camera.plug.detach()

    def _wait_s(self) -> float:
        if self.world.next_ns is None:
            return _LONGEST_WAIT_S
        wait_s = (self.world.next_ns - self.clock.now_ns()) / NS_PER_S
        return min(max(wait_s, 0.0), _LONGEST_WAIT_S)

    def _edge(self, rising: bool, time_ns: int, sequence: int) -> None:
        imager = self.cameras.secondary.imager
        imager.edge_on(SECONDARY_INPUT_LINE)(rising, time_ns, sequence)


class StreamInStep:
    """Waits in the pair's time: up to the next picture or the deadline, whichever comes first."""

    def __init__(self, stream: Stream, pair: UsbPair, camera: UsbCamera) -> None:
        self._stream, self._pair, self._camera = stream, pair, camera
        self._taken = camera.sent

    def pop(self, timeout_s: float) -> Picture | Spoiled | None:
        deadline_ns = self._pair.clock.now_ns() + s_to_ns(timeout_s)
        with self._pair.changed:
            if not self._pair.world.run_until(self._came, deadline_ns):
                return None
        self._taken += 1
        arrived = self._stream.pop(COMES_S)
        assert arrived is not None, (
            f"picture {self._taken} of {self._camera.serial} was sent and did not come through "
            f"Aravis in {COMES_S:g} s: {self._camera.plug.state()}"
        )
        return arrived

    def _came(self) -> bool:
        self._pair.deliver()
        return self._camera.sent > self._taken


class OpenedInStep:
    """An opened camera whose stream waits in the pair's time."""

    def __init__(self, opened: Opened, pair: UsbPair) -> None:
        self._opened, self._pair = opened, pair
        self._camera = next(each for each in pair.cameras if each.serial == opened.serial)
        self.stream: StreamInStep | None = None

    def open_stream(self, packet_bytes: int | None) -> None:
        stream = self._opened.open_stream(packet_bytes)
        self.stream = StreamInStep(stream, self._pair, self._camera)

    def __getattr__(self, name: str) -> object:
        return getattr(self._opened, name)


def reach_in_step(pair: UsbPair) -> Reach:
    """Return how the driver reaches a pair that nobody runs: each wait lets time pass."""
    return Reach(pair.clock, look_at_usb, lambda name: OpenedInStep(open_camera(name), pair))


def reach_as_it_runs(pair: UsbPair) -> Reach:
    return Reach(pair.clock, look_at_usb)


def look_at_usb(names: Iterable[str]) -> None:
    """Look around on USB only: asking the network takes a second."""
    library().disable_interface("GigEVision")
    try:
        look_around(names)
    finally:
        library().enable_interface("GigEVision")
