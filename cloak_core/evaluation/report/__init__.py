"""The report: one HTML file that opens offline."""

from pathlib import Path


def make_report(run: Path) -> Path:
    """Write RUN/report.html and return its path; see `page.make_report`, which this loads when it is needed."""
    from cloak_core.evaluation.report import page

    return page.make_report(run)
