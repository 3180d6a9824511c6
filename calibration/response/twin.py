"""A camera model for the simulation out of what was measured of a real camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from rig.calibration.response.curve import Curve, residual_dn
from rig.calibration.response.fit import debevec_difference_dn, fit_curve
from rig.calibration.response.photon_transfer import PhotonTransfer, photon_transfer
from rig.calibration.response.step import Step, measurable
from rig.config import CameraModel
from rig.core.units import US_PER_S, gain_db, gain_factor
from rig.drivers.sensor.sensor import electrons_per_cd_m2_s


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """What a bracket tells of one camera."""

    bits: int
    curve: Curve
    noise: PhotonTransfer
    residual_dn: float
    debevec_difference_dn: float

    @property
    def electrons_per_s(self) -> float:
        """Return the photo-electrons per second of a pixel that looked at the surface."""
        return self.curve.rate_per_us * US_PER_S / self.noise.level_per_e

    @property
    def gains_db(self) -> dict[str, float]:
        """Return what each gain of the bracket really amplifies by, by its stated value.

        The lowest is taken at its word: a bracket tells by what the others are above it.
        """
        gains = self.curve.gains
        return {f"{stated:g}": min(gains) + gain_db(factor) for stated, factor in gains.items()}

    @property
    def e_per_dn(self) -> float:
        """Return the electrons per step of the converter at 0 dB."""
        at_lowest_gain = 1 / (self.noise.level_per_e * ((1 << self.bits) - 1))
        return at_lowest_gain * gain_factor(min(self.curve.gains))

    @property
    def black_level_dn(self) -> float:
        """Return the black level in steps of the converter."""
        return self.curve.black * ((1 << self.bits) - 1)


def make_twin(steps: Sequence[Step], bits: int) -> Twin:
    """Return what a whole bracket tells of a camera whose converter has `bits`.

    Raises CalibrationError when it tells too little.
    """
    curve = fit_curve(steps)
    return Twin(
        bits=bits,
        curve=curve,
        noise=photon_transfer(steps, curve, bits),
        residual_dn=residual_dn(curve, measurable(steps)),
        debevec_difference_dn=debevec_difference_dn(steps),
    )


def camera_model(
    twin: Twin, base: CameraModel, name: str, luminance_cd_m2: float | None
) -> CameraModel:
    """Return `base` with everything that was measured in its place.

    With the surface's luminance the f-number is set so that the same light gives as many
    electrons; without it the lens is that of `base`. Pattern noise, dark current, timing, picture
    and controls are those of `base`.
    """
    replace = msgspec.structs.replace
    pixel = replace(
        base.pixel,
        read_noise_e=twin.noise.read_noise_e,
        full_well_e=twin.noise.full_well_e,
    )
    converter = replace(
        base.converter,
        e_per_dn=twin.e_per_dn,
        black_level_dn=twin.black_level_dn,
    )
    lens = base.lens
    if luminance_cd_m2 is not None:
        brighter = twin.electrons_per_s / luminance_cd_m2 / electrons_per_cd_m2_s(base)
        lens = replace(lens, f_number=lens.f_number / brighter**0.5)
    return replace(
        base, name=name, pixel=pixel, converter=converter, lens=lens, response=twin.curve.response
    )
