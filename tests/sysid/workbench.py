"""What the tests of the workbench share."""

from __future__ import annotations

import base64
import time
from pathlib import Path

from sysid.web.bench import Workbench
from sysid.web.session import Session


def waited(bench: Workbench, session: Session, seconds: float = 240.0) -> str:
    """Wait for the work and the training under way; returns what went wrong."""
    end = time.monotonic() + seconds
    while bench.busy(session) and time.monotonic() < end:
        time.sleep(0.1)
    return bench.jobs.message(session)


def uploaded(bench: Workbench, *files: Path) -> Session:
    """A session of files that were dropped."""
    contents = [f"data:text/csv;base64,{base64.b64encode(f.read_bytes()).decode()}" for f in files]
    return bench.upload([f.name for f in files], contents)
