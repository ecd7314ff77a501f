"""The command line, `halma`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from services.errors import HalmaError


def main() -> None:
    """The command `halma`: run it and exit."""
    sys.exit(run_command(sys.argv[1:]))


def run_command(arguments: Sequence[str]) -> int:
    """Run one command.

    Args:
        arguments: what was typed after `halma`.

    Returns:
        The exit code: 0 done, 2 bad input, 1 anything else, 130 interrupted. Errors of ours are one message on
        standard error and no traceback; an error that is none of ours is a bug and shows its traceback.
    """
    from services.cli.app import app  # noqa: PLC0415 - so that an interrupt while importing is one, too

    try:
        app(args=list(arguments), prog_name="halma")
    except SystemExit as ending:
        return ending.code if isinstance(ending.code, int) else 1
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted.\n")
        return 130
    except BrokenPipeError:
        # Whoever read our output has gone; Python would complain once more when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except HalmaError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0
