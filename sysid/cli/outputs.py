"""The files that commands write: each is whole or not there, and is named when it has been written."""

from __future__ import annotations

import json
import logging
import shlex
import sys
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

from sysid.data.files import save_file
from sysid.errors import InvalidInput
from sysid.estimation.estimate import Estimate

logger = logging.getLogger(__name__)


def write(path: Path | None, save: Callable[[Path], None]) -> None:
    """Write a file that was asked for, and say so."""
    if path is not None:
        save(path)
        logger.info(f"wrote {path}")


def write_json(path: Path | None, data: dict[str, Any]) -> None:
    """Write plain data."""
    write(path, lambda own: save_file(own, json.dumps(data, indent=1, allow_nan=False) + "\n"))


def write_model(path: Path | None, estimate: Estimate) -> None:
    """Write a model.json."""
    from sysid.estimation.saved_model import save

    write(path, partial(save, estimate))


def write_page(path: Path | None, answer: Any) -> None:
    """Write the page of an answer."""

    def save(own: Path) -> None:
        from sysid.report.write import write_report

        write_report(answer, own, shlex.join(["python", "-m", "sysid", *sys.argv[1:]]))

    write(path, save)


def draw_comparison(comparison: Any, path: Path) -> None:
    """Draw the figure of a comparison."""
    from sysid.report.comparison_figure import plot_comparison

    content = BytesIO()
    try:
        plot_comparison(comparison).savefig(content, format=path.suffix.removeprefix(".") or "png")
    except ValueError as error:
        raise InvalidInput(f"cannot write {path}: {error}") from None
    save_file(path, content.getvalue())
