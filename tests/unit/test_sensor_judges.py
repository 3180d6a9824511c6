"""Judges from outside measure the simulated sensor: EMVA's reference program and OpenCV."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from itertools import count
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from emva1288.process.data import Data1288
from emva1288.process.results import Results1288
from emva1288.process.routines import get_int_imgs

from rig.config import GammaResponse, LinearResponse, SrgbResponse, load_camera_model
from rig.core.types import Settings
from rig.core.units import gain_factor
from rig.drivers.sensor.sensor import Sensor, response_table

SHAPE = (160, 200)
EXPOSURE_US = 1_000.0
MODELS = ("blackfly-s-u3-31s4", "mvbluefox3-2024a")
STACK = 32


class Darkroom:
    """A sensor before an even light of which the electrons per pixel are set."""

    def __init__(self, name: str, gain_db: float) -> None:
        self.model = load_camera_model(name)
        self.gain_db = gain_db
        self.e_per_dn = self.model.converter.e_per_dn / gain_factor(gain_db)
        converter = self.model.converter
        reach_e = ((1 << converter.bits) - 1 - converter.black_level_dn) * self.e_per_dn
        self.saturation_e = min(self.model.pixel.full_well_e, reach_e)
        self._sensor = Sensor(self.model, SHAPE, seed=1)
        self._noise_seeds: Iterator[int] = count()

    def pictures(self, electrons: float, n: int) -> list[np.ndarray]:
        radiance = electrons / (self._sensor.electrons_per_cd_m2_s * EXPOSURE_US * 1e-6)
        light = np.full(SHAPE, radiance, np.float32)
        settings = Settings(EXPOSURE_US, self.gain_db)
        return [self._sensor.digitise(light, settings, next(self._noise_seeds)) for _ in range(n)]


def judged(room: Darkroom, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what EMVA's reference program makes of pairs at 60 levels and of two stacks."""
    # The program was written for NumPy 1; this is the one name that it misses.
    monkeypatch.setattr(np, "asfarray", lambda a: np.asarray(a, float), raising=False)
    photons_per_e = 1 / room.model.pixel.quantum_efficiency
    levels_e = room.saturation_e * np.concatenate(
        [np.linspace(0.0, 0.9, 46), np.linspace(0.91, 1.05, 15)]
    )

    def pair(electrons: float) -> dict[str, float]:
        sums = get_int_imgs(room.pictures(electrons, 2))
        return {
            "sum": int(sums["sum"].sum()),
            "pvar": int(sums["pvar"].sum()),
            "dmean": sums["dmean"],
        }

    half_e = 0.5 * room.saturation_e
    measured = {
        "height": SHAPE[0],
        "width": SHAPE[1],
        "temporal": {EXPOSURE_US: {e * photons_per_e: pair(e) for e in levels_e.tolist()}},
        "spatial": {
            EXPOSURE_US: {
                e * photons_per_e: get_int_imgs(room.pictures(e, STACK)) for e in (0.0, half_e)
            }
        },
    }
    area_um2 = room.model.picture.pixel_um**2
    data = Data1288(measured, loglevel=logging.WARNING).data
    return Results1288(data, pixel_area=area_um2, loglevel=logging.WARNING)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("gain_db", [0.0, 12.0, 24.0])
def test_the_reference_program_of_emva_1288_finds_what_the_model_says(
    name: str, gain_db: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = Darkroom(name, gain_db)
    pixel = room.model.pixel
    found = judged(room, monkeypatch)
    assert pytest.approx(room.e_per_dn, rel=0.03) == 1 / found.K
    assert found.sigma_d == pytest.approx(pixel.read_noise_e, rel=0.03)
    assert pytest.approx(100 * pixel.quantum_efficiency, rel=0.03) == found.QE
    assert pytest.approx(100 * pixel.prnu, rel=0.03) == found.PRNU1288
    assert pytest.approx(pixel.dsnu_e, rel=0.03) == found.DSNU1288
    assert max(abs(found.LE_min), abs(found.LE_max)) < 0.5


@pytest.mark.parametrize("name", MODELS)
def test_the_reference_program_finds_the_full_well(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 0 dB; with gain the converter is full long before the well."""
    room = Darkroom(name, 0.0)
    found = judged(room, monkeypatch)
    assert found.u_e_sat == pytest.approx(room.model.pixel.full_well_e, rel=0.03)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("gain_db", [0.0, 12.0, 24.0])
def test_dark_frames_show_the_black_level(name: str, gain_db: float) -> None:
    room = Darkroom(name, gain_db)
    mean_dn = np.mean(room.pictures(0.0, 8))
    assert mean_dn == pytest.approx(room.model.converter.black_level_dn, rel=0.03)


@pytest.mark.parametrize("response", [LinearResponse(), GammaResponse(gamma=2.2), SrgbResponse()])
def test_opencv_recovers_the_response_curve_from_a_bracket(response: object) -> None:
    """Debevec and Malik: ln(exposure) up to a constant, for every 8-bit value."""
    model = msgspec.structs.replace(load_camera_model(MODELS[0]), response=response)
    sensor = Sensor(model, SHAPE, seed=1)
    rng = np.random.default_rng(0)
    light = np.exp(rng.uniform(np.log(20.0), np.log(4_000.0), SHAPE)).astype(np.float32)
    exposures_us = [250.0 * 2**k for k in range(9)]
    pictures = [
        sensor.develop(light, Settings(exposure_us, 0.0), k)
        for k, exposure_us in enumerate(exposures_us)
    ]
    debevec = cv2.createCalibrateDebevec(samples=150, lambda_=10.0, random=False)
    colour = [cv2.merge([picture] * 3) for picture in pictures]
    times_s = np.array(exposures_us, np.float32) * 1e-6
    found = np.log(debevec.process(colour, times_s)[:, 0, 0])

    converter = model.converter
    levels = np.arange(1 << converter.bits)
    table = response_table(model.response, levels.size)
    darkest = int(table[int(converter.black_level_dn) + 60])
    seen = np.arange(darkest, 240, 5)
    e = [levels[table == value].mean() - converter.black_level_dn for value in seen]
    error = found[seen] - np.log(e)
    error -= np.median(error)
    assert np.abs(error).max() < 0.05
