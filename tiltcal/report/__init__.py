"""The HTML reports: offline files that contain their plots."""

from tiltcal.report.html import write_report

__all__ = ["write_report"]
