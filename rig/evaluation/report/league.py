"""The page of many runs: who won, by how much, how sure that is, and every run as a dot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.evaluation.aggregate import score
from rig.evaluation.differences import BLOCK_PAIRS
from rig.evaluation.report.page import assets, environment
from rig.evaluation.report.wording import FRONT_END_NAMES, labels, number
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS

WIDTH, LEFT, RIGHT = 460, 84, 444
ROW_PX, TOP_PX, BOTTOM_PX = 15, 8, 34

Values = Mapping[str, Any]


def write_league(path: Path, values: Values) -> None:
    """Write what many runs came to (the content of evaluation.json) as one offline page."""
    page = environment().get_template("league.html")
    path.write_text(page.render(_context(values) | assets()), encoding="utf-8")


def _context(values: Values) -> dict[str, Any]:
    runs = values["runs"]
    ranked = ranking(values)
    front_ends = [name for name in FRONT_END_NAMES if any(name in told for _, told, _ in ranked)]
    return {
        "runs": runs,
        "simulated": bool(runs) and all("sim:" in run["cameras"].split("?")[0] for run in runs),
        "ranked": ranked,
        "front_ends": {name: FRONT_END_NAMES[name] for name in front_ends},
        "duels": [_duel(pair, values) for pair in values["paired"]],
        "warm_up": WARM_UP_PAIRS,
        "blind_below": BLIND_BELOW,
        "block_pairs": BLOCK_PAIRS,
    }


def ranking(values: Values) -> list[tuple[str, Mapping[str, Any], tuple[int, int]]]:
    """Return (controller, its means, (won, lost)), the best median of ORB inliers first."""
    rows = [
        (name, told, score(name, values["paired"]))
        for name, told in values["by_controller"].items()
    ]
    return sorted(rows, key=lambda row: _median(row[1]), reverse=True)


def _median(told: Mapping[str, Any]) -> float:
    median = told.get("orb", {}).get("median")
    return -1.0 if median is None else float(median)


@dataclass(frozen=True, slots=True)
class Dot:
    """One run in one row of a plot: where both sides' numbers lie."""

    y: float
    left_x: float
    right_x: float
    row: str
    label: str


@dataclass(frozen=True, slots=True)
class Plot:
    """One quantity of every run of a duel, best difference first; SVG coordinates."""

    title: str
    dots: list[Dot]
    ticks: list[tuple[float, str]]
    height: float
    width: int = WIDTH
    left: int = LEFT
    right: int = RIGHT


@dataclass(frozen=True, slots=True)
class Duel:
    """Two controllers that drove side by side."""

    pair: str
    names: tuple[str, str]
    verdict: str
    plots: list[Plot]
    differences: Mapping[str, Any]


def _duel(pair: str, values: Values) -> Duel:
    result, apart = values["paired"][pair], values["differences"][pair]
    full = _names(pair, values["runs"])
    names = labels(*full)
    met = [_ordered(run, full) for run in values["runs"] if _met(run, full)]
    plots = [
        _plot(title, key, met)
        for title, key in (("Median ORB inliers", "median"), ("Fewest ORB inliers", "min"))
    ]
    return Duel(pair, names, verdict(names, result, apart["orb"]), plots, apart)


def _names(pair: str, runs: Sequence[Values]) -> tuple[str, str]:
    """Return the two controllers of "a vs b", whatever their options hold."""
    for run in runs:
        names = run["left"]["controller"], run["right"]["controller"]
        for a, b in (names, names[::-1]):
            if f"{a} vs {b}" == pair:
                return a, b
    raise ValueError(f"no run has {pair}")


def _met(run: Values, names: tuple[str, str]) -> bool:
    both = run["left"]["controller"], run["right"]["controller"]
    return both in (names, names[::-1]) and all(
        run[side].get("orb", {}).get("median") is not None for side in ("left", "right")
    )


def _ordered(run: Values, names: tuple[str, str]) -> tuple[str, Values, Values]:
    """Return (what to call a run, first controller's inliers, second's)."""
    left, right = run["left"], run["right"]
    if (left["controller"], right["controller"]) != names:
        left, right = right, left
    swapped = " swap" if "--swap" in run["command"].split() else ""
    return f"seed {run['seed']}{swapped}", left["orb"], right["orb"]


def verdict(names: tuple[str, str], result: Values, apart: Values) -> str:
    """Return how two controllers did, in a sentence with its numbers; one run claims nothing."""
    a, b = names
    runs, ratio, interval = apart["runs"], result["orb_median_ratio"], result["ci95"]
    times = "" if ratio is None else f" {number(ratio, 2)} times"
    sure = "" if interval is None else " (95 % {:.2f} to {:.2f})".format(*interval)
    more = apart["mean"]
    apart_by = (
        f"{number(abs(more['difference']), 0)} {'more' if more['difference'] >= 0 else 'fewer'}"
    )
    between = "" if more["ci95"] is None else " (95 % {:+.0f} to {:+.0f})".format(*more["ci95"])
    tail = f"It won {result['wins']} and lost {result['losses']}."
    if runs == 1:
        tail = "One run is one sample: it shows no significance."
    drives = "one drive" if runs == 1 else f"{runs} drives"
    return (
        f"Over {drives} {a} had{times} the median ORB inliers of {b}{sure}, and at the same "
        f"moment {apart_by} on average{between}. {tail}"
    )


def _plot(title: str, key: str, met: Sequence[tuple[str, Values, Values]]) -> Plot:
    rows = sorted(met, key=lambda run: run[1][key] - run[2][key], reverse=True)
    most = max([side[key] for _, *sides in rows for side in sides] + [1])
    step = _round_step(most / 4)
    scale = (RIGHT - LEFT) / most
    dots = [
        Dot(
            y=TOP_PX + ROW_PX * (k + 0.5),
            left_x=round(LEFT + a[key] * scale, 1),
            right_x=round(LEFT + b[key] * scale, 1),
            row=name,
            label=f"{name}: {number(a[key])} and {number(b[key])}",
        )
        for k, (name, a, b) in enumerate(rows)
    ]
    ticks = [
        (round(LEFT + value * step * scale, 1), number(value * step))
        for value in range(int(most // step) + 1)
    ]
    return Plot(title, dots, ticks, TOP_PX + ROW_PX * len(rows) + BOTTOM_PX)


def _round_step(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at least `value`."""
    power = 10.0 ** (len(str(int(max(value, 1)))) - 1)
    return next(step * power for step in (1, 2, 5, 10) if step * power >= value)
