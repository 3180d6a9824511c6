"""Table 4.1 beside this machine's times; the whole of it runs as `rig reproduce`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig.cli.main import run
from rig.experiments import forward_times
from rig.experiments.forward_times import TABLE_4_1, words
from rig.models.networks import NETWORKS
from rig.models.timing import Times


def test_the_thesis_column_is_about_the_networks_that_there_are() -> None:
    assert {name: row[0] for name, row in TABLE_4_1.items()} == {
        name: architecture.parameters for name, architecture in NETWORKS.items()
    }


def test_a_quick_run_times_networks_in_both_arithmetics(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forward_times, "NETS", ("dual-small", "map-small"))
    monkeypatch.setattr(forward_times, "QUICK_RUNS", 3)
    arguments = ["--only", "table-4.1", "--quick", "--out", str(tmp_path), "--json", "-q"]
    assert run(["reproduce", *arguments]) == 0
    told = json.loads(capsys.readouterr().out)["table-4.1"]
    small, score_map = told["nets"]["dual-small"], told["nets"]["map-small"]
    assert (told["runs"], small["parameters"]) == (3, 1_546_498)
    for times in (small["full"], small["int8"], score_map["full"]):
        assert 0 < times["median_ms"] <= times["p99_ms"]
    assert score_map["int8"] is None
    assert score_map["full"]["median_ms"] < small["full"]["median_ms"]
    page = (tmp_path / "table-4.1-quick" / "table-4.1.md").read_text()
    assert "| dual-small | 1,546,498 | 1,546,498 | 1.3 |" in page


def test_words_show_the_thesis_beside_the_measured() -> None:
    full, small = ({"median_ms": m, "p99_ms": p} for m, p in ((4.2, 4.5), (2.9, 3.25)))
    values = {
        "processor": "Z80",
        "cores": 2,
        "load": 3.14,
        "runs": 7,
        "nets": {
            "single": {"parameters": 1_746_609, "full": full, "int8": small},
            "map-small": {"parameters": 9, "full": full, "int8": None},
        },
    }
    page = words(values)
    assert "| single | 1,746,609 | 1,746,609 | 1.5 | 4.20 / 4.50 | 2.90 / 3.25 |" in page
    assert "| map-small | 9 | - | - | 4.20 / 4.50 | - |" in page
    assert "7 runs" in page and "Z80, 2 cores, load average 3.1" in page


def test_times_are_of_the_runs_behind_the_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    from rig.models import timing

    clock = iter([second for run in range(14) for second in (run, run + (9 if run < 10 else 0.5))])
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    calls: list[int] = []
    assert timing._times(lambda: calls.append(1), 4) == Times(500.0, 500.0)
    assert len(calls) == 14


def test_without_torch_it_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.delitem(sys.modules, "rig.models.forward", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    arguments = ["--only", "table-4.1", "--quick", "--out", str(tmp_path), "-q"]
    assert run(["reproduce", *arguments]) == 1
    assert "pip install 'exposure-rig[train]'" in capsys.readouterr().err
