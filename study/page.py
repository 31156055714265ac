"""How the report's pages are set: templates, figures within the page, intervals that do not break."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from study.answer import number

if TYPE_CHECKING:
    import jinja2


def template(name: str, filters: Mapping[str, Callable[..., str]] | None = None) -> jinja2.Template:
    """A template of this package, whose values are escaped; more filters by name."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("study"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"number": number, "unbroken": unbroken, **(filters or {})}
    return environment.get_template(name)


def embedded(file: Path) -> str:
    """A PNG file as a data URI."""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()


def unbroken(text: str) -> str:
    """The same with no line break inside an interval."""
    return re.sub(r"\S+ \[[^]]*\]", lambda found: found.group().replace(" ", "\u00a0"), text)
