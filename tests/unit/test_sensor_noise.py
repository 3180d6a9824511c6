"""The simulated sensor is measured the way a real one is: by photon transfer (EMVA 1288)."""

from __future__ import annotations

import msgspec
import numba
import numpy as np
import pytest
from scipy.stats import poisson

from rig.config import CameraModel, load_camera_model
from rig.core.types import Settings
from rig.core.units import gain_factor
from rig.drivers.sensor.sensor import FEW_E, Sensor

SHAPE = (240, 320)
MODEL = load_camera_model("blackfly-s-u3-31s4")


def flat(radiance_cd_m2: float) -> np.ndarray:
    return np.full(SHAPE, radiance_cd_m2, np.float32)


def radiance_for(sensor: Sensor, electrons: float, exposure_us: float) -> float:
    return electrons / (sensor.electrons_per_cd_m2_s * exposure_us * 1e-6)


def without_pattern(model: CameraModel = MODEL) -> CameraModel:
    pixel = msgspec.structs.replace(model.pixel, prnu=0.0, dsnu_e=0.0)
    return msgspec.structs.replace(model, pixel=pixel)


def mean_and_temporal_variance(
    sensor: Sensor, electrons: float, settings: Settings, repeats: int = 4
) -> tuple[float, float]:
    """Return the mean and, from differences of pictures, the variance in time, both in DN."""
    light = flat(radiance_for(sensor, electrons, settings.exposure_us))
    means, variances = [], []
    for seed in range(repeats):
        first = sensor.digitise(light, settings, 2 * seed).astype(float)
        second = sensor.digitise(light, settings, 2 * seed + 1).astype(float)
        means.append((first.mean() + second.mean()) / 2)
        variances.append((first - second).var() / 2)
    return float(np.mean(means)), float(np.mean(variances))


@pytest.mark.parametrize("gain_db", [0.0, 6.0, 12.0, 24.0])
def test_photon_transfer_recovers_the_conversion_factor(gain_db: float) -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    settings = Settings(1_000.0, gain_db)
    full_e = 10_000 / gain_factor(gain_db)
    levels_e = np.linspace(0.05, 0.65, 7) * full_e
    points = [mean_and_temporal_variance(sensor, level_e, settings) for level_e in levels_e]
    mean_dn, variance_dn = np.array(points).T
    dn_per_e = np.polyfit(mean_dn, variance_dn, 1)[0]
    assert 1 / dn_per_e == pytest.approx(MODEL.converter.e_per_dn / gain_factor(gain_db), rel=0.03)


@pytest.mark.parametrize("gain_db", [0.0, 12.0, 24.0])
def test_dark_frames_recover_the_read_noise(gain_db: float) -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    e_per_dn = MODEL.converter.e_per_dn / gain_factor(gain_db)
    _, variance_dn = mean_and_temporal_variance(sensor, 0.0, Settings(11.0, gain_db))
    read_noise_e = np.sqrt(variance_dn - 1 / 12) * e_per_dn
    assert read_noise_e == pytest.approx(MODEL.pixel.read_noise_e, rel=0.03)


@pytest.mark.parametrize("gain_db", [0.0, 12.0, 20.0])
def test_the_well_is_full_at_its_capacity(gain_db: float) -> None:
    """A converter that reaches far beyond the well shows where the well ends."""
    coarse = msgspec.structs.replace(MODEL.converter, e_per_dn=40.0)
    sensor = Sensor(msgspec.structs.replace(without_pattern(), converter=coarse), SHAPE, seed=1)
    mean_dn, variance_dn = mean_and_temporal_variance(sensor, 40_000, Settings(1_000.0, gain_db))
    e_per_dn = 40.0 / gain_factor(gain_db)
    full_well_e = (mean_dn - MODEL.converter.black_level_dn) * e_per_dn
    assert full_well_e == pytest.approx(MODEL.pixel.full_well_e, rel=0.003)
    assert variance_dn < 1.0, "a full well has no photon noise left"


def test_a_full_well_is_white() -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    light = flat(radiance_for(sensor, 40_000, 1_000.0))
    assert sensor.develop(light, Settings(1_000.0, 0.0), 0).min() == 255


@pytest.mark.parametrize("gain_db", [0.0, 18.0])
def test_the_mean_is_linear_in_exposure_radiance_and_gain(gain_db: float) -> None:
    sensor = Sensor(without_pattern(), SHAPE, seed=1)
    dn_per_e = gain_factor(gain_db) / MODEL.converter.e_per_dn
    for exposure_us in (75.0, 1_000.0, 30_000.0):
        for electrons in (5.0, 80.0, 900.0):
            mean_dn, _ = mean_and_temporal_variance(
                sensor, electrons, Settings(exposure_us, gain_db), repeats=2
            )
            dark_e = MODEL.pixel.dark_current_e_per_s * exposure_us * 1e-6
            expected_dn = MODEL.converter.black_level_dn + (electrons + dark_e) * dn_per_e
            assert mean_dn == pytest.approx(expected_dn, abs=0.05 * dn_per_e + 0.05, rel=0.002)


def test_the_aperture_formula() -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    illuminance_lx = np.pi * MODEL.lens.transmission / (4 * MODEL.lens.f_number**2)
    assert sensor.electrons_per_cd_m2_s == pytest.approx(illuminance_lx * 6135 * 3.45**2 * 0.62)


def test_dark_frames_sit_at_the_black_level() -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    dark = sensor.digitise(flat(0.0), Settings(11.0, 0.0), 3)
    assert dark.mean() == pytest.approx(MODEL.converter.black_level_dn, abs=0.02)
    assert np.median(sensor.develop(flat(0.0), Settings(11.0, 0.0), 3)) == 4


def test_dark_current_adds_up_over_a_long_exposure() -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    mean_dn, variance_dn = mean_and_temporal_variance(sensor, 0.0, Settings(30e6, 20.0))
    e_per_dn, dark_e = MODEL.converter.e_per_dn / 10, 30 * MODEL.pixel.dark_current_e_per_s
    black_dn, read_noise_e = MODEL.converter.black_level_dn, MODEL.pixel.read_noise_e
    assert (mean_dn - black_dn) * e_per_dn == pytest.approx(dark_e, rel=0.005)
    assert variance_dn * e_per_dn**2 == pytest.approx(dark_e + read_noise_e**2, rel=0.03)


def test_the_fixed_pattern_is_prnu_and_dsnu() -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    settings = Settings(1_000.0, 20.0)
    dn_per_e = 10 / MODEL.converter.e_per_dn

    def pattern_e(electrons: float) -> float:
        light = flat(radiance_for(sensor, electrons, 1_000.0))
        pictures = [sensor.digitise(light, settings, seed).astype(float) for seed in range(64)]
        temporal = np.var(pictures, axis=0, ddof=1).mean() / len(pictures)
        return float(np.sqrt(np.mean(pictures, axis=0).var() - temporal) / dn_per_e)

    dsnu_e = pattern_e(0.0)
    assert dsnu_e == pytest.approx(MODEL.pixel.dsnu_e, rel=0.03)
    prnu = np.sqrt(pattern_e(900.0) ** 2 - dsnu_e**2) / 900.0
    assert prnu == pytest.approx(MODEL.pixel.prnu, rel=0.03)


@pytest.mark.parametrize("mean_e", [0.02, 0.5, 3.0, 0.99 * FEW_E, 1.01 * FEW_E, 60.0])
def test_counts_are_poisson_distributed(mean_e: float) -> None:
    """A noiseless converter of one electron per step shows the counts themselves."""
    pixel = msgspec.structs.replace(
        without_pattern().pixel, read_noise_e=0.0, dark_current_e_per_s=0.0
    )
    converter = msgspec.structs.replace(MODEL.converter, e_per_dn=1.0, black_level_dn=0.0)
    counting = msgspec.structs.replace(MODEL, pixel=pixel, converter=converter)
    sensor = Sensor(counting, SHAPE, seed=1)
    light = flat(radiance_for(sensor, mean_e, 1_000.0))
    counts = np.concatenate(
        [sensor.digitise(light, Settings(1_000.0, 0.0), seed).ravel() for seed in range(40)]
    )
    levels = np.arange(200)
    seen = np.bincount(counts, minlength=levels.size)[: levels.size].cumsum() / counts.size
    assert np.abs(seen - poisson.cdf(levels, mean_e)).max() < 0.003
    assert counts.mean() == pytest.approx(mean_e, rel=0.01)
    assert counts.var() == pytest.approx(counts.mean(), rel=0.01)


def test_noise_is_independent_between_pixels_and_frames() -> None:
    sensor = Sensor(without_pattern(), SHAPE, seed=1)
    light = flat(radiance_for(sensor, 3_000.0, 1_000.0))
    first, second = (
        sensor.digitise(light, Settings(1_000.0, 0.0), seed).astype(float) for seed in (0, 1)
    )
    spread = first.std()
    noise = (first - first.mean()) / spread
    other = (second - second.mean()) / spread
    limit = 4 / np.sqrt(noise.size)
    assert abs((noise[:, 1:] * noise[:, :-1]).mean()) < limit
    assert abs((noise[1:] * noise[:-1]).mean()) < limit
    assert abs((noise * other).mean()) < limit


def test_same_seed_same_bytes_with_any_number_of_threads() -> None:
    rng = np.random.default_rng(5)
    light = rng.uniform(0.0, 4_000.0, SHAPE).astype(np.float32)
    settings = Settings(2_000.0, 10.0)
    sensor = Sensor(MODEL, SHAPE, seed=1)
    before = numba.get_num_threads()
    pictures = []
    for threads in (1, min(2, before)):
        numba.set_num_threads(threads)
        pictures.append(sensor.develop(light, settings, 7))
    numba.set_num_threads(before)
    assert np.array_equal(*pictures)
    assert np.array_equal(pictures[0], Sensor(MODEL, SHAPE, seed=1).develop(light, settings, 7))
    assert not np.array_equal(pictures[0], sensor.develop(light, settings, 8))
    assert not np.array_equal(pictures[0], Sensor(MODEL, SHAPE, seed=2).develop(light, settings, 7))


def test_a_small_picture_is_as_noisy_as_a_large_one() -> None:
    settings = Settings(1_000.0, 12.0)
    spreads = []
    for shape in ((120, 160), (480, 640)):
        sensor = Sensor(MODEL, shape, seed=1)
        light = np.full(shape, radiance_for(sensor, 1_000.0, 1_000.0), np.float32)
        spreads.append(sensor.digitise(light, settings, 0).std())
    assert spreads[0] == pytest.approx(spreads[1], rel=0.03)


def test_broken_radiance_does_no_harm() -> None:
    sensor = Sensor(MODEL, SHAPE, seed=1)
    light = flat(100.0)
    light[0, :3] = np.nan, np.inf, -5.0
    picture = sensor.develop(light, Settings(1_000.0, 0.0), 0)
    assert picture[0, 1] == 255
    assert picture[0, 2] <= 5


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="sensor"):
        Sensor(MODEL, SHAPE, seed=1).develop(
            np.zeros((10, 10), np.float32), Settings(1_000.0, 0.0), 0
        )
