"""The pages that are read without building the site: their links lead somewhere, and README stays short."""

import re
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
TWO_SCREENS = 80  # lines
MADE = "_made"  # written when the site is built, which checks them


@pytest.mark.parametrize("page", [page for page in PAGES if MADE not in page.parts], ids=lambda page: page.stem)
def test_links_lead_to_files(page):
    found = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    links = [link for link in found if "://" not in link and MADE not in link]
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_readme_is_two_screens():
    assert len((PROJECT / "README.md").read_text(encoding="utf-8").splitlines()) <= TWO_SCREENS
