"""The command line: train, evaluate, export.

python -m policies train model.json -o policy         a controller for a model that sysid fitted
python -m policies evaluate policy --model other.json    what it is worth on another
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from policies.cli.options import COMMANDS
from sysid.cli.command_line import answer, called, entry_point


@entry_point
def main(arguments: Sequence[str]) -> int:
    """Run the command line; returns the exit code: 0 answered, 1 nobody reads on, 2 bad input, 130 stopped."""
    about = "A controller for a fitted model: trained on it, written to a file, judged on another model."
    return answer(COMMANDS, _run, called("python -m policies"), about, arguments)


def _run(command: Any) -> None:
    from policies.cli.commands import run

    run(command)


if __name__ == "__main__":
    sys.exit(main())
