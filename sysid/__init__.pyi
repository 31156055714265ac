"""The public names of sysid, each with the module where it lives."""

from .data.logs import Log, read
from .data.noise import sensor_noise
from .data.record import Record, write_csv
from .data.sensor import Sensor
from .data.splitting import split
from .diagnosis.add import Added, add
from .diagnosis.answer import Diagnosis
from .diagnosis.compare import Comparison, compare
from .diagnosis.diagnose import diagnose
from .diagnosis.residual_torque import ResidualTorque, residual_torque
from .errors import InvalidInput
from .estimation.estimate import Estimate
from .estimation.fit import fit
from .estimation.identifiers import GridSearch, Identifier, LeastSquares, UnscentedKalman
from .estimation.identifiers.sensitivity import fisher_information
from .estimation.saved_model import SavedModel, load, load_model, save
from .physics import ops
from .physics.effects import (
    CATALOGUE,
    AngleOffset,
    AsymmetricCoulomb,
    AsymmetricViscous,
    BackEmf,
    Backlash,
    Coulomb,
    DeadZone,
    Delay,
    DirectionalLoadFriction,
    Drag,
    Drift,
    DryFriction,
    Eccentricity,
    Effect,
    FilteredSpeed,
    InputEffect,
    Joint,
    JointEffect,
    Lag,
    LoadFriction,
    OutputEffect,
    Periodic,
    Reading,
    Ripple,
    RotorInertia,
    Saturation,
    SensorDelay,
    Spring,
    Stamp,
    Stribeck,
    Tilt,
    TorqueBias,
    TorqueGain,
    TorqueSpeedLimit,
    VelocityBias,
    VelocityGain,
    Viscous,
    WarmingFriction,
    effect,
    register,
)
from .physics.integrators import RK4, Integrator, SemiImplicitEuler
from .physics.model import Model, State, paper_model
from .physics.parameters import Extent, Parameter, parameter
from .physics.plants import GeneralJoint, LinearAxis, Plant, PointMassPendulum, RodPendulum
from .physics.simulate import Trajectory, simulate
from .physics.user_effects import load_effects
from .planning.excitation import paper_rollouts
from .report.plotting import plot_comparison

__all__ = [
    "CATALOGUE",
    "RK4",
    "Added",
    "AngleOffset",
    "AsymmetricCoulomb",
    "AsymmetricViscous",
    "BackEmf",
    "Backlash",
    "Comparison",
    "Coulomb",
    "DeadZone",
    "Delay",
    "Diagnosis",
    "DirectionalLoadFriction",
    "Drag",
    "Drift",
    "DryFriction",
    "Eccentricity",
    "Effect",
    "Estimate",
    "Extent",
    "FilteredSpeed",
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
    "LinearAxis",
    "LoadFriction",
    "Log",
    "Model",
    "OutputEffect",
    "Parameter",
    "Periodic",
    "Plant",
    "PointMassPendulum",
    "Reading",
    "Record",
    "ResidualTorque",
    "Ripple",
    "RodPendulum",
    "RotorInertia",
    "Saturation",
    "SavedModel",
    "SemiImplicitEuler",
    "Sensor",
    "SensorDelay",
    "Spring",
    "Stamp",
    "State",
    "Stribeck",
    "Tilt",
    "TorqueBias",
    "TorqueGain",
    "TorqueSpeedLimit",
    "Trajectory",
    "UnscentedKalman",
    "VelocityBias",
    "VelocityGain",
    "Viscous",
    "WarmingFriction",
    "add",
    "compare",
    "diagnose",
    "effect",
    "fisher_information",
    "fit",
    "load",
    "load_effects",
    "load_model",
    "ops",
    "paper_model",
    "paper_rollouts",
    "parameter",
    "plot_comparison",
    "read",
    "register",
    "residual_torque",
    "save",
    "sensor_noise",
    "simulate",
    "split",
    "write_csv",
]
