"""fretflow: vibration and fretting wear of structures held together by friction."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("fretflow")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"
