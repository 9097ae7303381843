"""environment.yml and the Dockerfile ask for what pyproject.toml and the launcher ask for.

What carries the weight: both sides are read from the project's own files, so a bound that is raised in one place only,
a new dependency or a Debian that the launcher refuses fails here. No image is built and no environment is solved.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[2]


def normal(requirement: str) -> str:
    """Return a requirement in lower case without spaces and comment."""
    return re.sub(r"\s", "", requirement.partition("#")[0]).lower()


def test_environment_holds_every_dependency_within_the_same_bounds():
    lines = (PROJECT / "environment.yml").read_text(encoding="utf-8").splitlines()
    asked = {normal(line.strip()[2:]) for line in lines if line.strip().startswith("- ")}
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    needed = {normal(one) for one in (*project["project"]["dependencies"], *project["build-system"]["requires"])}
    assert needed - asked == set()


def test_the_image_is_a_debian_that_the_launcher_takes_and_starts_the_launcher():
    image = (PROJECT / "Dockerfile").read_text(encoding="utf-8")
    release, = re.findall(r"^FROM debian:(\d+)", image, re.MULTILINE)
    assert f"'debian {release}'" in (PROJECT / "fretflow").read_text(encoding="utf-8")
    place, = re.findall(r"^COPY \. (\S+)", image, re.MULTILINE)
    assert f'ENTRYPOINT ["{place}/fretflow"]' in image
    assert f"RUN {place}/fretflow" in image


def test_no_environment_of_the_host_gets_into_the_image():
    left_out = (PROJECT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {".venv", ".git", "runs"} <= set(left_out)
