"""A step of light: from its pair on, and only the light."""

from __future__ import annotations

import numpy as np
import pytest
from plane_scene import PlaneScene

from rig.core.errors import UsageError
from rig.drivers.registry import open_source
from rig.drivers.scenes.step import SteppedScene, read_light_step


def test_light_grows_at_its_pair_and_nothing_else_changes() -> None:
    plain = PlaneScene(speed_px_s=20.0)
    stepped = SteppedScene(plain, 10.0, 1.5)
    for time_s, factor in ((0.0, 1), (1.4, 1), (1.5, 10), (2.9, 10)):
        before, after = plain.view("primary", time_s), stepped.view("primary", time_s)
        assert np.allclose(after.radiance_cd_m2, factor * before.radiance_cd_m2)
        assert np.allclose(after.exposed(900.0), factor * before.exposed(900.0))
        assert np.array_equal(after.depth_m, before.depth_m)
        truths = plain.truth(time_s), stepped.truth(time_s)
        assert truths[1].light_cd_m2 == pytest.approx(factor * truths[0].light_cd_m2)
        assert truths[1].position_m == truths[0].position_m
    assert (stepped.drive_s, stepped.world_version) == (plain.drive_s, plain.world_version)
    assert stepped.intrinsics("primary") == plain.intrinsics("primary")


def test_an_address_asks_for_it_and_says_so() -> None:
    source = open_source("sim:wall?light_step=2.5@4&size=64x48&rate_hz=20", seed=0)
    lights = [source.truth(trigger).light_cd_m2 for trigger in (3, 4)]  # type: ignore[union-attr]
    assert lights[1] / lights[0] == pytest.approx(2.5, rel=0.2)
    assert "&light_step=2.5@4&" in source.address
    assert open_source(source.address, seed=0).address == source.address
    assert "light_step" not in open_source("sim:wall?size=64x48", seed=0).address


@pytest.mark.parametrize("word", ["10", "@30", "0@30", "-2@30", "x@y", "10@3.5"])
def test_what_is_no_step_is_refused(word: str) -> None:
    with pytest.raises(ValueError, match="such as 10@30"):
        read_light_step(word)
    with pytest.raises(UsageError, match="light_step must be a factor above 0"):
        open_source(f"sim:wall?light_step={word}&size=64x48", seed=0)
