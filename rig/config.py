"""Typed values from the files that a user writes.

Every file is TOML. A field that no one knows is refused, and so is a value outside its range:
`ConfigError` names the file, the field and the reason.
"""

from __future__ import annotations

import datetime
import difflib
import hashlib
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import msgspec

from rig.core.errors import ConfigError
from rig.core.types import Limits, PixelFormat

T = TypeVar("T")

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Fraction = Annotated[float, msgspec.Meta(ge=0, le=1)]


class Picture(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The full-size picture: its pixels and their format."""

    width_px: Annotated[int, msgspec.Meta(gt=0)]
    height_px: Annotated[int, msgspec.Meta(gt=0)]
    pixel_um: Positive
    format: PixelFormat


class Controls(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The ranges and steps of exposure and gain, and what they are when the camera wakes up."""

    exposure_us: tuple[Positive, Positive]
    exposure_step_us: Positive
    gain_db: tuple[NotNegative, NotNegative]
    gain_step_db: Positive
    initial_exposure_us: Positive
    initial_gain_db: NotNegative

    def __post_init__(self) -> None:
        for name, (low, high) in (("exposure_us", self.exposure_us), ("gain_db", self.gain_db)):
            if low > high:
                raise ValueError(f"{name} must go from low to high, got {low:g}..{high:g}")

    @property
    def limits(self) -> Limits:
        """Return the settings that the camera can take."""
        return Limits(self.exposure_us, self.gain_db)


class Lens(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the lens lets through."""

    f_number: Positive
    transmission: Annotated[float, msgspec.Meta(gt=0, le=1)]


class Pixel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A pixel before the converter, in electrons (EMVA 1288)."""

    quantum_efficiency: Annotated[float, msgspec.Meta(gt=0, le=1)]
    photons_per_lx_um2_s: Positive
    full_well_e: Positive
    read_noise_e: NotNegative
    dark_current_e_per_s: NotNegative
    prnu: Fraction
    dsnu_e: NotNegative


class Converter(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The analogue-to-digital converter at 0 dB."""

    bits: Annotated[int, msgspec.Meta(ge=8, le=16)]
    e_per_dn: Positive
    black_level_dn: NotNegative


class LinearResponse(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="curve", tag="linear"
):
    """8-bit values proportional to light: `GammaEnable` off."""


class GammaResponse(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="curve", tag="gamma"
):
    """Light to the power of 1/gamma."""

    gamma: Positive


class SrgbResponse(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="curve", tag="srgb"
):
    """The transfer curve of IEC 61966-2-1."""


class TableResponse(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="curve", tag="table"
):
    """Samples of the response at even steps of light from 0 to 1, each 0..1, never falling."""

    table: Annotated[tuple[Fraction, ...], msgspec.Meta(min_length=2)]

    def __post_init__(self) -> None:
        if any(b < a for a, b in zip(self.table, self.table[1:], strict=False)):
            raise ValueError("table must never fall")


Response = LinearResponse | GammaResponse | SrgbResponse | TableResponse


class Timing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How long things take beside the exposure."""

    readout_s: NotNegative
    trigger_delay_us: NotNegative
    link_bytes_per_s: Positive
    delivery_s: NotNegative


class CameraModel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that the simulation knows of a camera type."""

    name: str
    picture: Picture
    controls: Controls
    lens: Lens
    pixel: Pixel
    converter: Converter
    response: Response
    timing: Timing


def load_camera_model(name_or_path: str) -> CameraModel:
    """Return a shipped camera model by its name, or one from a TOML file.

    Raises ConfigError for an unknown name, a missing file, and a file that does not say what it
    must.
    """
    folder = resources.files("rig") / "drivers" / "sensor" / "models"
    shipped = {entry.name.removesuffix(".toml"): entry for entry in folder.iterdir()}
    shipped = {name: entry for name, entry in shipped.items() if entry.name.endswith(".toml")}
    if name_or_path in shipped:
        return _decode(shipped[name_or_path].read_bytes(), name_or_path, CameraModel)
    path = Path(name_or_path)
    if path.suffix == ".toml" or path.exists():
        return _decode(_read(path), name_or_path, CameraModel)
    close = difflib.get_close_matches(name_or_path, shipped, n=1)
    hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(shipped))}."
    raise ConfigError(f"unknown camera model {name_or_path!r}; {hint} Or name a .toml file.")


def camera_digest(name_or_path: str) -> str:
    """Return what tells one camera file from another of that name; empty for a shipped model.

    What was worked out for a camera is kept under its name, and a file may change. Raises OSError
    when the file is gone.
    """
    path = Path(name_or_path)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.suffix == ".toml" else ""


class LensCalibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One camera with its lens at one picture size; `distortion` is OpenCV's k1 k2 p1 p2 k3."""

    width_px: Annotated[int, msgspec.Meta(gt=0)]
    height_px: Annotated[int, msgspec.Meta(gt=0)]
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float]
    residual_px: NotNegative


class StereoCalibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """From the primary's optical frame to the secondary's: x2 = rotation (by rows) x1 + shift."""

    rotation: Annotated[tuple[float, ...], msgspec.Meta(min_length=9, max_length=9)]
    translation_m: tuple[float, float, float]
    baseline_m: Positive
    baseline_sigma_m: NotNegative
    residual_px: NotNegative


class ApertureCalibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How alike both cameras see: the secondary's light over the primary's, in stops."""

    ratio_stops: float
    uncertainty_stops: NotNegative
    tolerance_stops: Positive
    linearity_stops: NotNegative
    exposure_us: Positive
    gain_db: NotNegative


class Calibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of one pair of cameras; `date` is a day as YYYY-MM-DD, `lens` a name or ''."""

    schema: Literal["rig.calibration/1"]
    date: datetime.date
    primary_serial: str
    secondary_serial: str
    lens: str = ""
    primary: LensCalibration | None = None
    secondary: LensCalibration | None = None
    stereo: StereoCalibration | None = None
    aperture: ApertureCalibration | None = None


def load_calibration(path: Path) -> Calibration:
    """Return a calibration file; raises ConfigError when it does not say what it must."""
    return _decode(_read(path), str(path), Calibration)


def parse_calibration(text: bytes, file: str) -> Calibration:
    """Return the calibration that `text` of `file` holds; raises ConfigError."""
    return _decode(text, file, Calibration)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the path") from error


def _decode(text: bytes, file: str, kind: type[T]) -> T:
    """Return the TOML `text` of `file` as a `kind`; raises ConfigError with file and field."""
    try:
        return msgspec.toml.decode(text, type=kind)
    except msgspec.ValidationError as error:
        reason, _, where = str(error).partition(" - at `$")
        field = where.strip("`.") or "top level"
        raise ConfigError(f"{file}: {field}: {reason}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: not valid TOML: {error}") from error
