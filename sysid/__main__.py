"""The command line: fit, compare, diagnose, add, experiment, effects, and the workbench, a page for all of these.

python -m sysid diagnose swing*.csv               the whole loop
python -m sysid workbench swing*.csv              the same on a local page, by clicks
python -m sysid fit swing*.csv -o model.json      step by step, the other commands take --model model.json
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Any

from sysid.cli.command_line import answer, entry_point
from sysid.cli.command_options import COMMANDS, WorkbenchCommand
from sysid.data.files import check_installed


@entry_point
def main(arguments: Sequence[str]) -> int:
    """Run the command line; returns the exit code: 0 answered, 1 nobody reads on, 2 bad input, 130 stopped."""
    about = "What is the model of a joint missing? Torque and motion go in, the missing effect comes out."
    return answer(COMMANDS, _run, "sysid", about, arguments)


def _run(command: Any) -> None:
    if isinstance(command, WorkbenchCommand):
        for package in ("dash", "plotly"):
            check_installed(package, "web", "the workbench")
        from sysid.web.server import serve

        serve(command)
        return
    from sysid.cli.commands import run

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a fit may try numbers with which the motion runs away
        run(command)


if __name__ == "__main__":
    sys.exit(main())
