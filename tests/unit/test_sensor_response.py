"""Response curves, checked against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from rig.config import GammaResponse, LinearResponse, SrgbResponse, TableResponse
from rig.drivers.sensor.sensor import response_table


def test_linear_is_proportional() -> None:
    table = response_table(LinearResponse(), 4096)
    assert table[0] == 0 and table[-1] == 255
    assert np.abs(table - np.arange(4096) * 255 / 4095).max() <= 0.5


def test_gamma_raises_the_shadows() -> None:
    table = response_table(GammaResponse(gamma=2.2), 4096)
    assert table[round(0.18 * 4095)] == round(255 * 0.18 ** (1 / 2.2))


def test_srgb_follows_the_standard() -> None:
    table = response_table(SrgbResponse(), 4096)
    assert table[round(0.2140 * 4095)] == pytest.approx(127.5, abs=1)
    assert table[round(0.001 * 4095)] == round(255 * 12.92 * 4 / 4095)


def test_table_is_interpolated() -> None:
    table = response_table(TableResponse(table=(0.0, 0.8, 1.0)), 4096)
    assert table[2048] == pytest.approx(0.8 * 255, abs=1)
    assert table[1024] == pytest.approx(0.4 * 255, abs=1)


@pytest.mark.parametrize(
    "response",
    [LinearResponse(), GammaResponse(gamma=1.8), SrgbResponse(), TableResponse(table=(0.0, 1.0))],
)
def test_no_response_ever_falls(response: object) -> None:
    table = response_table(response, 4096).astype(int)
    assert (np.diff(table) >= 0).all()
