"""report.html, the one-file page of a run: `rig.evaluation.report.page.write_report`."""

from rig.evaluation.report.page import write_report

__all__ = ["write_report"]
