"""What the paper claims beside its table, answered without training anything.

    python examples/paper_claims.py                  200 measurements a kind, about 10 s
    python examples/paper_claims.py --figure claims.png

How the identification error falls, whether noise biases the fit, where a floor is: from the paper's own grid search
on many seeds. Which contrasts stay significant: from the published means and errors.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from study.figure_style import save_figure
from study.paper import claims
from study.paper.agreement import Agreement
from study.paper.finished_runs import Outcomes
from study.paper.identification_scatter import scatter
from study.paper.paper_figures import identification
from sysid.errors import InvalidInput
from sysid.limits import check_size

MOST_SEEDS = 100_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every claim with its answer; exit code 2 for input that cannot be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200, help="measurements of a kind (default: %(default)s)")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the figure into this PNG file")
    options = parser.parse_args(arguments)
    if options.seeds < 2:
        parser.error(f"--seeds {options.seeds}: expected at least 2, one says nothing of scatter")
    try:
        check_size("--seeds", options.seeds, MOST_SEEDS)
    except InvalidInput as error:
        parser.error(str(error))
    begin = time.perf_counter()
    measurements = scatter(np.random.default_rng(0), options.seeds)
    answers = (
        claims.rate(measurements),
        claims.bias(measurements),
        claims.error_floor(measurements),
        claims.plateau(),
        claims.monotone(),
    )
    for claim in (*answers, claims.starts()):
        print(f'"{claim.quote}" ({claim.place}): {claim.verdict}.\n{claim.answer}\n')
    print(f"Which published claims of significance stand?\n{Agreement(Outcomes({})).significance()}\n")
    print(f"{time.perf_counter() - begin:.0f} s")
    if options.figure:
        try:
            save_figure(lambda: identification(measurements), options.figure)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            parser.error(f"--figure {options.figure}: cannot write ({reason})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
