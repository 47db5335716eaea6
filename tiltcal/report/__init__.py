"""The HTML report: one offline file with its plots inside."""

from tiltcal.report.html import write_report

__all__ = ["write_report"]
