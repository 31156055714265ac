"""Identifiers: from records to an Estimate, by one interface."""

from sysid.identify.grid import GridSearch
from sysid.identify.identifier import Identifier
from sysid.identify.least_squares import LeastSquares
from sysid.identify.unscented import UnscentedKalman

__all__ = ["GridSearch", "Identifier", "LeastSquares", "UnscentedKalman"]
