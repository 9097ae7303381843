"""The command line: each command is one file."""

import sys

try:
    from fretflow.cli.app import app, execute, main
except KeyboardInterrupt:  # while it is still being read, nothing that tells errors is there yet
    sys.stderr.write("fretflow: interrupted\n")
    sys.exit(130)

__all__ = ["app", "execute", "main"]
