"""Training: a controller for a model, by the command line of `policies` in a process of its own."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sysid.errors import InvalidInput
from sysid.web.jobs import environment, kill
from sysid.web.session import MODEL, Session

SAID, POLICY = "training.txt", "policy"
POINT = re.compile(r"^\s*([\d,]+)\s+(-?\d+)\s+#")
RETURN = re.compile(r"^  (\S.*?)\s{2,}(-?[\d.]+)\s+\[")
OPTIMUM, OWN = "optimum (dynamic programming)", "this policy"


def available() -> bool:
    """Whether `policies` is installed beside sysid; it is never imported here."""
    return importlib.util.find_spec("policies") is not None


class Trainings:
    """The trainings of all sessions, one each. `effects` is the file with the user's own of the command line."""

    def __init__(self, effects: Path | None = None) -> None:
        self._effects, self._running, self._lock = effects, dict[str, subprocess.Popen[bytes]](), threading.RLock()

    def begin(self, session: Session, node: int, u_max: float, steps: int | None = None) -> None:
        """Train on a model; raises InvalidInput where that cannot be."""
        state, folder = session.state, session.of(node)
        if own := [o["name"] for o in state.own if o["name"] in state.added(node)]:
            raise InvalidInput(f"{own[0]} is a formula of this page: give training the model and its class by hand")
        if not 0.0 < u_max < 1e6:
            raise InvalidInput(f"the largest torque is {u_max:g} N m: expected one above 0")
        command = [sys.executable, "-u", "-m", "policies", "train", str(folder / MODEL), "-o", str(folder / POLICY)]
        command += ["--u-max", f"{u_max!r}", "--force", *(["--steps", str(steps)] if steps else [])]
        command += ["--effects", str(self._effects)] if self._effects else []
        with self._lock, (folder / SAID).open("wb") as said:
            self.cancel(session)
            self._running[session.identifier] = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=said, stderr=said, start_new_session=True, env=environment()
            )

    def running(self, session: Session) -> bool:
        """Whether one is under way."""
        with self._lock:
            process = self._running.get(session.identifier)
            return process is not None and process.poll() is None

    def cancel(self, session: Session) -> None:
        """End it; what was learnt so far is kept where `policies` keeps it."""
        with self._lock:
            process = self._running.pop(session.identifier, None)
            if process is not None:
                kill(process)

    def end(self) -> None:
        """End all."""
        with self._lock:
            for process in self._running.values():
                kill(process)
            self._running.clear()


def heard(session: Session, node: int) -> Mapping[str, Any] | None:
    """What a training has said: points of its curve, returns of the policy and the optimum, its last line, its file."""
    path = session.of(node) / SAID
    if not path.is_file():
        return None
    lines = path.read_text(errors="replace").splitlines()
    points = [(int(m[1].replace(",", "")), float(m[2])) for m in map(POINT.match, lines) if m]
    returns = {m[1].strip(): float(m[2]) for m in map(RETURN.match, lines) if m}
    return {"points": points, "returns": returns, "last": lines[-1] if lines else "",
            "policy": str(session.of(node) / POLICY)}  # fmt: skip
