"""ROS 2 messages as bytes: definitions are read from `msg/`, values are packed as CDR.

The `.msg` files are the one source: they are embedded in every recording, and what is packed
and unpacked follows from them. Little-endian plain CDR, as ROS 2 writes it (OMG DDSI-RTPS 2.3,
clause 10): each primitive is aligned to its own size, counted after the 4-byte header.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

Buffer = bytes | bytearray | memoryview

_HEADER = b"\x00\x01\x00\x00"
_CODES = {
    "bool": "?", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_FIELD = re.compile(r"^(?P<type>[\w/]+)(?P<array>\[(?P<count>\d*)\])?\s+(?P<name>\w+)")
_FOLDER = Path(__file__).parent / "msg"


@dataclass(frozen=True, slots=True)
class Field:
    """One line of a definition; `count` is None for a single value, 0 for any number."""

    name: str
    type: str
    count: int | None


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message definition by its short name, such as `rig_msgs/FrameMeta`."""

    name: str
    text: str
    fields: tuple[Field, ...]

    @property
    def ros_name(self) -> str:
        """Return the full name, such as `rig_msgs/msg/FrameMeta`."""
        return self.name.replace("/", "/msg/")

    @property
    def definition(self) -> str:
        """Return the ros2msg schema: this definition and all that it depends on."""
        others = [f"MSG: {kind.name}\n{kind.text}" for kind in self._dependencies()]
        return f"{'=' * 80}\n".join([self.text, *others])

    def _dependencies(self) -> list[MessageType]:
        found: dict[str, MessageType] = {}
        for field in self.fields:
            if "/" in field.type:
                kind = message_type(field.type)
                for each in (kind, *kind._dependencies()):
                    found.setdefault(each.name, each)
        return list(found.values())

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """Return `values`, one for each field by name, as CDR with its header.

        A nested message is a mapping, an array a sequence, `uint8[]` any buffer of bytes.
        """
        out = _Out()
        out.message(self, values)
        return b"".join(out.parts)

    def pack_head(self, values: Mapping[str, Any]) -> tuple[bytes, Buffer]:
        """Return the same in two pieces: all but the last field's `uint8[]`, and that buffer."""
        out = _Out()
        out.message(self, values)
        *head, tail = out.parts
        return b"".join(head), tail

    def unpack(self, data: Buffer) -> dict[str, Any]:
        """Return the values of `data` by name; `uint8[]` is a view into it, not a copy.

        Raises ValueError or struct.error when the bytes do not hold such a message.
        """
        view = memoryview(data).cast("B")
        if bytes(view[:4]) != _HEADER:
            raise ValueError(f"{self.ros_name} is not little-endian CDR")
        return _In(view[4:]).message(self)


@cache
def message_type(name: str) -> MessageType:
    """Return the definition of `package/Name`."""
    text = (_FOLDER / f"{name}.msg").read_text()
    matches = filter(None, map(_FIELD.match, text.splitlines()))
    fields = tuple(
        Field(m["name"], m["type"], int(m["count"] or 0) if m["array"] else None) for m in matches
    )
    return MessageType(name, text, fields)


class _Out:
    """Collects aligned parts; long buffers are taken over without a copy."""

    def __init__(self) -> None:
        self.parts: list[Buffer] = [_HEADER]
        self._size = 0

    def message(self, kind: MessageType, values: Mapping[str, Any]) -> None:
        for field in kind.fields:
            self._field(field, values[field.name])

    def _field(self, field: Field, value: Any) -> None:
        if field.count is None:
            self._value(field.type, value)
            return
        if field.count == 0:
            self._primitive("I", len(value))
        elif len(value) != field.count:
            raise ValueError(f"{field.name} must hold {field.count} values, got {len(value)}")
        if field.type == "uint8":
            self._append(value, len(value))
            return
        for each in value:
            self._value(field.type, each)

    def _value(self, kind: str, value: Any) -> None:
        if kind == "string":
            text = value.encode() + b"\x00"
            self._primitive("I", len(text))
            self._append(text, len(text))
        elif kind in _CODES:
            self._primitive(_CODES[kind], value)
        else:
            self.message(message_type(kind), value)

    def _primitive(self, code: str, value: Any) -> None:
        width = struct.calcsize(code)
        pad = -self._size % width
        self._append(struct.pack(f"<{pad}x{code}", value), pad + width)

    def _append(self, part: Buffer, size: int) -> None:
        self.parts.append(part)
        self._size += size


class _In:
    """Reads aligned values; never allocates more than the bytes that are there."""

    def __init__(self, view: memoryview) -> None:
        self._view = view
        self._at = 0

    def message(self, kind: MessageType) -> dict[str, Any]:
        return {field.name: self._field(field) for field in kind.fields}

    def _field(self, field: Field) -> Any:
        if field.count is None:
            return self._value(field.type)
        count = field.count or self._primitive("I")
        if count > len(self._view) - self._at:
            raise ValueError(f"{field.name} claims {count} values")
        if field.type == "uint8":
            return self._take(count)
        return [self._value(field.type) for _ in range(count)]

    def _value(self, kind: str) -> Any:
        if kind == "string":
            return bytes(self._take(self._primitive("I"))[:-1]).decode()
        if kind in _CODES:
            return self._primitive(_CODES[kind])
        return self.message(message_type(kind))

    def _primitive(self, code: str) -> Any:
        width = struct.calcsize(code)
        self._at += -self._at % width
        (value,) = struct.unpack_from(f"<{code}", self._view, self._at)
        self._at += width
        return value

    def _take(self, count: int) -> memoryview:
        part = self._view[self._at : self._at + count]
        if len(part) != count:
            raise ValueError(f"{count} bytes claimed, {len(part)} there")
        self._at += count
        return part
