"""Pages with their figures within, whose intervals do not break."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from study.formatting import capital, number, signed
from study.pipeline.progress import duration

if TYPE_CHECKING:
    import jinja2


def template(name: str) -> jinja2.Template:
    """A template of this package, whose values are escaped."""
    import jinja2

    loader = jinja2.PackageLoader("study")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    filters: tuple[Callable[..., str], ...] = (number, signed, capital, duration, unbroken, embedded, p_value)
    environment.filters |= {own.__name__: own for own in filters}
    environment.tests["finite"] = math.isfinite
    return environment.get_template(name)


def embedded(file: Path) -> str:
    """A PNG file as a data URL, so that a page needs no other file."""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()


def unbroken(text: object) -> str:
    """The same with no line break inside an interval."""
    return re.sub(r"\S+ \[[^]]*\]", lambda found: found.group().replace(" ", "\u00a0"), str(text))


def p_value(value: float) -> str:
    """To three digits; nothing for nan."""
    if math.isnan(value):
        return ""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"
