"""Two cameras on the network: their sockets, the wire between them, and the loop that runs both."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from rig.config import CameraModel
from rig.core.clock import SystemClock
from rig.core.errors import CameraError
from rig.core.types import Pair, Settings
from rig.core.units import NS_PER_S
from rig.drivers.simulated.camera import TakePicture
from rig.drivers.simulated.gige import gvcp
from rig.drivers.simulated.gige.control import ControlChannel
from rig.drivers.simulated.gige.faults import Faults
from rig.drivers.simulated.gige.features import VENDOR, make_table
from rig.drivers.simulated.gige.imager import Imager, Optics
from rig.drivers.simulated.gige.registers import Identity, Registers
from rig.drivers.simulated.gige.stream import StreamChannel
from rig.drivers.simulated.source import SERIALS
from rig.drivers.simulated.world import World

PRIMARY_OUTPUT_LINE, SECONDARY_INPUT_LINE = 1, 3
"""The trigger wire: thesis 5.1.1 and the vendor's pin table."""

_LONGEST_WAIT_S = 0.05
_MAX_PACKET_BYTES = 65_536
_NETWORKS = 250
_ANY = "255.255.255.255"


@dataclass(frozen=True, slots=True)
class PairPlan:
    """What is served: a camera model, the size of its pictures, and where they come from.

    `hidden` features are left out of the descriptions. With `short_ids` blocks and frames count
    in 16 bits, as on older cameras, and frames begin at `first_id`. `clock_offsets_ns` is what the
    cameras' clocks are behind the computer's.
    """

    model: CameraModel
    width_px: int
    height_px: int
    take_picture: Pair[TakePicture]
    serials: Pair[str] = SERIALS
    latency_frames: int = 0
    hidden: frozenset[str] = frozenset()
    short_ids: bool = False
    first_id: int = 0
    clock_offsets_ns: Pair[int] = Pair(11_000_000_000, -7_000_000_000)


@dataclass(slots=True)
class Device:
    """One camera on the network."""

    plan: PairPlan
    side: int
    ip_address: str
    world: World
    control_socket: socket.socket
    stream_socket: socket.socket
    faults: Faults = field(default_factory=Faults)
    output_wires: dict[int, list[Callable[[bool, int, int], None]]] = field(default_factory=dict)
    imager: Imager = field(init=False)
    control: ControlChannel = field(init=False)
    stream: StreamChannel = field(init=False)
    _away: bool = False

    def __post_init__(self) -> None:
        self._wake_up()

    def edge_in(self, rising: bool, time_ns: int, sequence: int) -> None:
        """Take an edge on the input line of the trigger wire."""
        self.imager.edge_on(SECONDARY_INPUT_LINE)(rising, time_ns, sequence)

    def hear(self, receiver: socket.socket) -> None:
        """Answer one packet that waits in a socket."""
        packet, sender = receiver.recvfrom(_MAX_PACKET_BYTES)
        if self._away:
            return
        reply = self.control.handle(packet, sender, self.world.clock.now_ns())
        if reply is not None:
            with contextlib.suppress(OSError):
                self.control_socket.sendto(reply, sender)

    def work(self, now_ns: int) -> None:
        """Do what is due: faults, heartbeat, pictures, packets."""
        self._obey_faults()
        if self._away:
            return
        self.control.check_heartbeat(now_ns)
        while (picture := self.imager.next_picture()) is not None:
            self.stream.take(picture)
        if not self.imager.taking:
            self.stream.forget()
        self.stream.send_some(now_ns)

    def close(self) -> None:
        """Close the sockets."""
        self.control_socket.close()
        self.stream_socket.close()

    def _wake_up(self) -> None:
        plan, serial = self.plan, self.plan.serials[self.side]
        table = make_table(plan.model, serial, plan.width_px, plan.height_px, plan.hidden)
        registers = Registers(table, Identity(VENDOR, plan.model.name, serial, self.ip_address))
        self.imager = Imager(
            self.world,
            registers,
            Optics(serial, plan.model, plan.take_picture[self.side], plan.latency_frames),
            self.faults,
            epoch_ns=plan.clock_offsets_ns[self.side],
            id_bits=16 if plan.short_ids else 64,
            first_id=plan.first_id,
            may_slow_down=True,
            output_wires=self.output_wires,
        )
        extended = not plan.short_ids
        self.stream = StreamChannel(registers, self.faults, self.stream_socket, extended)
        self.control = ControlChannel(
            registers, self.imager, self.stream.resend, self.stream.send_test_packet
        )

    def _obey_faults(self) -> None:
        if self.faults.unplugged and not self._away:
            self.control.release()
        elif self._away and not self.faults.unplugged:
            self._wake_up()
        self._away = self.faults.unplugged
        if self.faults.drop_control:
            self.faults.drop_control = False
            self.control.release()


class Server:
    """Both devices, wired, in one loop on the computer's clock.

    The trigger wire goes from the primary's output to the secondary's input. Raises CameraError
    when an address cannot be had.
    """

    def __init__(self, plan: PairPlan, addresses: Pair[str] | None = None) -> None:
        _warm_up(plan)
        bound = _bind(addresses) if addresses is not None else _bind_anywhere()
        self.world = World(SystemClock())
        self.addresses = Pair(*(opened.getsockname()[0] for opened in bound))
        self.devices = Pair(
            *(
                Device(plan, side, self.addresses[side], self.world, bound[side], streaming)
                for side, streaming in enumerate(_stream_sockets(self.addresses))
            )
        )
        self._broadcasts = [_broadcast_socket() for _ in self.devices]
        self.devices.primary.output_wires[PRIMARY_OUTPUT_LINE] = [self.devices.secondary.edge_in]

    def run(self, keep_going: Callable[[], bool]) -> None:
        """Serve until `keep_going` says no; it is asked at least 20 times a second."""
        inputs = {device.control_socket: device for device in self.devices}
        inputs |= dict(zip(self._broadcasts, self.devices, strict=True))
        while keep_going():
            ready, _, _ = select.select(list(inputs), [], [], self._wait_s())
            for receiver in ready:
                inputs[receiver].hear(receiver)
            self.world.catch_up()
            for device in self.devices:
                device.work(self.world.clock.now_ns())

    def close(self) -> None:
        """Close all sockets."""
        for device in self.devices:
            device.close()
        for listener in self._broadcasts:
            listener.close()

    def _wait_s(self) -> float:
        dues = [device.stream.next_due_ns() for device in self.devices]
        times_ns = [due for due in (*dues, self.world.next_ns) if due is not None]
        if not times_ns:
            return _LONGEST_WAIT_S
        wait_s = (min(times_ns) - self.world.clock.now_ns()) / NS_PER_S
        return min(max(wait_s, 0.0), _LONGEST_WAIT_S)


def _warm_up(plan: PairPlan) -> None:
    """Take a picture on either side: the first one compiles what makes them, for seconds."""
    settings = Settings(plan.model.controls.initial_exposure_us, 0.0)
    for take_picture in plan.take_picture:
        take_picture(0, settings)


def _stream_sockets(addresses: Pair[str]) -> Iterator[socket.socket]:
    for address in addresses:
        streaming = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        streaming.bind((address, 0))
        yield streaming


def _broadcast_socket() -> socket.socket:
    """Return a socket that hears discoveries that are sent to everybody."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind((_ANY, gvcp.PORT))
    return listener


def _bind(addresses: Pair[str]) -> Pair[socket.socket]:
    opened: list[socket.socket] = []
    try:
        for address in addresses:
            opened.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            opened[-1].bind((address, gvcp.PORT))
    except OSError as error:
        for one in opened:
            one.close()
        raise CameraError(
            f"{address}: no camera can be served there, UDP port {gvcp.PORT}: "
            f"{error.strerror}; take two free addresses of this computer"
        ) from error
    return Pair(*opened)


def _bind_anywhere() -> Pair[socket.socket]:
    """Return sockets on two free loopback addresses."""
    for network in range(_NETWORKS):
        number = (os.getpid() + network) % _NETWORKS + 1
        with contextlib.suppress(CameraError):
            return _bind(Pair(f"127.0.{number}.1", f"127.0.{number}.2"))
    raise CameraError("no free loopback address is left for simulated cameras: end other servers")
