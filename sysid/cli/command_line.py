"""How a command line of this distribution runs: one of its commands, errors as one sentence, exit codes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import tyro

from sysid.errors import InvalidInput
from sysid.version import version


def answer(
    commands: Mapping[str, Callable[..., Any]],
    run: Callable[[Any], None],
    prog: str,
    about: str,
    arguments: Sequence[str] | None = None,
) -> int:
    """Read one of the commands and run it; returns the exit code: 0 answered, 2 bad input, 130 stopped.

    run loads what is heavy, when it is called: numpy's library has its threads set by then.
    """
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given == ["--version"]:
        print(version())
        return 0
    command = tyro.extras.subcommand_cli_from_dict(
        dict(commands),
        prog=prog,
        description=about,
        args=given,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
    )
    # small matrices: threads would only wait for each other
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    try:
        run(command)
        sys.stdout.flush()
    except InvalidInput as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read the answer has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0
