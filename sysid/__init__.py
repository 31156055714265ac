"""sysid: models of pendulums and joints with addable effects, and what identifies them from logs.

Conventions: theta = 0 upright, theta = pi hanging, positive torque raises theta; SI units.
"""

from sysid.effects import (
    CATALOGUE,
    Coulomb,
    Delay,
    Effect,
    InputEffect,
    Joint,
    JointEffect,
    Lag,
    QuadraticDrag,
    TorqueBias,
    Viscous,
    effect,
    register,
)
from sysid.errors import InvalidInput
from sysid.estimate import Estimate
from sysid.excitation import paper_rollouts
from sysid.identify import GridSearch, Identifier, LeastSquares, UnscentedKalman
from sysid.integrators import RK4, Integrator, SemiImplicitEuler
from sysid.model import Model, State, paper_model
from sysid.parameters import Parameter, parameter
from sysid.plants import GeneralJoint, Plant, PointMassPendulum, RodPendulum
from sysid.records import Record, read_csv, write_csv
from sysid.sensitivity import fisher_information
from sysid.sensor import Sensor
from sysid.simulate import Trajectory, simulate

__all__ = [
    "CATALOGUE",
    "RK4",
    "Coulomb",
    "Delay",
    "Effect",
    "Estimate",
    "GeneralJoint",
    "GridSearch",
    "Identifier",
    "InputEffect",
    "Integrator",
    "InvalidInput",
    "Joint",
    "JointEffect",
    "Lag",
    "LeastSquares",
    "Model",
    "Parameter",
    "Plant",
    "PointMassPendulum",
    "QuadraticDrag",
    "Record",
    "RodPendulum",
    "SemiImplicitEuler",
    "Sensor",
    "State",
    "TorqueBias",
    "Trajectory",
    "UnscentedKalman",
    "Viscous",
    "effect",
    "fisher_information",
    "paper_model",
    "paper_rollouts",
    "parameter",
    "read_csv",
    "register",
    "simulate",
    "write_csv",
]
