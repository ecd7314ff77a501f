"""The command line, `halma`."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from services.errors import HalmaError, InterruptedByUser


def main() -> None:
    """The command `halma`: run it and exit. SIGTERM is the same as Ctrl-C, from the first moment to the last."""
    listening = True

    def on_signal(signum: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the shape of a handler
        if listening:
            raise KeyboardInterrupt

    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, on_signal)
        code = run_command(sys.argv[1:])
        listening = False  # all is said; who asks again is about to get what they want
    except KeyboardInterrupt:  # the second one, while the first was being answered
        listening = False
        code = InterruptedByUser.exit_code
    # Python takes its handlers down before the process is over; the flag is for who asks before this has happened.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


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
        return InterruptedByUser.exit_code
    except BrokenPipeError:
        # Whoever read our output has gone; Python would complain once more when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except HalmaError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0
