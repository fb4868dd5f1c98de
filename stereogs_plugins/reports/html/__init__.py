"""`html`: a run as one page, report.html: the scene in 3D, scores, pictures and training curves."""

from .report import HtmlReport, stereogs_register_reports

__all__ = ["HtmlReport", "stereogs_register_reports"]
