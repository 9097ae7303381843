"""The command line of fretflow: each command is a file of this room, and stands here once.

Imports stay inside the commands, so that help and `show` start without numerical libraries; the list of commands
is plain text, which needs no reader of Markdown.
"""

from __future__ import annotations

import os
import sys

from cyclopts import App

from fretflow import __version__
from fretflow.cli import calibrate, case, diagnose, effects, loops, modes, response, run, trial, verify
from fretflow.cli.terminal import Interruption, Terminal, describe, say
from fretflow.pipeline.ranks import close_process

QUIET = "--quiet"

app = App(name="fretflow", version=__version__, help_format="plaintext", result_action="return_value",
          exit_on_error=False, print_error=False, suppress_keyboard_interrupt=False,
          help="Vibration and fretting wear of structures held together by friction. "
               "`fretflow --install-completion` completes names in your shell (bash, zsh, fish).",
          help_epilogue="With --quiet a command says errors alone.")
app.register_install_completion_command()
for command in (run.run, modes.modes, calibrate.calibrate, run.render, verify.verify, effects.effects, loops.loops,
                diagnose.diagnose, response.response, trial.trial, run.export, case.init, case.show):
    app.command(command, help_format="markdown")


def main() -> None:
    """Run the command line and exit: 0 done, 2 bad input, 3 no convergence, 130 interrupted, 1 unexpected."""
    Interruption.watch()
    close_process()
    _limit_threads()
    sys.exit(execute(sys.argv[1:]))


def execute(arguments: list[str]) -> int:
    """Run the command line with `arguments` and return the exit code; errors become one line on stderr."""
    Terminal.silent = QUIET in arguments
    told = [argument for argument in arguments if argument != QUIET]
    Interruption.ends = told[0] if told else ""
    try:
        app(told)
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - the user gets one line
        Interruption.settle()
        return say(*describe(error))
    return 0


def _limit_threads() -> None:
    """Give libraries one thread, as the import of `fretflow` gave OpenBLAS, unless the user has chosen."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
