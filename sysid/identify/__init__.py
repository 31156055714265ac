"""Identifiers: from records to an Estimate, by one interface."""

from sysid.identify.grid import GridSearch
from sysid.identify.identifier import Identifier

__all__ = ["GridSearch", "Identifier"]
