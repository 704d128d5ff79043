"""The page on paper: a PDF of the same content, laid out by WeasyPrint, without a browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file

MISSING = "a PDF needs the libraries WeasyPrint and Matplotlib: pip install 'mbcacq[pdf]' (WeasyPrint also wants Pango: see docs/report.md)"


def write_pdf(draw: Callable[[], str], path: str | Path) -> Path:
    """Write a page as PDF on A4.

    Parameters
    ----------
    draw
        Returns its HTML for paper; called once the libraries are known to be there.
    path
        The file; its folder is made where it is missing.

    Raises
    ------
    ConfigError
        If WeasyPrint or Matplotlib is not installed, or finds no Pango.
    RecordingError
        If the file cannot be written.
    """
    try:
        import matplotlib  # noqa: F401  (draws the figures; asked for before anything is drawn)
        import weasyprint
        from weasyprint.urls import URLFetcher
    except (ImportError, OSError) as error:
        raise ConfigError(f"{MISSING} ({error})") from None
    inside = URLFetcher(allowed_protocols=["data"])  # pictures stand in the page itself; nothing else is ever fetched
    page = weasyprint.HTML(string=draw(), url_fetcher=inside).write_pdf()
    assert page is not None, "it is returned where no target is given"
    return write_file(path, page)
