"""The command line: train, evaluate, export.

python -m policies train model.json -o policy         a controller for a model that sysid fitted
python -m policies evaluate policy --model other.json    what it is worth on another
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import tyro

from policies.options import COMMANDS
from sysid.errors import InvalidInput


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 answered, 2 bad input, 130 stopped."""
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="python -m policies",
        description="A controller for a fitted model: trained on it, written to a file, judged on another model.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
    )
    # small matrices: threads would only wait for each other; before numpy's library starts them
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    from policies.commands import run

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


if __name__ == "__main__":
    sys.exit(main())
