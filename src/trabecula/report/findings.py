"""What all certificates have in common: they become a page."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from trabecula.report.page import Pictures, write_page


class Findings(ABC):
    """A certificate, as a page."""

    @abstractmethod
    def _page(self, pictures: Pictures) -> str:
        """Build the page."""

    def to_html(self, path: str | Path | None = None, *, pictures: Pictures = ()) -> str:
        """Build one self-contained page; write it to `path` where one is given.

        Parameters
        ----------
        path : str or Path, optional
        pictures : iterable of (caption, PNG file or its bytes), optional
            Shown side by side, and kept in the page.

        Returns
        -------
        html : str
        """
        html = self._page(pictures)
        if path is not None:
            write_page(html, path)
        return html
