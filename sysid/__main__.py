"""The command line: fit, compare, diagnose, add, experiment, effects.

python -m sysid diagnose swing*.csv               the whole loop
python -m sysid fit swing*.csv -o model.json      step by step, the other commands take --model model.json
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence

import tyro

from sysid.errors import InvalidInput
from sysid.options import COMMANDS


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 answered, 2 bad input, 130 stopped."""
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="sysid",
        description="What is the model of a pendulum missing? Torque and motion go in, the missing effect comes out.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
    )
    # thousands of small matrices: threads would only wait for each other; before numpy loads
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    from sysid.commands import run

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a fit may try numbers with which the motion runs away
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
