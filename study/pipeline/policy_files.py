"""The trained policies of a population in one file of plain arrays, so that later evaluations need no training.

    policies = read_policies(Path("results/paper/policies/population_1.npz"))
    evaluate(policies[Cell("main", 50, 0.0, 0)], model, *start_states(7))

A NumPy archive, loaded with allow_pickle=False: nothing in it is executed. w0 (A, in, out), b0 (A, out), w1, ...;
cells (A,): JSON of [point, n, w, seed], or of a text that names what was trained; u_max; history: past commands that
are observed.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid import InvalidInput
from sysid.data.files import write_whole

if TYPE_CHECKING:
    from policies.network_policy import NetworkPolicy

FOLDER = "policies"
"""Where they lie in a results folder."""


def write_policies(path: Path, cells: Sequence[tuple[Any, ...] | str], policies: Sequence[NetworkPolicy]) -> None:
    """Keep the policy of every cell; whole or not at all. Raises OSError."""
    arrays = {
        "cells": np.array([json.dumps(cell) for cell in cells]),
        "u_max": np.array([policy.u_max for policy in policies]),
        "history": np.array([policy.history for policy in policies]),
    }
    for i in range(len(policies[0].layers)):
        arrays[f"w{i}"] = np.stack([policy.layers[i][0] for policy in policies])
        arrays[f"b{i}"] = np.stack([policy.layers[i][1] for policy in policies])
    content = io.BytesIO()
    np.savez(content, **arrays)
    path.parent.mkdir(exist_ok=True)
    write_whole(path, content.getvalue())


def read_policies(path: Path) -> dict[tuple[Any, ...] | str, NetworkPolicy]:
    """The policies in such a file by cell, or by name; raises InvalidInput for another file."""
    from policies.network_policy import NetworkPolicy

    try:
        with np.load(path, allow_pickle=False) as stored:
            named = [json.loads(text) for text in stored["cells"].tolist()]
            cells = [name if isinstance(name, str) else tuple(name) for name in named]
            u_max = stored["u_max"].tolist()
            history = stored["history"].tolist() if "history" in stored.files else [0] * len(cells)
            layers = [(stored[f"w{i}"], stored[f"b{i}"]) for i in range(sum(name[0] == "w" for name in stored.files))]
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidInput(f"{path} is not a file of policies ({error}): expected one that a study wrote") from None
    return {
        cell: NetworkPolicy(tuple((w[a], b[a]) for w, b in layers), u_max[a], history[a])
        for a, cell in enumerate(cells)
    }
