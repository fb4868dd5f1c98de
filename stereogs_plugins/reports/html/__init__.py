"""`html`: a run as one page, report.html: scores, pictures, how training went, and what was run."""

from .report import HtmlReport, stereogs_register_reports

__all__ = ["HtmlReport", "stereogs_register_reports"]
