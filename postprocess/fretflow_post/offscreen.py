"""Find an OpenGL that VTK can draw with when there is no display.

VTK crashes the process when it finds neither EGL nor OSMesa, so a throw-away process asks first.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import current_thread, main_thread

from fretflow.core.errors import PlatformError

WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
PACKAGES = "libegl1 libegl-mesa0"
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")

# VTK falls from EGL to OSMesa by itself; the class name says where it ended.
_PROBE = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetSize(8, 8)
window.Render()
print(window.GetClassName())
"""


def require_offscreen() -> None:
    """Make VTK draw off-screen in this process, through EGL or else OSMesa.

    Raises
    ------
    PlatformError
        If the machine has neither; the message names the packages.
    """
    os.environ[WINDOW_VARIABLE] = _working_window()


@cache
def _working_window() -> str:
    """Return the VTK window class that drew a picture in a process of its own."""
    environment = {**os.environ, WINDOW_VARIABLE: WINDOWS[0]}
    environment.pop("DISPLAY", None)
    try:
        probe = subprocess.run([sys.executable, "-P", "-c", _PROBE], env=environment, capture_output=True,
                               text=True, timeout=60, check=False)
    except subprocess.TimeoutExpired as error:
        raise PlatformError("pictures: OpenGL does not answer; "
                            f"reinstall it with: apt install --reinstall {PACKAGES}") from error
    window = probe.stdout.strip().rpartition("\n")[2]
    if probe.returncode != 0 or window not in WINDOWS:
        raise PlatformError("pictures: VTK finds neither EGL nor OSMesa to draw without a display; "
                            f"install one with: apt install {PACKAGES}")
    return window


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let interruptions wait: an exception where VTK calls Python back crashes it, or is a message of its own."""
    held: list[int] = []
    before = {} if current_thread() is not main_thread() else {
        number: signal.signal(number, lambda got, frame: held.append(got))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM) if signal.getsignal(number) is not None}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])
