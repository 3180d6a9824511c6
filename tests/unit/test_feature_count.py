"""Figure 4.7: more features, better poses; on made scenes, and on what is installed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.cli.main import run
from rig.core.errors import RigError
from rig.core.types import Intrinsics
from rig.experiments import feature_count
from rig.experiments.feature_count import (
    Source,
    measure,
    motorcycle,
    of_tracks,
    over_caps,
    package_folder,
    pose_errors,
)
from rig.experiments.reproduce import Job

LENS = Intrinsics(741, 500, 900.0, 900.0, 370.0, 249.5)
Points = NDArray[np.float64]


def stereo(points: int, noise_px: float, seed: int = 0) -> tuple[Points, Points]:
    """Return matched pixels of two rectified cameras, one baseline apart along x."""
    rng = np.random.default_rng(seed)
    place = np.column_stack(
        [rng.uniform(-4, 4, points), rng.uniform(-3, 3, points), rng.uniform(4, 30, points)]
    )
    left = place[:, :2] / place[:, 2:]
    right = (place[:, :2] - (1, 0)) / place[:, 2:]
    pixels = [rays * 900 + (370, 249.5) for rays in (left, right)]
    return tuple(p + rng.normal(0, noise_px, p.shape) for p in pixels)  # type: ignore[return-value]


def job(folder: Path) -> Job:
    return Job(folder, True, 1, lambda text: None, lambda done, total=None: None)


def test_exact_matches_have_no_error() -> None:
    left, right = (rays - (370, 249.5) for rays in stereo(200, 0.0))
    told = pose_errors(left / 900, right / 900, 900.0, seed=0)
    assert told is not None
    assert told == pytest.approx((0.0, 0.0, 200), abs=1e-6)


def test_too_few_matches_fail() -> None:
    left, right = stereo(7, 0.0)
    assert pose_errors(left / 900, right / 900, 900.0, seed=0) is None


def test_a_wrong_pose_has_the_error_of_equation_4_3() -> None:
    left, right = (rays - (370, 249.5) for rays in stereo(200, 0.0))
    down = np.array([[0.0, 1.0], [-1.0, 0.0]])
    turned = pose_errors(left @ down / 900, right @ down / 900, 900.0, seed=0)
    assert turned is not None
    # The translation is along y: E has two entries of 1 elsewhere, four squares of 1 in all.
    assert turned[0] == pytest.approx(4.0, abs=1e-6)
    assert turned[1] == pytest.approx(0.0, abs=1e-6)


def test_more_features_give_a_better_pose() -> None:
    pairs = [of_tracks(*stereo(3_000, 0.4, seed), LENS, seed) for seed in range(3)]
    told = over_caps(pairs, draws=3)
    errors = dict(zip(feature_count.CAPS, told["essential"], strict=True))
    assert errors[20] > 3 * errors[200] > 3 * errors[2000]
    assert told["inliers"] == sorted(told["inliers"])
    assert told["trials"] == 9


def test_what_is_missing_is_told_and_nothing_at_all_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    absent = Source("elsewhere", "pictures", "pip install them", list)
    made = Source("made", "points", "", lambda: [of_tracks(*stereo(300, 0.3), LENS, 0)])
    monkeypatch.setattr(feature_count, "SOURCES", (absent, made))
    values = measure(job(tmp_path))
    assert values["missing"] == {"elsewhere": "pip install them"}
    assert list(values["sources"]) == ["made"]
    assert "elsewhere is not installed here: pip install them" in feature_count.words(values)
    monkeypatch.setattr(feature_count, "SOURCES", (absent,))
    with pytest.raises(RigError, match=r"install one of them: elsewhere: pip install them"):
        measure(job(tmp_path))


def test_a_real_pair_of_pictures_shows_the_figures_trend(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if not motorcycle():
        pytest.skip("scikit-image is not installed")
    sources = tuple(source for source in feature_count.SOURCES if source.name == "motorcycle")
    monkeypatch.setattr(feature_count, "SOURCES", sources)
    arguments = ["--only", "fig-4.7", "--quick", "--out", str(tmp_path), "--json", "-q"]
    assert run(["reproduce", *arguments]) == 0
    told = json.loads(capsys.readouterr().out)["fig-4.7"]["sources"]["motorcycle"]
    errors = dict(zip(feature_count.CAPS, told["essential"], strict=True))
    assert errors[500] < 0.2 * errors[50]
    assert errors[10_000] < 0.02
    folder = tmp_path / "fig-4.7-quick"
    assert "| 10000 |" in (folder / "fig-4.7.md").read_text()
    assert (folder / "fig-4.7.svg").read_text().count("<polyline") == 2


def test_a_package_that_is_not_there_is_none() -> None:
    assert package_folder("no_such_package_at_all", "data") is None
    assert package_folder("numpy", "core") is not None
