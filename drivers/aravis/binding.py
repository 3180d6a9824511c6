"""Aravis itself: the only module that imports gi. Its errors come out as the rig's."""

from __future__ import annotations

import ctypes
import functools
import ipaddress
import threading
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import CameraError, CameraLost
from rig.core.types import Settings
from rig.drivers.aravis.probe import is_controlled
from rig.drivers.aravis.ring import RING_PICTURES, Ring
from rig.drivers.aravis.serials import same_serial
from rig.drivers.blackfly import Value
from rig.drivers.connected import usb_cameras

_LOST_CODES = frozenset({2, 5, 6})
"""Aravis' codes for not connected, time-out and not found."""

_SHARED_OBJECT = "libaravis-0.8.so.0"
_BUSY = "LIBUSB_ERROR_BUSY"

_SOCKET_BUFFER_BYTES = 4 << 20
_ASKED_AGAIN = 1.0
"""The share of a picture's packets that may be asked for again; Aravis asks for a quarter, and a
stream's first picture comes while the socket's buffer is still small."""

_FRAME_RETENTION_US = 200_000
"""How long the rest of a picture is waited for after its last packet; 100 ms are short on a busy
computer, and at 55 Hz a longer time would hold more pictures than the ring has."""

_LONGEST_HOLD_S = 5.0
_HOLD_LOOK_S = 0.005
"""How long somebody else may hold a device that is let go, and how often that is looked at."""

_LOOPBACK_PACKET_BYTES = 65_000
_ETHERNET_PACKET_BYTES = 1_400


@functools.cache
def library() -> Any:
    """Return the Aravis module; raises CameraError with what to install."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ImportWarning)  # an old way of importing, in gi itself
            from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        raise CameraError(
            f"real cameras need Aravis, which is not here ({error}); run "
            "apt-get install python3-gi gir1.2-aravis-0.8, then make setup"
        ) from error
    return Aravis


def aravis_version() -> tuple[int, int, int]:
    """Return the version of Aravis; raises CameraError where it is not."""
    library()
    loaded = ctypes.CDLL(_SHARED_OBJECT)  # the version is not among what gi can call
    return (
        loaded.arv_get_major_version(),
        loaded.arv_get_minor_version(),
        loaded.arv_get_micro_version(),
    )


def _description(device_address: int) -> str | None:
    """Return the XML of a device; None where it has none.

    Asked of the library itself: Aravis' text has a size and no zero at its end, and the binding,
    which knows of no size, reads on into whatever follows (arv_device_get_genicam_xml, 0.8.26).
    """
    ask = ctypes.CDLL(_SHARED_OBJECT).arv_device_get_genicam_xml
    ask.restype = ctypes.c_void_p
    ask.argtypes = (ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t))
    size_bytes = ctypes.c_size_t()
    text = ask(device_address, ctypes.byref(size_bytes))
    return ctypes.string_at(text, size_bytes.value).decode() if text else None


@contextmanager
def translated(serial: str, what: str) -> Iterator[None]:
    """Turn an error of GLib into CameraLost or CameraError that names the camera."""
    from gi.repository import GLib

    try:
        yield
    except GLib.Error as error:
        if "device" in error.domain and error.code in _LOST_CODES:
            raise CameraLost(
                f"{serial}: {what}: no answer ({error.message}); check the cable and the power"
            ) from error
        raise CameraError(f"{serial}: {what}: {error.message}") from error


class AravisNodes:
    """The nodes of an opened camera; implements `rig.drivers.blackfly.NodeMap`."""

    def __init__(self, device: Any, serial: str) -> None:
        self._device = device
        self._serial = serial
        self._kinds: dict[str, str] = {}

    def close(self) -> None:
        """Let go of the device."""
        self._device = None

    @property
    def serial(self) -> str:
        """Return the serial number."""
        return self._serial

    def has(self, name: str) -> bool:
        """Return whether there is such a node."""
        return self._kind(name) != ""

    def writable(self, name: str) -> bool:
        """Return whether the node can be written now."""
        feature = self._device.get_feature(name)
        with translated(self._serial, name):
            access = feature.get_actual_access_mode()
            return access in (library().GcAccessMode.RW, library().GcAccessMode.WO)

    def read(self, name: str) -> Value:
        """Return the value of a node."""
        readers = {
            "boolean": self._device.get_boolean_feature_value,
            "string": self._device.get_string_feature_value,
            "float": self._device.get_float_feature_value,
            "integer": self._device.get_integer_feature_value,
        }
        with translated(self._serial, f"reading {name}"):
            return cast(Value, readers[self._kind(name)](name))

    def write(self, name: str, value: Value) -> None:
        """Write a node."""
        with translated(self._serial, f"writing {name} = {value}"):
            kind = self._kind(name)
            if kind == "boolean":
                self._device.set_boolean_feature_value(name, bool(value))
            elif kind == "string":
                self._device.set_string_feature_value(name, str(value))
            elif kind == "float":
                self._device.set_float_feature_value(name, float(value))
            else:
                self._device.set_integer_feature_value(name, int(value))

    def execute(self, name: str) -> None:
        """Run a command node."""
        with translated(self._serial, f"running {name}"):
            self._device.execute_command(name)

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the lowest and highest value that a number takes now."""
        with translated(self._serial, f"reading the range of {name}"):
            if self._kind(name) == "float":
                low, high = self._device.get_float_feature_bounds(name)
            else:
                low, high = self._device.get_integer_feature_bounds(name)
            return low, high

    def entries(self, name: str) -> Sequence[str]:
        """Return the words that an enumeration takes."""
        with translated(self._serial, f"reading the words of {name}"):
            read = self._device.dup_available_enumeration_feature_values_as_strings
            return cast(Sequence[str], read(name))

    def _kind(self, name: str) -> str:
        """Return what kind of value a node has; empty when there is no such node."""
        if name not in self._kinds:
            self._kinds[name] = self._find_kind(name)
        return self._kinds[name]

    def _find_kind(self, name: str) -> str:
        aravis, feature = library(), self._device.get_feature(name)
        if feature is None or not feature.is_implemented():
            return ""
        for kind, classes in (
            ("command", (aravis.GcCommand,)),
            ("boolean", (aravis.GcBoolean,)),
            ("string", (aravis.GcEnumeration, aravis.GcStringNode, aravis.GcStringRegNode)),
            ("float", (aravis.GcFloat,)),
            ("integer", (aravis.GcInteger,)),
        ):
            if isinstance(feature, classes):
                return kind
        return "string"


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture that came whole, with what the camera says about it.

    `frame_id` counts frames from anywhere. `used` is None where the camera does not tell.
    """

    image: NDArray[np.uint8]
    frame_id: int
    timestamp_ns: int
    used: Settings | None


@dataclass(frozen=True, slots=True)
class Spoiled:
    """A picture that did not come whole; its pixels are of no use."""

    status: str
    timestamp_ns: int


class Stream:
    """The pictures of one camera, pulled; never pushed from a foreign thread."""

    def __init__(self, camera: Any, serial: str) -> None:
        aravis = library()
        self._serial = serial
        self._success = aravis.BufferStatus.SUCCESS
        with translated(serial, "opening its stream"):
            self._stream: Any = camera.create_stream(None, None)
            size_bytes = camera.get_payload()
        if self._stream is None:
            raise CameraError(f"{serial}: no stream could be opened; is another program using it?")
        self._parser: Any = camera.create_chunk_parser()
        self._tune(aravis)
        self._ring = Ring(size_bytes, lambda slot: self._stream.push_buffer(self._buffers[slot]))
        self._buffers = [
            aravis.Buffer.new(size_bytes, self._ring.address(slot)) for slot in range(RING_PICTURES)
        ]
        self._slots = {hash(buffer): slot for slot, buffer in enumerate(self._buffers)}
        for buffer in self._buffers:
            self._stream.push_buffer(buffer)

    def pop(self, timeout_s: float) -> Picture | Spoiled | None:
        """Return the next picture, whole or not; None when none came in time."""
        buffer = self._stream.timeout_pop_buffer(max(round(timeout_s * 1e6), 0))
        if buffer is None:
            return None
        slot = self._slots[hash(buffer)]
        self._ring.arrived(slot)
        status = buffer.get_status()
        if status != self._success:
            spoiled = Spoiled(status.value_nick.replace("-", " "), buffer.get_timestamp())
            self._ring.give_back(slot)
            return spoiled
        return self._whole(buffer, slot)

    def close(self) -> None:
        """Stop listening; pictures that somebody looks at stay valid."""
        self._ring.close()
        self._stream.set_emit_signals(False)
        self._stream = self._parser = None

    def _whole(self, buffer: Any, slot: int) -> Picture:
        width_px, height_px = buffer.get_image_width(), buffer.get_image_height()
        frame_id, timestamp_ns, used = buffer.get_frame_id(), buffer.get_timestamp(), None
        if buffer.has_chunks():
            with translated(self._serial, "reading the chunks of a picture"):
                frame_id = self._parser.get_integer_value(buffer, "ChunkFrameID")
                timestamp_ns = self._parser.get_integer_value(buffer, "ChunkTimestamp")
                used = Settings(
                    self._parser.get_float_value(buffer, "ChunkExposureTime"),
                    max(self._parser.get_float_value(buffer, "ChunkGain"), 0.0),
                )
        pixels = self._ring.take(slot, width_px * height_px)
        return Picture(pixels.reshape(height_px, width_px), frame_id, timestamp_ns, used)

    def _tune(self, aravis: Any) -> None:
        if isinstance(self._stream, aravis.GvStream):
            self._stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.FIXED)
            self._stream.set_property("socket-buffer-size", _SOCKET_BUFFER_BYTES)
            self._stream.set_property("packet-resend", aravis.GvStreamPacketResend.ALWAYS)
            self._stream.set_property("packet-request-ratio", _ASKED_AGAIN)
            self._stream.set_property("frame-retention", _FRAME_RETENTION_US)


class Opened:
    """One camera under our control."""

    def __init__(self, camera: Any, name: str) -> None:
        self._camera: Any = camera
        device: Any = camera.get_device()
        with translated(name, "opening"):
            serial = camera.get_device_serial_number() or name
            self.maker = f"{camera.get_vendor_name()} {camera.get_model_name()}"
        self.serial = str(serial)
        self.nodes = AravisNodes(device, self.serial)
        self.stream: Stream | None = None
        self._lost = threading.Event()
        self._handler = device.connect("control-lost", lambda *_: self._lost.set())
        self._device = device

    @property
    def on_usb(self) -> bool:
        """Return whether this is a USB3 Vision camera."""
        return bool(self._camera.is_uv_device())

    def description(self) -> str:
        """Return the GenICam XML by which the camera describes itself."""
        text = _description(hash(self._device))
        if text is None:
            raise CameraError(
                f"{self.serial}: gives no GenICam description; connect it anew and try again"
            )
        return text

    @property
    def control_lost(self) -> bool:
        """Return whether the camera stopped listening to us."""
        return self._lost.is_set()

    def still_ours(self) -> bool:
        """Ask the camera whether this program controls it; always true where it cannot be asked."""
        if not self._camera.is_gv_device():
            return True
        return bool(is_controlled(self._address()))

    def open_stream(self, packet_bytes: int | None) -> Stream:
        """Return the stream of pictures; call it after the size of a picture is settled."""
        aravis = library()
        with translated(self.serial, "preparing its stream"):
            if self._camera.is_gv_device():
                self._camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
                self._camera.gv_set_packet_size(packet_bytes or self._packet_bytes())
            elif self._camera.is_uv_device():
                self._camera.uv_set_usb_mode(aravis.UvUsbMode.ASYNC)
        self.stream = Stream(self._camera, self.serial)
        return self.stream

    def start(self) -> None:
        """Arm the camera."""
        with translated(self.serial, "starting"):
            self._camera.start_acquisition()

    def stop(self) -> None:
        """Stop taking pictures."""
        with translated(self.serial, "stopping"):
            self._camera.stop_acquisition()

    def close_stream(self) -> None:
        """Close the stream; pictures that somebody looks at stay valid."""
        if self.stream is not None:
            self.stream.close()
        self.stream = None

    def lose(self) -> None:
        """Note that the camera does not listen to us any more."""
        self._lost.set()

    def close(self, *, say_goodbye: bool) -> None:
        """Let go of the camera, now and not when Python next collects its garbage.

        A camera that is let go later blocks whoever comes upon it: it still tells the device.
        One that is gone is not told, and let go beside the run: both would take seconds.
        """
        self._device.disconnect(self._handler)
        if say_goodbye:
            self.close_stream()
        if say_goodbye and self._camera.is_gv_device():
            with suppress(CameraError), translated(self.serial, "closing"):
                self._device.leave_control()
        self.nodes.close()
        last = [self.stream, self._camera, self._device]
        self.stream = self._camera = self._device = None
        if say_goodbye:
            _let_go(last)
        else:
            threading.Thread(target=_let_go, args=(last,), daemon=True).start()

    def _address(self) -> str:
        return str(self._device.get_device_address().get_address().to_string())

    def _packet_bytes(self) -> int:
        loopback = ipaddress.ip_address(self._address()).is_loopback
        return _LOOPBACK_PACKET_BYTES if loopback else _ETHERNET_PACKET_BYTES


def _let_go(last: list[Any]) -> None:
    """Close a stream and drop what Aravis holds of a camera; seconds for one that is gone.

    The device goes last and alone. Aravis tells of a loss in a thread of the device, which holds it
    meanwhile: if ours was not the last hold, that thread would have to wait for its own end, and
    GLib ends the process (arv_uv_device_finalize, 0.8.26).
    """
    stream, device = last[0], last[2]
    if stream is not None:
        stream.close()
    last.clear()
    deadline_s = time.monotonic() + _LONGEST_HOLD_S
    while device.__grefcount__ > 1 and time.monotonic() < deadline_s:
        time.sleep(_HOLD_LOOK_S)


def open_camera(name: str) -> Opened:
    """Open a camera by its serial number, decimal or hexadecimal, or by its network address.

    Raises CameraError for a camera that is not there or that another program uses.
    """
    aravis = library()
    try:
        with translated(name, "opening"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Aravis warns of what its error says better
            camera = aravis.Camera.new(name if _is_address(name) else _find(aravis, name))
    except CameraError as error:
        raise _in_use(name) if _BUSY in str(error) else error from error.__cause__
    if camera is None:
        raise CameraError(f"{name}: cannot be opened; is another program using it?")
    if camera.is_gv_device() and not camera.get_device().is_controller():
        raise _in_use(name)
    return Opened(camera, name)


def _in_use(name: str) -> CameraError:
    return CameraError(
        f"{name}: another program controls this camera; close it, such as a viewer or another "
        "`rig`, and try again"
    )


def described(name: str) -> tuple[str, str]:
    """Return a camera's serial number and its GenICam description; raises CameraError."""
    look_around([name])
    opened = open_camera(name)
    try:
        return opened.serial, opened.description()
    finally:
        opened.close(say_goodbye=True)


def look_around(names: Iterable[str]) -> None:
    """Ask who is there, unless all names are network addresses; takes a second."""
    if not all(_is_address(name) for name in names):
        library().update_device_list()


def _find(aravis: Any, label: str) -> str:
    """Return what Aravis calls a camera, among those that answered when it last looked around."""
    told = [aravis.get_device_serial_nbr(i) or "?" for i in range(aravis.get_n_devices())]
    for number, serial in enumerate(told):
        if same_serial(label, serial):
            return str(aravis.get_device_id(number))
    if any(same_serial(label, camera.serial) for camera in usb_cameras()):
        raise CameraError(
            f"{label}: is on USB and may not be opened by this user: run rig doctor --install-udev"
        )
    raise CameraError(
        f"{label}: no such camera; found {', '.join(told) or 'none'}; "
        "check cable and power (rig doctor)"
    )


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
