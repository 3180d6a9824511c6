"""`table-5.1` to `table-5.5`, `fig-5.7`, `fig-5.8`: who is compared with whom, and on which drives.

The thesis' networks are the shipped ones, trained by its recipe on simulated drives of the train
split. What can be compared with the thesis is the ratio between two methods, not a count: other
roads, other cameras. The thesis raced two methods at a time on a drive of their own; here all
methods of a table have the same drives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from rig.experiments.contests import Contest, Duel, hold
from rig.experiments.contests import draw as draw
from rig.experiments.contests import words as words

INLIERS = ("orb_median", "viso2_median", "orb_min", "viso2_min")
"""The columns of tables 5.1 to 5.4, in their order."""

PROCESSED = ("processed_pct", "inlier_pct")
"""The columns of table 5.5; how much is lost while moving is told beside them."""

AE, AEAG, TUNED = "AE at 10 dB", "AE+AG", "AE+AG, tuned"
SINGLE, HYBRID, OURS = "thesis, single", "thesis, hybrid", "ours"
SHIN_HIGH, SHIN, SHIN_LOW = "Shin, high tolerance", "Shin, mid tolerance", "Shin, low tolerance"

FIXED_GAIN = "ae:gain_db=10,target_dn=110,damping=0.5,exposure_us_max=30000"
"""The camera's AE as nobody has tuned it, at the gain of the single-parameter network."""

BUILT_IN: Mapping[str, str] = {AEAG: "aeag:preset=vendor", TUNED: "aeag"}
"""What the camera brings, as nobody has tuned it and as it serves best."""

WAYS: Mapping[str, str] = {
    "M_feat": "thesis-feat",
    "M_feat, windowed": "thesis-feat-windowed",
    "M_grid, windowed": "thesis-grid-windowed",
    "M_hybrid, windowed": "thesis",
}
"""Figs. 5.7 and 5.8: dual-parameter networks by the targets that they learned from."""

ROADS, TUNNELS, ROUTES = range(31, 35), range(31, 39), range(31, 33)
"""At least four static drives (table 5.3), eight tunnels (table 5.4), four underpasses (5.5)."""


def _published(*pairs: tuple[float, float]) -> dict[str, tuple[float, float]]:
    return dict(zip(INLIERS, pairs, strict=True))


def _ways(world: str, seeds: Sequence[int]) -> Contest:
    rivals = [Duel("M_hybrid, windowed", way) for way in list(WAYS)[:-1]]
    return Contest(world, seeds, INLIERS, WAYS, rivals)


def _dual(world: str, seeds: Sequence[int], aeag: Duel, shin: Duel) -> Contest:
    methods = {**BUILT_IN, SHIN: "shin:tolerance=mid", HYBRID: "thesis", OURS: "ours"}
    others = [Duel(HYBRID, TUNED), Duel(OURS, TUNED)]
    return Contest(world, seeds, INLIERS, methods, [aeag, shin, *others])


TABLE_5_1 = Contest(
    "road",
    ROADS,
    INLIERS,
    {
        AE: FIXED_GAIN,
        **BUILT_IN,
        SHIN_HIGH: "shin:tolerance=high",
        SHIN: "shin:tolerance=mid",
        SHIN_LOW: "shin:tolerance=low",
        SINGLE: "thesis-single",
    },
    [
        Duel(SINGLE, AE, _published((277, 317), (3165, 3810), (43, 47), (1857, 2545))),
        Duel(SINGLE, AEAG, _published((504, 475), (6709, 6464), (53, 56), (4538, 4382))),
        Duel(SINGLE, SHIN_HIGH, _published((526, 542), (5655, 5206), (144, 162), (4269, 3459))),
        Duel(SINGLE, SHIN, _published((545, 555), (5398, 5369), (294, 251), (3611, 3786))),
        Duel(SINGLE, SHIN_LOW, _published((410, 396), (4939, 4040), (45, 48), (12, 228))),
        Duel(SINGLE, TUNED),
    ],
)
TABLE_5_2 = Contest(
    "tunnel",
    TUNNELS,
    INLIERS,
    {AE: FIXED_GAIN, SHIN: "shin:tolerance=mid", SINGLE: "thesis-single"},
    [
        Duel(SINGLE, AE, _published((324, 342), (5514, 6467), (68, 21), (509, 293))),
        Duel(SINGLE, SHIN, _published((341, 284), (3739, 4420), (78, 32), (205, 282))),
    ],
)
TABLE_5_3 = _dual(
    "road",
    ROADS,
    Duel(HYBRID, AEAG, _published((593, 600), (8301, 9591), (366, 401), (5840, 6636))),
    Duel(HYBRID, SHIN, _published((414, 439), (5295, 5666), (183, 200), (3555, 4032))),
)
TABLE_5_4 = _dual(
    "tunnel",
    TUNNELS,
    Duel(HYBRID, AEAG, _published((433, 434), (5288, 6582), (65, 97), (377, 473))),
    Duel(HYBRID, SHIN, _published((131, 202), (614, 3530), (0, 37), (0, 127))),
)
TABLE_5_5 = Contest(
    "route",
    ROUTES,
    (*PROCESSED, "lost_moving_pct"),
    {**BUILT_IN, HYBRID: "thesis", "thesis, alpha 0.33": "thesis-alpha33", OURS: "ours"},
    [
        Duel(HYBRID, AEAG, dict(zip(PROCESSED, ((65.17, 72.56), (50.84, 58.36)), strict=True))),
        Duel(
            "thesis, alpha 0.33",
            AEAG,
            dict(zip(PROCESSED, ((52.43, 56.69), (40.48, 44.38)), strict=True)),
        ),
        Duel(HYBRID, TUNED),
        Duel(OURS, TUNED),
    ],
)
FIG_5_7 = _ways("road", ROADS)
FIG_5_8 = _ways("tunnel", TUNNELS)


table_5_1, table_5_2 = partial(hold, TABLE_5_1), partial(hold, TABLE_5_2)
table_5_3, table_5_4 = partial(hold, TABLE_5_3), partial(hold, TABLE_5_4)
table_5_5 = partial(hold, TABLE_5_5)
fig_5_7, fig_5_8 = partial(hold, FIG_5_7), partial(hold, FIG_5_8)
