"""The public names of sysid, each with the module where it lives."""

from .data.logs import Log, read
from .data.noise import sensor_noise
from .data.record import Record, write_csv
from .data.sensor import Sensor
from .data.splitting import split
from .data.user_effects import load_effects
from .diagnosis.add import Added, add
from .diagnosis.answer import Diagnosis
from .diagnosis.compare import Comparison, compare
from .diagnosis.diagnose import diagnose
from .diagnosis.residual_torque import ResidualTorque, residual_torque
from .errors import InvalidInput
from .estimation.estimate import Estimate
from .estimation.fisher_information import fisher_information
from .estimation.fit import fit
from .estimation.identifiers import GridSearch, Identifier, LeastSquares, UnscentedKalman
from .estimation.saved_model import SavedModel, load, load_model, save
from .export.exported import Exported
from .export.mjcf import to_mjcf
from .export.prediction_table import write_predictions
from .export.urdf import to_urdf
from .physics import ops
from .physics.effects.actuation import BackEmf, DeadZone, Delay, Lag, Saturation, Stamp, TorqueGain, TorqueSpeedLimit
from .physics.effects.actuators import DCMotor, PositionServo, TorqueConstant
from .physics.effects.catalogue import CATALOGUE, effect, register
from .physics.effects.disturbance import Drift, Periodic, TorqueBias
from .physics.effects.effect import (
    Actuator,
    DryFriction,
    DynamicEffect,
    Effect,
    InputEffect,
    Joint,
    JointEffect,
    OutputEffect,
    Reading,
)
from .physics.effects.friction import (
    AsymmetricCoulomb,
    AsymmetricViscous,
    Coulomb,
    Dahl,
    Drag,
    LuGre,
    Stribeck,
    Viscous,
    WarmingFriction,
)
from .physics.effects.load import (
    CubicSpring,
    DirectionalLoadFriction,
    FlexibleTransmission,
    LoadFriction,
    Ripple,
    RotorInertia,
    Spring,
    Tilt,
)
from .physics.effects.sensing import (
    AngleOffset,
    Backlash,
    Eccentricity,
    FilteredSpeed,
    SensorDelay,
    VelocityBias,
    VelocityGain,
)
from .physics.integrators import RK4, Integrator, SemiImplicitEuler
from .physics.model import Model, State
from .physics.parameters import Extent, Parameter, parameter
from .physics.plants import GeneralJoint, LinearAxis, Plant, PointMassPendulum, RodPendulum
from .physics.simulate import Trajectory, simulate
from .report.figures import plot_comparison

__all__ = [
    "CATALOGUE",
    "RK4",
    "Actuator",
    "Added",
    "AngleOffset",
    "AsymmetricCoulomb",
    "AsymmetricViscous",
    "BackEmf",
    "Backlash",
    "Comparison",
    "Coulomb",
    "CubicSpring",
    "DCMotor",
    "Dahl",
    "DeadZone",
    "Delay",
    "Diagnosis",
    "DirectionalLoadFriction",
    "Drag",
    "Drift",
    "DryFriction",
    "DynamicEffect",
    "Eccentricity",
    "Effect",
    "Estimate",
    "Exported",
    "Extent",
    "FilteredSpeed",
    "FlexibleTransmission",
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
    "LuGre",
    "Model",
    "OutputEffect",
    "Parameter",
    "Periodic",
    "Plant",
    "PointMassPendulum",
    "PositionServo",
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
    "TorqueConstant",
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
    "parameter",
    "plot_comparison",
    "read",
    "register",
    "residual_torque",
    "save",
    "sensor_noise",
    "simulate",
    "split",
    "to_mjcf",
    "to_urdf",
    "write_csv",
    "write_predictions",
]
