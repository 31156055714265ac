"""Training: a controller for a model, by the command line of `policies` in a process of its own."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Mapping
from typing import Any

from sysid.errors import InvalidInput
from sysid.web.jobs import Processes
from sysid.web.session import Answer, Session

POLICY = "policy"
POINT = re.compile(r"^\s*([\d,]+)\s+(-?\d+)\s+#")
RETURN = re.compile(r"^  (\S.*?)\s{2,}(-?[\d.]+)\s+\[")
OPTIMUM, OWN = "optimum (dynamic programming)", "this policy"


def available() -> bool:
    """Whether `policies` is installed beside sysid; it is never imported here."""
    return importlib.util.find_spec("policies") is not None


class Trainings(Processes):
    """The trainings of all sessions, one each; of one that is ended, `policies` keeps what was learnt so far."""

    def begin(self, session: Session, node: int, u_max: float, steps: int | None = None) -> None:
        """Train on a model; raises InvalidInput where that cannot be."""
        if not 0.0 < u_max < 1e6:
            raise InvalidInput(f"the largest command is {u_max:g}: expected one above 0")
        folder = session.of(node)
        own = folder / Answer.OWN_EFFECTS
        effects = own if own.is_file() else self.effects
        command = ["policies", "train", str(folder / Answer.MODEL), "-o", str(folder / POLICY), "--force"]
        command += ["--u-max", f"{u_max!r}", *(["--steps", str(steps)] if steps else [])]
        command += ["--effects", str(effects)] if effects else []
        self.end(session)
        self.start(session, node, command, folder / Answer.TRAINING)


def heard(session: Session, node: int) -> Mapping[str, Any] | None:
    """What a training has said: points of its curve, returns of the policy and the optimum, its last line, its file."""
    path = session.of(node) / Answer.TRAINING
    if not path.is_file():
        return None
    lines = path.read_text(errors="replace").splitlines()
    points = [(int(m[1].replace(",", "")), float(m[2])) for m in map(POINT.match, lines) if m]
    returns = {m[1].strip(): float(m[2]) for m in map(RETURN.match, lines) if m}
    return {"points": points, "returns": returns, "last": lines[-1] if lines else "",
            "policy": str(session.of(node) / POLICY)}  # fmt: skip
