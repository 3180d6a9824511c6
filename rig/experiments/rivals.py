"""The free parameters of every rival, and which of their values are tried."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

Variants = tuple[str, ...]


def _each(name: str, **values: tuple[object, ...]) -> Variants:
    """Return the specifications of all combinations of some options' values."""
    specs = []
    for chosen in product(*values.values()):
        options = ",".join(f"{key}={value}" for key, value in zip(values, chosen, strict=True))
        specs.append(f"{name}:{options}")
    return tuple(specs)


CONSTANTS: Variants = (
    *_each("fixed", exposure_us=(500, 1000, 2000, 4000, 8000), gain_db=(0, 5, 10, 15, 20)),
    *_each("fixed", exposure_us=(250, 500), gain_db=(25,)),
    *_each("fixed", exposure_us=(250,), gain_db=(20,)),
    *_each("fixed", exposure_us=(700,), gain_db=(15, 20)),
)
"""What no control at all comes to; the best of these is the reference of every score."""

RIVALS: Mapping[str, Variants] = {
    "aeag": (
        *_each(
            "aeag",
            target_dn=(110, 140, 170),
            damping=(0,),
            exposure_us_max=(2000, 4000, 10000, 30000),
        ),
        *_each("aeag", damping=(0.3, 0.6)),
        "aeag:target_dn=140,damping=0.3,exposure_us_max=4000",
        *_each(
            "aeag",
            target_dn=(110, 140),
            damping=(0,),
            exposure_us_max=(4000,),
            metering=("lower", "partial"),
        ),
        *_each("aeag", target_dn=(110, 140), damping=(0,), priority=("exposure",)),
        *_each(
            "aeag",
            target_dn=(155,),
            damping=(0, 0.3),
            exposure_us_max=(4000,),
            metering=("average", "partial"),
        ),
        "aeag:target_dn=140,damping=0.3,exposure_us_max=4000,metering=partial",
        "aeag:target_dn=155,damping=0.3,exposure_us_max=2000,metering=partial",
        *_each(
            "aeag",
            target_dn=(140,),
            damping=(0,),
            exposure_us_max=(1000, 3000),
            metering=("partial",),
        ),
    ),
    "aeag, vendor": ("aeag:preset=vendor",),
    "ae": (
        *_each("ae", target_dn=(80, 110, 140), damping=(0.5,)),
        *_each("ae", target_dn=(110, 140), damping=(0,), gain_db=(0, 10, 20)),
        *_each("ae", target_dn=(140,), damping=(0,), gain_db=(20,), exposure_us_max=(2000, 4000)),
        "ae:target_dn=155,damping=0,gain_db=20",
        "ae:target_dn=140,damping=0,gain_db=25",
        "ae:target_dn=140,damping=0.3,gain_db=20",
    ),
    **{
        name: (
            *_each(name, speed=(1,), exposure_us_max=(500, 1000, 2000, 4000)),
            *_each(name, speed=(0.6,), exposure_us_max=(4000,)),
        )
        for name in ("mean-30", "mean-50", "mean-70")
    },
    "geomean": (
        *_each("geomean", target=(0.3, 0.4, 0.5), exposure_us_max=(2000, 3000, 4000, 8000)),
        *_each("geomean", target=(0.4,), speed=(0.6, 1), exposure_us_max=(4000,)),
        *_each("geomean", target=(0.6,), exposure_us_max=(1000, 2000)),
        *_each("geomean", target=(0.5,), exposure_us_max=(500, 700, 1000, 1500)),
        "geomean:target=0.5,speed=0.6,exposure_us_max=3000",
        "geomean:target=0.2",
    ),
    "lu": (*_each("lu", threshold_dn=(10, 20, 40, 80)), "lu:coarse=5"),
    "shim": (
        *_each("shim", kp=(0.2, 1.2), gain_db=(0, 10)),
        *_each("shim", version=(2018,), kp=(1.6, 3.2), gain_db=(0, 10)),
        "shim:kp=0.2,gain_db=20",
        "shim:version=2018,kp=1.6,gain_db=20",
    ),
    "shim, split": (
        *_each("shim", gain=("split",), exposure_us_max=(4000,), kp=(0.2, 0.6, 1.2)),
        *_each("shim", version=(2018,), gain=("split",), exposure_us_max=(4000,), kp=(1.6, 3.2)),
    ),
    "zhang": (
        *_each("zhang", rate=(0.3, 1, 3)),
        *_each("zhang", rate=(3, 10, 30), exposure_us_max=(4000,)),
    ),
    "zhang, split": _each("zhang", gain=("split",), exposure_us_max=(4000, 10000), rate=(1, 3)),
    "kim": (
        *_each("kim", evaluations_max=(10, 15, 20), keep=(0.2, 0.5)),
        "kim:keep=0.8",
        "kim:gain_db_max=24",
        "kim:evaluations_max=10,alpha=50,length=15.5,ridge=1",
    ),
    "shin": (
        *_each("shin", tolerance=("low", "mid", "high", 0.5)),
        *_each("shin", tolerance=("high", 0.5, 1), evaluations_max=(15,)),
        *_each("shin", tolerance=("mid", "high", 0.5), rounds=(1,)),
    ),
}
"""Under the name of each row of the table, what is tried; the best of a row is its best setting."""

QUICK: Mapping[str, Variants] = {
    "aeag": _each("aeag", target_dn=(80, 110), damping=(0,)),
    "geomean": _each("geomean", target=(0.2, 0.4)),
    "shin": _each("shin", tolerance=("mid", "high")),
}
