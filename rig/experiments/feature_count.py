"""Does a picture with more features give a better pose? (thesis 4.2.3, figure 4.7)

The thesis takes 1000 stereo pairs from ten KITTI drives, which no package holds. Here the stereo
pairs are those that packages do hold, found where they are installed; nothing is fetched. Each is
rectified, so that its true rotation is none and its true translation is along x.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RigError
from rig.core.types import Intrinsics
from rig.experiments.reproduce import Job
from rig.plot import Curve, Curves, svg
from rig.vision.matching import mutual_matches
from rig.vision.orb import OrbFrontEnd

CAPS = (20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)
"""The upper limits on features; the thesis goes from 20 to 10000."""

DRAWS = 20
RANSAC_PX = 1.0
CONFIDENCE = 0.999
MATCHES_MIN = 8
OPENCV_DOC = Path("/usr/share/doc/opencv-doc/examples/data")

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """What two rectified cameras saw: matched rays (x / z, y / z), N x 2 each, best first.

    `rays(cap)` gives those that at most `cap` features a picture leave. `focal_px` turns pixels
    into the unit of rays.
    """

    rays: Callable[[int], tuple[Points, Points]]
    focal_px: float


@dataclass(frozen=True, slots=True)
class Source:
    """Where pairs come from: a name, what they are, how to get them, and a way to read them."""

    name: str
    what: str
    needs: str
    read: Callable[[], list[StereoPair]]


def measure(job: Job) -> dict[str, Any]:
    """Return mean errors over feature limits for every source that is installed.

    Raises RigError when none is.
    """
    draws = 3 if job.quick else DRAWS
    sources = SOURCES
    results: dict[str, Any] = {}
    missing = {}
    for done, source in enumerate(sources):
        pairs = source.read()
        job.advance(done, len(sources))
        if not pairs:
            missing[source.name] = source.needs
            continue
        job.say(f"{source.name}: {len(pairs)} stereo pairs, {draws} draws each")
        results[source.name] = {"what": source.what, **over_caps(pairs, draws)}
    job.advance(len(sources), len(sources))
    if not results:
        wanted = "; ".join(f"{name}: {needs}" for name, needs in missing.items())
        raise RigError(f"fig-4.7 found none of its stereo pairs; install one of them: {wanted}")
    return {"caps": list(CAPS), "draws": draws, "sources": results, "missing": missing}


def over_caps(pairs: Sequence[StereoPair], draws: int) -> dict[str, Any]:
    """Return per limit: mean essential and rotation errors, mean inliers, and failed trials.

    A trial fails when fewer than 8 matches are left or no essential matrix is found; it counts in
    `failed` and not in the means, which are None where every trial failed.
    """
    columns: dict[str, list[Any]] = {"essential": [], "rotation": [], "inliers": [], "failed": []}
    for cap in CAPS:
        trials = [
            trial
            for pair in pairs
            for rays in [pair.rays(cap)]
            for trial in (pose_errors(*rays, pair.focal_px, seed) for seed in range(draws))
        ]
        told = [trial for trial in trials if trial is not None]
        for k, name in enumerate(("essential", "rotation", "inliers")):
            columns[name].append(float(np.mean([t[k] for t in told])) if told else None)
        columns["failed"].append(len(trials) - len(told))
    return {**columns, "trials": len(pairs) * draws, "pairs": len(pairs)}


def pose_errors(
    left: Points, right: Points, focal_px: float, seed: int
) -> tuple[float, float, int] | None:
    """Return (essential error, rotation error, inliers) of one estimate; None where it fails.

    Errors are the sums of squared differences of thesis eq. 4.3. An essential matrix is known up
    to its scale and sign: it is brought to the length of the true one, whose translation is 1, and
    to the nearer sign. Matches are drawn in an order of their own for each seed.
    """
    if len(left) < MATCHES_MIN:
        return None
    order = np.random.default_rng(seed).permutation(len(left))
    a, b = left[order], right[order]
    cv2.setRNGSeed(seed)
    found, mask = cv2.findEssentialMat(
        a, b, np.eye(3), method=cv2.RANSAC, prob=CONFIDENCE, threshold=RANSAC_PX / focal_px
    )
    if found is None or found.shape != (3, 3):
        return None
    inliers, rotation, _, _ = cv2.recoverPose(found, a, b, np.eye(3), mask=mask)
    essential = found * np.sqrt(2) / np.linalg.norm(found)
    truth = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    error = min(((sign * essential - truth) ** 2).sum() for sign in (1, -1))
    return float(error), float(((rotation - np.eye(3)) ** 2).sum()), int(inliers)


def of_pictures(left: Path, right: Path, lenses: tuple[Intrinsics, Intrinsics]) -> StereoPair:
    """Return a pair of pictures, in which ORB finds at most so many features."""
    greys = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (left, right)]
    if any(grey is None for grey in greys):
        raise RigError(f"{left.parent}: {left.name} or {right.name} cannot be read; reinstall it")

    def rays(cap: int) -> tuple[Points, Points]:
        orb = OrbFrontEnd(features_max=cap, size_px=None)
        a, b = (orb.features(np.asarray(grey, np.uint8)) for grey in greys)
        pairs = mutual_matches(a.descriptors, b.descriptors)
        matched = a.points_px[pairs[:, 0]], b.points_px[pairs[:, 1]]
        first, second = (_rays(*item) for item in zip(matched, lenses, strict=True))
        return first, second

    return StereoPair(rays, lenses[0].fx_px)


def of_tracks(left_px: Points, right_px: Points, lens: Intrinsics, seed: int) -> StereoPair:
    """Return a pair of which only matched points are known, limited in an order of chance."""
    order = np.random.default_rng(seed).permutation(len(left_px))
    left, right = _rays(left_px[order], lens), _rays(right_px[order], lens)
    return StereoPair(lambda cap: (left[:cap], right[:cap]), lens.fx_px)


def _rays(points_px: NDArray[Any], lens: Intrinsics) -> Points:
    return (np.asarray(points_px, np.float64) - (lens.cx_px, lens.cy_px)) / (lens.fx_px, lens.fy_px)


def motorcycle() -> list[StereoPair]:
    """Return Middlebury 2014's Motorcycle, a quarter of its size, from scikit-image."""
    folder = package_folder("skimage", "data")
    if folder is None or not (folder / "motorcycle_left.png").is_file():
        return []
    left = Intrinsics(741, 500, 994.978, 994.978, 311.193, 254.877)
    right = Intrinsics(741, 500, 994.978, 994.978, 311.193 + 31.086, 254.877)
    names = folder / "motorcycle_left.png", folder / "motorcycle_right.png"
    return [of_pictures(*names, (left, right))]


def aloe() -> list[StereoPair]:
    """Return Middlebury 2006's Aloe, at full size, from Debian's opencv-doc.

    The focal length is the collection's. The pictures are cut at the sides without the principal
    point being told; the middle is taken, the same in both, which keeps the truth.
    """
    names = OPENCV_DOC / "aloeL.jpg", OPENCV_DOC / "aloeR.jpg"
    if not all(name.is_file() for name in names):
        return []
    lens = Intrinsics(1282, 1110, 3740.0, 3740.0, 640.5, 554.5)
    return [of_pictures(*names, (lens, lens))]


def kitti_tracks() -> list[StereoPair]:
    """Return the stereo tracks of a KITTI drive that gtsam's wheel holds: points, no pictures."""
    folder = package_folder("gtsam", "Data")
    if folder is None or not (folder / "VO_stereo_factors00.txt").is_file():
        return []
    fx, fy, _, cx, cy, _ = np.loadtxt(folder / "VO_calibration00.txt")
    lens = Intrinsics(1241, 376, float(fx), float(fy), float(cx), float(cy))
    table = np.loadtxt(folder / "VO_stereo_factors00.txt", usecols=(0, 2, 3, 4))
    return list(_frames(table, lens))


def _frames(table: Points, lens: Intrinsics) -> Iterator[StereoPair]:
    for frame in np.unique(table[:, 0]):
        rows = table[table[:, 0] == frame]
        yield of_tracks(rows[:, [1, 3]], rows[:, [2, 3]], lens, int(frame))


def package_folder(package: str, folder: str) -> Path | None:
    """Return a folder inside an installed package, which is not imported; None without it."""
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        return None
    return Path(spec.submodule_search_locations[0]) / folder


SOURCES: tuple[Source, ...] = (
    Source(
        "motorcycle",
        "one rectified pair of pictures, Middlebury 2014, 741 x 500 px; ORB features",
        "pip install scikit-image",
        motorcycle,
    ),
    Source(
        "aloe",
        "one rectified pair of pictures, Middlebury 2006, 1282 x 1110 px; ORB features",
        "apt-get install opencv-doc",
        aloe,
    ),
    Source(
        "kitti-tracks",
        "matched points of the stereo pairs of one KITTI drive, already free of most outliers",
        "pip install gtsam",
        kitti_tracks,
    ),
)


def words(values: dict[str, Any]) -> str:
    """Return the figure as a table for a person."""
    lines = [
        "Mean error of the essential and the rotation matrix over the limit on features",
        "(sum of squared differences, thesis eq. 4.3; inliers in brackets).",
        "",
    ]
    for name, told in values["sources"].items():
        lines += [
            f"{name}: {told['what']}; {told['pairs']} pairs, {told['trials']} trials a limit",
            "",
            "| features at most | essential | rotation | inliers | failed |",
            "|---:|---:|---:|---:|---:|",
        ]
        rows = zip(values["caps"], *(told[key] for key in _COLUMNS), strict=True)
        lines += [
            f"| {cap} | {_short(essential)} | {_short(rotation)} | {_short(inliers)} | {failed} |"
            for cap, essential, rotation, inliers, failed in rows
        ]
        lines.append("")
    for name, needs in values["missing"].items():
        lines.append(f"{name} is not installed here: {needs}")
    return "\n".join(lines).strip()


def draw(values: dict[str, Any]) -> str:
    """Return the errors of both matrices over the limit on features, a curve a source."""
    return svg([_errors(values, name) for name in ("essential", "rotation")])


def _errors(values: dict[str, Any], name: str) -> Curves:
    curves = []
    for source, told in values["sources"].items():
        known = [(c, e) for c, e in zip(values["caps"], told[name], strict=True) if e is not None]
        curves.append(Curve(source, [cap for cap, _ in known], [error for _, error in known]))
    return Curves(f"{name} matrix", curves, "features at most", "error", True, True)


_COLUMNS = ("essential", "rotation", "inliers", "failed")


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
