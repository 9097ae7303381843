"""Where reduced specimens are kept from one diagnosis to the next."""

import os
from pathlib import Path

import pytest
from fretflow.case.config import validate_case
from fretflow.core.errors import StoreError
from fretflow.pipeline.diagnose import MODELS, kept_models, reduced_problem
from fretflow.pipeline.runner import Runner

CASE = {"format": "fretflow-case/1", "name": "short", "test": {
    "excitation_amplitude": "60 N", "cycles": 1000, "excitation_frequency": "100 Hz", "normal_load": "60 N"}}


def test_cache_of_the_user(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert kept_models(tmp_path / "home") == tmp_path / "cache" / "fretflow" / MODELS
    assert not (tmp_path / "home").exists()


@pytest.mark.parametrize("how", ["no folder", "read-only"])
def test_without_a_cache_they_stay_beside_the_results(tmp_path, monkeypatch, how):
    cache = tmp_path / "cache"
    if how == "no folder":
        cache.write_text("")
    else:
        monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    assert kept_models(tmp_path / "home") == tmp_path / "home" / MODELS
    assert (tmp_path / "home" / MODELS).is_dir()


def test_a_user_without_a_home_keeps_them_beside_the_results(tmp_path, monkeypatch):
    def nowhere():
        raise RuntimeError("no home")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", nowhere)
    assert kept_models(tmp_path / "home") == tmp_path / "home" / MODELS


def test_a_cache_that_is_full_is_named_with_the_way_out(tmp_path, monkeypatch):
    def full(*asked):
        raise StoreError("mesh: no space left; choose another --out")

    monkeypatch.setattr(Runner, "run", full)
    with pytest.raises(StoreError, match="XDG_CACHE_HOME") as caught:
        reduced_problem(validate_case(CASE), tmp_path)
    assert str(tmp_path) in str(caught.value)
    assert "--out" not in str(caught.value)
