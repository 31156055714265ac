"""How the report's pages are set: templates, figures within the page, intervals that do not break."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from study import formatting
from study.formatting import number, signed
from study.statistics import Contrast

if TYPE_CHECKING:
    import jinja2
    from markupsafe import Markup


def template(name: str, filters: Mapping[str, Callable[..., str]] | None = None) -> jinja2.Template:
    """A template of this package, whose values are escaped; more filters by name."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("study"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    own = {"number": number, "unbroken": unbroken, "signed": signed, "range": interval, "p": p_value}
    environment.filters |= {**own, **(filters or {})}
    return environment.get_template(name)


def embedded(file: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()


def unbroken(text: str) -> str:
    """The same with no line break inside an interval."""
    return re.sub(r"\S+ \[[^]]*\]", lambda found: found.group().replace(" ", "\u00a0"), text)


def interval(contrast: Contrast | None) -> Markup:
    """The interval of a contrast alone, bold where zero is outside; nothing without one."""
    from markupsafe import Markup, escape

    if contrast is None or not math.isfinite(contrast.low):
        return Markup("")
    text = formatting.interval(contrast.low, contrast.high, write=signed)
    return Markup("<b>{}</b>").format(text) if contrast.significant else Markup(escape(text))


def p_value(value: float) -> str:
    """To three digits; nothing for nan."""
    if math.isnan(value):
        return ""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"
