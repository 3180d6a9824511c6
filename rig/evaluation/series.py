"""A run as columns of numbers: one row a trigger, read once from its records."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Decision, Diagnostics, Frame, Intrinsics, Lost, Pair, PairRecord
from rig.core.units import NS_PER_S, NS_PER_US
from rig.evaluation.front_ends import FRONT_ENDS, FrontEnds
from rig.evaluation.inliers import arrived, grey_of
from rig.evaluation.odometry import Odometry, OdometryCounter, Trajectory, pose_matrix

Column = NDArray[np.float64]

UNKNOWN_LENSES: Pair[Intrinsics | None] = Pair(None, None)


@dataclass(frozen=True, slots=True, eq=False)
class CameraSeries:
    """What one camera did over a run; every column has one entry a record, NaN where absent.

    `inliers` maps a front end's name to the counts between the pictures of trigger k - 1 and k.
    `exposure_us` and `gain_db` are those used. `mean_grey_dn` is 0..255. `decision_ms` is how
    long the decision taken after this pair took. `thoughts` are what the controller said of itself
    then: columns of its numbers by name. `words` are its words, one tuple a name, "" where absent.
    `odometry` is there when the viso2-style front end ran and the lens is known.
    """

    inliers: Mapping[str, Column]
    exposure_us: Column
    gain_db: Column
    mean_grey_dn: Column
    decision_ms: Column
    thoughts: Mapping[str, Column] = field(default_factory=dict)
    words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    odometry: Odometry | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RunSeries:
    """A run in columns. An incomplete pair has a trigger and a cause; the rest of it is NaN.

    `time_s` is the primary's device time since the first complete pair, `light_cd_m2` the mean
    radiance of the primary's view (simulation only), `offset_us` secondary minus primary time.
    """

    trigger: NDArray[np.int64]
    cause: tuple[str, ...]
    time_s: Column
    light_cd_m2: Column
    offset_us: Column
    cameras: Pair[CameraSeries]

    def __len__(self) -> int:
        return len(self.cause)


class _Look(NamedTuple):
    """One camera's row."""

    inliers: tuple[float, ...]
    exposure_us: float
    gain_db: float
    mean_grey_dn: float
    decision_ms: float
    diagnostics: Diagnostics


class _Event(NamedTuple):
    """The row that both cameras share."""

    time_ns: float
    light_cd_m2: float
    offset_us: float


class _Watcher:
    """Measures one camera's pictures, with a counter for each front end."""

    def __init__(self, front_ends: FrontEnds, intrinsics: Intrinsics | None) -> None:
        self._counters = [recipe.counter(intrinsics) for recipe in front_ends.values()]

    def look(self, trigger: int, shot: Frame | Lost, decision: Decision | None) -> _Look:
        """Return the row of a frame that came."""
        frame = arrived(shot)
        grey = grey_of(frame)
        return _Look(
            inliers=tuple(counter.count(trigger, grey) for counter in self._counters),
            exposure_us=frame.used.exposure_us,
            gain_db=frame.used.gain_db,
            mean_grey_dn=float(grey.mean()),
            decision_ms=decision.latency_ms if decision is not None else np.nan,
            diagnostics=decision.diagnostics if decision is not None else {},
        )

    def look_away(self) -> _Look:
        """Return the row of an incomplete pair."""
        return _Look((np.nan,) * len(self._counters), np.nan, np.nan, np.nan, np.nan, {})

    def odometry(self, truth: Trajectory) -> Odometry | None:
        """Return what visual odometry made of the pictures; None when it did not run."""
        for counter in self._counters:
            if isinstance(counter, OdometryCounter):
                return Odometry(tuple(counter.steps), truth)
        return None


def measure(
    records: Iterable[PairRecord],
    front_ends: FrontEnds = FRONT_ENDS,
    intrinsics: Pair[Intrinsics] | Pair[Intrinsics | None] = UNKNOWN_LENSES,
) -> RunSeries:
    """Return the columns of a run, its records given in order.

    Both cameras are measured at the same time, in two threads; memory holds one pair of pictures
    and the features of the pair before. Which counts exist is told at
    `rig.evaluation.inliers.orb_inliers`. Both ways are compared with the primary camera's true
    one: the secondary's is the same but for the few centimetres between the two.
    """
    watchers = Pair(*(_Watcher(front_ends, lens) for lens in intrinsics))
    triggers: list[int] = []
    causes: list[str] = []
    events: list[_Event] = []
    looks: list[Pair[_Look]] = []
    truths: dict[int, NDArray[np.float64]] = {}
    with ThreadPoolExecutor(max_workers=2) as pool:
        for record in records:
            triggers.append(record.trigger)
            causes.append(record.cause)
            events.append(_event(record))
            if record.truth is not None:
                truth = record.truth
                truths[record.trigger] = pose_matrix(truth.position_m, truth.orientation_xyzw)
            if record.complete:
                both = pool.map(
                    _Watcher.look, watchers, [record.trigger] * 2, record.shot, record.decisions
                )
                looks.append(Pair(*both))
            else:
                looks.append(Pair(*(watcher.look_away() for watcher in watchers)))
    time_ns = _column([event.time_ns for event in events])
    came = time_ns[np.isfinite(time_ns)]
    way = Trajectory(
        np.array(list(truths), np.int64), np.array(list(truths.values())).reshape(-1, 4, 4)
    )
    return RunSeries(
        trigger=np.array(triggers, np.int64),
        cause=tuple(causes),
        time_s=(time_ns - (came[0] if came.size else 0.0)) / NS_PER_S,
        light_cd_m2=_column([event.light_cd_m2 for event in events]),
        offset_us=_column([event.offset_us for event in events]),
        cameras=Pair(
            _camera([pair.primary for pair in looks], front_ends, watchers.primary.odometry(way)),
            _camera(
                [pair.secondary for pair in looks], front_ends, watchers.secondary.odometry(way)
            ),
        ),
    )


def _event(record: PairRecord) -> _Event:
    time_ns = float(arrived(record.shot.primary).device_time_ns) if record.complete else np.nan
    return _Event(
        time_ns=time_ns,
        light_cd_m2=record.truth.light_cd_m2 if record.truth is not None else np.nan,
        offset_us=record.offset_ns / NS_PER_US if record.offset_ns is not None else np.nan,
    )


def _camera(
    looks: Sequence[_Look], front_ends: FrontEnds, odometry: Odometry | None
) -> CameraSeries:
    return CameraSeries(
        inliers={
            name: _column([look.inliers[index] for look in looks])
            for index, name in enumerate(front_ends)
        },
        exposure_us=_column([look.exposure_us for look in looks]),
        gain_db=_column([look.gain_db for look in looks]),
        mean_grey_dn=_column([look.mean_grey_dn for look in looks]),
        decision_ms=_column([look.decision_ms for look in looks]),
        thoughts=_thoughts([look.diagnostics for look in looks]),
        words=_words([look.diagnostics for look in looks]),
        odometry=odometry,
    )


def _thoughts(said: Sequence[Diagnostics]) -> dict[str, Column]:
    """Return the diagnostics that are numbers, each as a column, in order of appearance."""
    names = dict.fromkeys(name for row in said for name, v in row.items() if not isinstance(v, str))
    return {name: _column([_number(row.get(name)) for row in said]) for name in names}


def _number(value: float | str | None) -> float:
    return np.nan if value is None or isinstance(value, str) else float(value)


def _words(said: Sequence[Diagnostics]) -> dict[str, tuple[str, ...]]:
    """Return the diagnostics that are words, each as a tuple, in order of appearance."""
    names = dict.fromkeys(name for row in said for name, v in row.items() if isinstance(v, str))
    return {name: tuple(_word(row.get(name)) for row in said) for name in names}


def _word(value: float | str | None) -> str:
    return value if isinstance(value, str) else ""


def _column(values: Sequence[float]) -> Column:
    return np.array(values, np.float64)
