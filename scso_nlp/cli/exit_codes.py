"""Exit codes of every command, and what is printed when something goes wrong."""

from __future__ import annotations

import logging
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from scso_nlp.exceptions import ScsoError

#: Some frame was not solved.
FRAME_FAILED = 1
#: Input that cannot be used; also the code of a misspelled option.
BAD_INPUT = 2
#: Not the user's fault.
BUG = 3
#: Stopped by the user, as shells have it.
INTERRUPTED = 130
#: Nobody reads the output any more, e.g. after ``| head``, as shells have it.
CLOSED_PIPE = 141


@contextmanager
def exit_codes(verbose: bool) -> Iterator[None]:
    """Turn exceptions into exit codes: one sentence for bad input, a traceback for a bug."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("scso: %(message)s"))
    logger = logging.getLogger("scso_nlp")
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    try:
        yield
    except ScsoError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(BAD_INPUT) from None
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        # what is still buffered would fail again when Python ends
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise typer.Exit(CLOSED_PIPE) from None
    except (typer.Exit, typer.Abort):
        raise
    except Exception:
        traceback.print_exc()
        typer.echo("error: this is a bug in scso, please report it with the lines above", err=True)
        raise typer.Exit(BUG) from None
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
