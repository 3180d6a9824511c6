"""The description of the camera that a GenICam client downloads and obeys (GenApi schema 1.1)."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from xml.sax.saxutils import quoteattr

from rig.drivers.simulated.gige.features import CHUNKS, VENDOR, Feature, FeatureTable
from rig.drivers.simulated.gige.features import register_stride as stride

_SCHEMA = "http://www.genicam.org/GenApi/Version_1_1"
_CHUNK_FEATURES = {
    "ChunkFrameID": ("FrameID", "Integer"),
    "ChunkTimestamp": ("Timestamp", "Integer"),
    "ChunkExposureTime": ("ExposureTime", "Float"),
    "ChunkGain": ("Gain", "Float"),
}


def describe(table: FeatureTable, model_name: str) -> str:
    """Return the XML of a camera with these features."""
    nodes = "\n".join((*_categories(table), *_features(table), *_chunk_features()))
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        f"<RegisterDescription ModelName={quoteattr(_identifier(model_name))} "
        f'VendorName={quoteattr(VENDOR)} StandardNameSpace="None" '
        'SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
        'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ProductGuid="6b6f2a52-3f3a-4c4e-9a53-0f6a3cf2f0a1" '
        'VersionGuid="d2a1d6e0-5bb0-4c67-8f2e-2c5c1f3f9a77" '
        f'ToolTip="A simulated camera" xmlns="{_SCHEMA}">\n'
        f'{nodes}\n<Port Name="Device"/>\n</RegisterDescription>\n'
    )


def packed(xml: str) -> bytes:
    """Return the XML as the zip file that GigE Vision allows; the same bytes every time."""
    out = io.BytesIO()
    entry = zipfile.ZipInfo("camera.xml", (2000, 1, 1, 0, 0, 0))
    entry.compress_type = zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr(entry, xml)
    return out.getvalue()


def _identifier(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _categories(table: FeatureTable) -> Iterator[str]:
    members: dict[str, list[str]] = {}
    for feature in table.told:
        members.setdefault(feature.category, []).append(feature.name)
    members["ChunkDataControl"] += _CHUNK_FEATURES
    yield _category("Root", list(members))
    for name, features in members.items():
        yield _category(name, features)


def _category(name: str, members: list[str]) -> str:
    listed = "".join(f"<pFeature>{member}</pFeature>" for member in members)
    return f'<Category Name="{name}" NameSpace="Standard">{listed}</Category>'


def _features(table: FeatureTable) -> Iterator[str]:
    for feature in table.told:
        if feature.kind == "string":
            yield _register(feature, "StringReg", feature.name)
            continue
        yield _register(feature, "FloatReg" if feature.kind == "float" else "IntReg")
        yield _NODES[feature.kind](feature, table)


def _register(feature: Feature, tag: str, name: str = "") -> str:
    index = ""
    if feature.selector:
        index = f'<pIndex Offset="{stride(feature)}">{feature.selector}Register</pIndex>'
    sign = "<Sign>Unsigned</Sign>" if tag == "IntReg" else ""
    order = "" if tag == "StringReg" else "<Endianess>BigEndian</Endianess>"
    access = "RW" if feature.access == "WO" else feature.access
    return (
        f'<{tag} Name="{name or feature.name + "Register"}">'
        f"<Address>0x{feature.address:x}</Address>{index}<Length>{feature.length}</Length><AccessMode>{access}</AccessMode>"
        f"<pPort>Device</pPort>{sign}{order}</{tag}>"
    )


def _bounds(feature: Feature) -> str:
    parts = []
    if feature.low is not None:
        parts.append(f"<Min>{feature.low:.12g}</Min>")
    if feature.high is not None:
        parts.append(f"<Max>{feature.high:.12g}</Max>")
    if feature.step is not None:
        parts.append(f"<Inc>{feature.step}</Inc>")
    return "".join(parts)


def _integer(feature: Feature, _: FeatureTable) -> str:
    return (
        f'<Integer Name="{feature.name}"><pValue>{feature.name}Register</pValue>'
        f"{_bounds(feature)}</Integer>"
    )


def _float(feature: Feature, _: FeatureTable) -> str:
    unit = f"<Unit>{feature.unit}</Unit>" if feature.unit else ""
    return (
        f'<Float Name="{feature.name}"><pValue>{feature.name}Register</pValue>'
        f"{_bounds(feature)}{unit}</Float>"
    )


def _boolean(feature: Feature, _: FeatureTable) -> str:
    return (
        f'<Boolean Name="{feature.name}"><pValue>{feature.name}Register</pValue>'
        "<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
    )


def _enumeration(feature: Feature, table: FeatureTable) -> str:
    entries = "".join(
        f'<EnumEntry Name="{name}"><Value>{value}</Value></EnumEntry>'
        for name, value in feature.entries
    )
    selected = "".join(f"<pSelected>{name}</pSelected>" for name in table.selected_by(feature.name))
    return (
        f'<Enumeration Name="{feature.name}">{entries}<pValue>{feature.name}Register</pValue>'
        f"{selected}</Enumeration>"
    )


def _command(feature: Feature, _: FeatureTable) -> str:
    return (
        f'<Command Name="{feature.name}"><pValue>{feature.name}Register</pValue>'
        "<CommandValue>1</CommandValue></Command>"
    )


_NODES = {
    "integer": _integer,
    "float": _float,
    "boolean": _boolean,
    "enumeration": _enumeration,
    "command": _command,
}


def _chunk_features() -> Iterator[str]:
    for name, (chunk, kind) in _CHUNK_FEATURES.items():
        register = "IntReg" if kind == "Integer" else "FloatReg"
        sign = "<Sign>Unsigned</Sign>" if kind == "Integer" else ""
        yield (
            f'<{register} Name="{name}Register"><Address>0</Address><Length>8</Length>'
            f"<AccessMode>RO</AccessMode><pPort>{name}Port</pPort>{sign}"
            f"<Endianess>BigEndian</Endianess></{register}>"
            f'<Port Name="{name}Port"><ChunkID>{CHUNKS[chunk]:x}</ChunkID></Port>'
            f'<{kind} Name="{name}"><pValue>{name}Register</pValue></{kind}>'
        )
