"""The report in a real browser: it draws, answers the pointer, stays offline and says the truth."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from synthetic_run import SyntheticRun

from rig.core.types import Pair
from rig.evaluation.report import write_report
from rig.evaluation.summary import summarise

BROWSER = shutil.which("chromium")
if BROWSER is None:
    pytest.skip("chromium is not installed", allow_module_level=True)

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1100,900",
    "--enable-logging=stderr",
    "--virtual-time-budget=4000",
    "--dump-dom",
]

PROBE = """
<script>
addEventListener("securitypolicyviolation", (e) => console.error("refused " + e.blockedURI));
addEventListener("load", () => setTimeout(() => {
  const colours = (canvas) => new Set(new Uint32Array(
    canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.buffer)).size;
  const canvases = [...document.querySelectorAll("main canvas")];
  const over = document.querySelector("#charts .u-over");
  const box = over.getBoundingClientRect();
  const ticks = () => canvases[0].toDataURL();
  const point = { clientX: box.left + box.width / 2, clientY: box.top + 40, bubbles: true };
  over.dispatchEvent(new MouseEvent("mouseenter", point));
  over.dispatchEvent(new MouseEvent("mousemove", point));
  const whole = ticks();
  const readouts = [...document.querySelectorAll("#charts figcaption")].map((c) => c.textContent);
  document.getElementById("zoom-in").click();
  setTimeout(() => {
    const zoomed = ticks();
    document.getElementById("zoom-out").click();
    setTimeout(() => {
      const answer = document.createElement("script");
      answer.type = "application/json";
      answer.id = "probe";
      answer.textContent = JSON.stringify({
        colours: canvases.map(colours), readouts, zoom: zoomed !== whole,
        requests: performance.getEntriesByType("resource").map((e) => e.name)
          .filter((name) => !name.startsWith("data:")),
        drawn: [...document.querySelectorAll(".picture svg")]
          .filter((svg) => getComputedStyle(svg).display !== "none")
          .map((svg) => svg.className.baseVal),
        dark: getComputedStyle(document.body).backgroundColor,
        pictures: [...document.images].map((i) => i.naturalWidth),
        wide: document.documentElement.scrollWidth > innerWidth,
        injected: document.querySelectorAll("[onerror]").length,
      }).replaceAll("<", "\\\\u003c");
      document.body.append(answer);
    }, 200);
  }, 200);
}, 200));
</script>
"""


class Cells(HTMLParser):
    """Collects the value of each `<data>` with the attributes of its cell and row."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.row: dict[str, str | None] = {}
        self.cell: dict[str, str | None] = {}
        self.values: dict[tuple[str | None, ...], float] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        if tag == "tr":
            self.row = attributes
        elif tag == "td":
            self.cell = self.row | attributes
        elif tag == "data" and "data-key" in self.cell:
            names = ("data-side", "data-segment", "data-front-end", "data-key", "data-index")
            place = tuple(self.cell[name] for name in names if name in self.cell)
            self.values[place] = float(attributes["value"] or "nan")
            self.cell = {}


@dataclass(frozen=True)
class Visit:
    """What a browser made of a report."""

    summary: dict[str, Any]
    dom: str
    probe: dict[str, Any]
    console: list[str]


def visit(run: SyntheticRun, folder: Path, *flags: str) -> Visit:
    summary = summarise(run)
    page = folder / "report.html"
    write_report(page, run, summary)
    page.write_text(page.read_text().replace("</body>", PROBE + "</body>"))
    assert BROWSER is not None
    command = [BROWSER, *FLAGS, *flags, f"--user-data-dir={folder / 'profile'}", page.as_uri()]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r'id="probe">(.*?)</script>', result.stdout, re.DOTALL)
    assert found is not None, result.stderr
    console = [line for line in result.stderr.splitlines() if ":CONSOLE" in line]
    return Visit(summary.as_json(), result.stdout, json.loads(found.group(1)), console)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Visit:
    run = SyntheticRun(triggers=40, lost={20: "timeout", 31: "sequence"})
    return visit(run, tmp_path_factory.mktemp("report"))


def test_no_console_error(seen: Visit) -> None:
    assert seen.console == []


def test_no_request(seen: Visit) -> None:
    assert seen.probe["requests"] == []


def test_every_curve_is_drawn_and_every_picture_decodes(seen: Visit) -> None:
    assert len(seen.probe["colours"]) == 7 + 2 + 1
    assert min(seen.probe["colours"]) > 5
    assert seen.probe["pictures"]
    assert min(seen.probe["pictures"]) > 0


def test_the_pointer_reads_all_curves_at_one_pair(seen: Visit) -> None:
    places = [re.search(r"pair (\d+) · (\d+\.\d+) s", text) for text in seen.probe["readouts"]]
    pairs = {int(place.group(1)) for place in places if place is not None}
    assert None not in places
    assert len(pairs) == 1
    pair = pairs.pop()
    assert 15 <= pair <= 25
    assert re.search(r"ours \S+aeag \S+$", seen.probe["readouts"][0])


def test_zoom_changes_the_picture(seen: Visit) -> None:
    assert seen.probe["zoom"] is True


def test_the_page_is_no_wider_than_the_window(seen: Visit) -> None:
    assert seen.probe["wide"] is False


def test_tables_equal_summary_json(seen: Visit) -> None:
    shown = Cells(seen.dom).values
    expected: dict[tuple[str, ...], float | None] = {
        ("frames",): seen.summary["frames"],
        ("pairs_complete",): seen.summary["pairs_complete"],
    }
    expected |= {("drops", cause): n for cause, n in seen.summary["drops"].items()}
    for side in ("left", "right"):
        part = seen.summary[side]
        for name in ("orb", "viso2"):
            expected |= {(side, name, key): number for key, number in part[name].items()}
            for kind, segment in part["segments"].items():
                for key in ("median", "min", "blind_frames"):
                    expected[(side, kind, name, key)] = segment[name][key]
        for key in ("exposure_us", "gain_db"):
            expected |= {(side, key, str(i)): part[key][i] for i in range(3)}
        expected |= {(side, "decision_ms", p): n for p, n in part["decision_ms"].items()}
        told = part["odometry"]
        for key in ("frames_lost", "ate_m", "rpe_m", "rpe_deg", "scale"):
            expected[(side, "odometry", key)] = told[key]
        expected |= {(side, "failures", reason): n for reason, n in told["failures"].items()}
    assert len(seen.summary["left"]["segments"]) == 2
    assert {place: value for place, value in expected.items() if value is not None} == {
        place: value for place, value in shown.items() if place in expected
    }
    unexpected = [place for place in shown if place not in expected]
    assert all(place[1] == "failures" and shown[place] == 0 for place in unexpected)


def test_hostile_names_run_no_script(tmp_path: Path) -> None:
    hostile = "</script><img src=x onerror=console.error(1)>"
    seen = visit(SyntheticRun(triggers=14, names=Pair(hostile, "aeag")), tmp_path)
    assert seen.console == []
    assert seen.probe["injected"] == 0
    assert seen.probe["requests"] == []


def test_only_the_chosen_front_ends_matches_are_drawn(seen: Visit) -> None:
    assert set(seen.probe["drawn"]) == {"orb"}
    assert len(seen.probe["drawn"]) == len(seen.probe["pictures"])


def test_it_is_dark_where_the_reader_likes_it_dark_and_fits_a_phone(
    seen: Visit, tmp_path: Path
) -> None:
    assert seen.probe["dark"] == "rgb(255, 255, 255)"
    flags = ("--blink-settings=preferredColorScheme=0", "--window-size=390,844")
    phone = visit(SyntheticRun(triggers=30, lost={20: "timeout"}), tmp_path, *flags)
    assert phone.probe["dark"] == "rgb(20, 24, 28)"
    assert phone.probe["wide"] is False
    assert phone.console == []
    assert min(phone.probe["colours"]) > 5
