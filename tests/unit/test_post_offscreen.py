"""A machine without OpenGL gets one clear line: the crash of VTK stays in the process that asked."""

import os
import signal

import pytest
from fretflow.core.errors import PlatformError
from fretflow_post import offscreen


@pytest.fixture(autouse=True)
def _fresh(monkeypatch):
    monkeypatch.setenv(offscreen.WINDOW_VARIABLE, "unset")
    offscreen._working_window.cache_clear()
    # as in a run: gmsh takes the key when it is imported, and it may be ignored in the background of a script
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
    offscreen._working_window.cache_clear()


@pytest.mark.parametrize("probe", [
    "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",  # what VTK does when it finds nothing
    "import os, signal; print('vtkEGLRenderWindow', flush=True); os.kill(os.getpid(), signal.SIGSEGV)",
    "raise ImportError('libGL.so.1')",
    "print('vtkXOpenGLRenderWindow')"])
def test_missing_opengl_names_the_packages(monkeypatch, probe):
    monkeypatch.setattr(offscreen, "_PROBE", probe)
    with pytest.raises(PlatformError, match=r"neither EGL nor OSMesa.*apt install libegl1") as caught:
        offscreen.require_offscreen()
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_the_window_that_drew_is_used_and_asked_for_once(monkeypatch):
    monkeypatch.setattr(offscreen, "_PROBE", "print('noise'); print('vtkOSOpenGLRenderWindow')")
    offscreen.require_offscreen()
    assert os.environ[offscreen.WINDOW_VARIABLE] == "vtkOSOpenGLRenderWindow"
    monkeypatch.setattr(offscreen, "_PROBE", "raise SystemExit(1)")
    offscreen.require_offscreen()


@pytest.mark.render
def test_this_machine_can_draw(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":99")  # a display that does not answer must not matter
    offscreen.require_offscreen()
    assert os.environ[offscreen.WINDOW_VARIABLE] in offscreen.WINDOWS


def test_an_interruption_waits_until_all_is_drawn():
    done = []

    @offscreen.uninterrupted()
    def draw():
        signal.raise_signal(signal.SIGINT)
        done.append("drawn")

    with pytest.raises(KeyboardInterrupt):
        draw()
    assert done == ["drawn"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
