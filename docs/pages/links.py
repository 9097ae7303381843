"""The site needs no network, and its links lead somewhere."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.util import logging

LOG = logging.getLogger(__name__)


class Links(HTMLParser):
    """Gathers what a page refers to, and whether a browser loads it."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[tuple[str, bool]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep the tag's references."""
        self.references += [(value, tag != "a") for name, value in attrs if name in ("href", "src") and value]


def check_links(app: Sphinx, error: Exception | None) -> None:
    """Warn of links to files that are not in the site, and of anything that a page would load from a network."""
    site = Path(app.outdir)
    for page in sorted(site.rglob("*.html")) if error is None and app.builder.format == "html" else ():
        links = Links()
        links.feed(page.read_text(encoding="utf-8"))
        for link, loaded in links.references:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if loaded and parts.scheme not in ("data", ""):
                    LOG.warning("%s loads %s; the site has to work without a network", page.relative_to(site), link)
            elif parts.path and not (page.parent / unquote(parts.path)).exists():
                LOG.warning("%s: there is no %s", page.relative_to(site), link)
