"""The answer of an export: a text in another program's language, and a sentence on each thing that it cannot say."""

from __future__ import annotations

import re
from collections.abc import Container
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sysid.data.files import read_file, save_file
from sysid.data.json_file import plain_fields
from sysid.diagnosis.findings import spaced_unit
from sysid.errors import InvalidInput, printable
from sysid.physics.effects.effect import Effect, OutputEffect
from sysid.physics.model import Model

PROLOG = re.compile(r"(?:\s|<\?.*?\?>|<!--.*?-->)*", re.DOTALL)
"""What may stand before a root."""


@dataclass(frozen=True)
class Exported:
    """A model in the language of another program.

    Attributes
    ----------
    format : str
        "MJCF" or "URDF".
    text : str
        The file.
    sentences : tuple of str
        What the file says in another way than the model, or not at all, a sentence each.
    """

    format: str
    text: str
    sentences: tuple[str, ...]

    def save(self, path: str | PathLike[str]) -> None:
        """Write the file. Raises InvalidInput where it cannot be written."""
        save_file(path, self.text)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return plain_fields(self, "format", "text", "sentences")

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def unsaid_effects(model: Model, said: Container[type[Effect]], language: str) -> tuple[str, ...]:
    """A sentence on each effect that does something and is none of those that a language says."""
    return tuple(_left_out(model, e, language) for e in model.effects if type(e) not in said and not e.idle)


def _left_out(model: Model, effect: Effect, language: str) -> str:
    parameters = (model.parameters[name] for name in model.names_of(effect.name))
    numbers = ", ".join(f"{p.field} = {float(p.value):.4g}{spaced_unit(p.unit)}" for p in parameters)
    if effect.of_log:
        reason = "it belongs to the log, not to the machine"
    elif isinstance(effect, OutputEffect):
        reason = "it is of the sensor, and a simulator's joint shows its true state"
    else:
        reason = f"{language} has no word for {effect.label}"
    return f"{effect.name} ({numbers}) is not in the file: {reason}."


def attribute_numbers(*values: float) -> str:
    """Numbers as an attribute holds them."""
    return " ".join(f"{value:.12g}" for value in values)


def text_of(root: ElementTree.Element) -> str:
    """A document of our own, indented."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def parsed_xml(path: Path) -> tuple[str, ElementTree.Element]:
    """A user's XML file: what stands before its root, and the root with its comments.

    Raises InvalidInput for a file that cannot be read, is no XML, or declares a document type: entities expand.
    """
    content = read_file(path, "an XML file")
    try:
        text = content.decode("utf-8-sig")
        if "<!DOCTYPE" in text:
            raise InvalidInput(f"{path.name} declares a document type (DOCTYPE): expected XML without one")
        builder = ElementTree.TreeBuilder(insert_comments=True)
        root = ElementTree.fromstring(text, ElementTree.XMLParser(target=builder))
    except InvalidInput:
        raise
    except (ElementTree.ParseError, ValueError) as error:
        raise InvalidInput(f"{path.name} is not XML in UTF-8: {printable(str(error), 100)}") from None
    before = PROLOG.match(text)
    return before[0] if before else "", root
