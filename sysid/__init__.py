"""sysid: models of pendulums and joints with addable effects, and what identifies them from logs.

Conventions: theta = 0 upright, theta = pi hanging, positive torque raises theta; SI units.

    records = sysid.read("swing1.csv", "swing2.csv")
    estimate = sysid.fit(sysid.Model(sysid.PointMassPendulum(), dt=records.dt), records)
    diagnosis = sysid.diagnose(estimate, records)
    better = diagnosis.best.estimate
"""

# ruff: noqa: F401, PLE0604

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what type checkers and editors see
    from sysid.diagnosis.add import Added, add
    from sysid.diagnosis.answer import Diagnosis
    from sysid.diagnosis.compare import Comparison, compare
    from sysid.diagnosis.diagnose import diagnose
    from sysid.diagnosis.residual_torque import ResidualTorque, residual_torque
    from sysid.effects import (  # type: ignore[no-redef]
        CATALOGUE,
        AngleOffset,
        AsymmetricCoulomb,
        AsymmetricViscous,
        BackEmf,
        Backlash,
        Coulomb,
        DeadZone,
        Delay,
        Drag,
        Drift,
        DryFriction,
        Effect,
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
        VelocityBias,
        VelocityGain,
        Viscous,
        effect,
        register,
    )
    from sysid.errors import InvalidInput
    from sysid.estimate import Estimate
    from sysid.excitation import paper_rollouts
    from sysid.export import SavedModel, load, load_model, save
    from sysid.fit import fit
    from sysid.identify import GridSearch, Identifier, LeastSquares, UnscentedKalman
    from sysid.integrators import RK4, Integrator, SemiImplicitEuler
    from sysid.logs import Log, read
    from sysid.model import Model, State, paper_model
    from sysid.noise import sensor_noise
    from sysid.parameters import Extent, Parameter, parameter
    from sysid.plants import GeneralJoint, LinearAxis, Plant, PointMassPendulum, RodPendulum
    from sysid.records import Record, write_csv
    from sysid.sensitivity import fisher_information
    from sysid.sensor import Sensor
    from sysid.simulate import Trajectory, simulate
    from sysid.splitting import split
    from sysid.user_effects import load_effects

_HOME = {
    name: module
    for module, names in {
        "diagnosis.add": "Added add",
        "diagnosis.answer": "Diagnosis",
        "diagnosis.compare": "Comparison compare",
        "diagnosis.diagnose": "diagnose",
        "diagnosis.residual_torque": "ResidualTorque residual_torque",
        "effects": (
            "AngleOffset AsymmetricCoulomb AsymmetricViscous BackEmf Backlash CATALOGUE Coulomb DeadZone Delay "
            "Drag Drift DryFriction Effect InputEffect Joint JointEffect Lag LoadFriction OutputEffect Periodic "
            "Reading Ripple RotorInertia Saturation SensorDelay Spring Stamp Stribeck Tilt TorqueBias TorqueGain "
            "VelocityBias VelocityGain Viscous effect register"
        ),
        "errors": "InvalidInput",
        "estimate": "Estimate",
        "excitation": "paper_rollouts",
        "export": "SavedModel load load_model save",
        "fit": "fit",
        "identify": "GridSearch Identifier LeastSquares UnscentedKalman",
        "integrators": "Integrator RK4 SemiImplicitEuler",
        "logs": "Log read",
        "model": "Model State paper_model",
        "noise": "sensor_noise",
        "parameters": "Extent Parameter parameter",
        "plants": "GeneralJoint LinearAxis Plant PointMassPendulum RodPendulum",
        "records": "Record write_csv",
        "sensitivity": "fisher_information",
        "sensor": "Sensor",
        "simulate": "Trajectory simulate",
        "splitting": "split",
        "user_effects": "load_effects",
    }.items()
    for name in names.split()
}
"""Where each public name lives: it is loaded when it is first asked for, so that --help answers at once."""

__all__ = [*_HOME]


class _Package(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'sysid' has no attribute {name!r}")
        value = getattr(import_module(f"sysid.{_HOME[name]}"), name)
        setattr(self, name, value)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # importing sysid.fit or sysid.diagnose must not put the module in the place of the function
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *_HOME})


sys.modules[__name__].__class__ = _Package
