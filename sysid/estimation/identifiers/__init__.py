"""Identifiers: estimators behind one interface, from records to an Estimate."""

from sysid.estimation.identifiers.grid import GridSearch
from sysid.estimation.identifiers.identifier import Identifier
from sysid.estimation.identifiers.least_squares import LeastSquares
from sysid.estimation.identifiers.unscented import UnscentedKalman
