"""Rules that every test keeps."""

from __future__ import annotations

from pathlib import Path

import pytest
from usb3 import bus

SKIPS = Path(__file__).parent / "skips.txt"


def allowed_skips() -> list[tuple[str, str]]:
    """Return (start of the test's id, reason) for each line of skips.txt."""
    lines = [line.strip() for line in SKIPS.read_text().splitlines()]
    rows = [line.split(None, 1) for line in lines if line and not line.startswith("#")]
    return [(test, reason) for test, reason in rows]


def reason_of(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Return why a test was skipped, without pytest's prefix."""
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return text.removeprefix("Skipped: ")


class SkipWatch:
    """Fails the run when a test is skipped without its reason being in skips.txt."""

    def __init__(self) -> None:
        self.unlisted: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._check(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self._check(report)

    def _check(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        if not report.skipped or hasattr(report, "wasxfail"):
            return  # a test that is expected to fail has run
        reason = reason_of(report)
        rows = allowed_skips()
        if not any(report.nodeid.startswith(test) and reason == why for test, why in rows):
            self.unlisted.append(f"{report.nodeid}: {reason}")

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.unlisted and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for line in self.unlisted:
            terminalreporter.write_line(f"skip not listed in tests/skips.txt: {line}", red=True)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(SkipWatch(), "skip-watch")
    if bus.can_build() and config.option.markexpr != "hardware":
        bus.load(
            config.rootpath / ".pytest_cache" / "usb-stand-in"
        )  # before anything brings Aravis in
