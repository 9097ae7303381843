"""The command line: each command is one file."""

from fretflow.cli.app import app, execute, main

__all__ = ["app", "execute", "main"]
