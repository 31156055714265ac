"""What can be made of n rollouts: what an agent then trains on. Nobody is in the loop.

    Budget(records, sensor, seed).setup("mended") -> TrainingSetup

All fits but the grid's are by output error with the sensor's noise known, from the same records.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from policies.environments.randomization import Band, Mixture, Posterior, RandomForce, Randomization
from study.trials.ground_truth import PRIOR
from study.trials.learned_torque import fit_network
from study.trials.training_setup import TrainingSetup
from sysid import (
    Diagnosis,
    Estimate,
    GridSearch,
    InvalidInput,
    Model,
    Record,
    Sensor,
    UnscentedKalman,
    add,
    diagnose,
    effect,
    fit,
    residual_torque,
)
from sysid.estimation.held_out import held_out_error

AT_ONCE = (
    "viscous", "coulomb", "drag", "load_friction", "tilt", "spring", "torque_bias", "delay", "lag", "dead_zone",
    "saturation", "angle_offset", "velocity_bias", "velocity_gain", "sensor_delay", "backlash",
)  # fmt: skip
"""Every effect of the catalogue that can stand beside the others, does not depend on time or on a number that no slope
finds (a ripple's order), and is not absorbed by m and l: of those that contain each other the simpler one."""

BAND = 0.3
"""Half the relative width of the band about the fit."""


class Budget:
    """n rollouts (Records) and what can be made of them; what several strategies need is made once."""

    def __init__(self, records: Sequence[Record], sensor: Sensor, seed: int) -> None:
        self.records, self.sensor, self.seed = records, sensor, seed

    def setup(self, strategy: str) -> TrainingSetup:
        """What the strategy trains on."""
        made: dict[str, Callable[[], TrainingSetup]] = {
            "grid": lambda: _at(GridSearch(("m", "l")).fit(PRIOR, self.records)),
            "kalman": lambda: _at(UnscentedKalman(("m", "l"), self.sensor).fit(PRIOR, self.records)),
            "fitted": lambda: _at(self.fitted),
            "band": lambda: TrainingSetup(self.fitted.model, center(self.fitted, BAND)),
            "fitted_posterior": lambda: TrainingSetup(self.fitted.model, posterior_of(self.fitted)),
            "mended": self._mended,
            "all_effects": self._at_once,
            "posterior": self._posterior,
            "random_force": self._random_force,
            "network": self._network,
        }
        return made[strategy]()

    @cached_property
    def fitted(self) -> Estimate:
        return fit(PRIOR, self.records, self.sensor, ("m", "l"))

    @cached_property
    def diagnosis(self) -> Diagnosis:
        return diagnose(PRIOR, self.records, self.sensor)

    @property
    def believed(self) -> bool:
        """Whether what was named is taken into the model: not where nothing known pays, nor where the error on held-out
        rollouts did not fall."""
        diagnosis = self.diagnosis
        return diagnosis.verdict != "unknown" and (
            not diagnosis.steps or diagnosis.error.ratio < diagnosis.base_error.ratio
        )

    @cached_property
    def mended(self) -> Estimate:
        """Refitted on all rollouts with the effects that were named and believed."""
        diagnosis = self.diagnosis
        if not self.believed or not (diagnosis.steps or diagnosis.conventions):
            return self.fitted
        return fit(diagnosis.estimate.model, self.records, self.sensor, diagnosis.estimate.names)

    def _mended(self) -> TrainingSetup:
        diagnosis, model, drawn = self.diagnosis, self.mended.model.machine, center(self.mended)
        if not self.believed:
            drawn = self._with_random_force(drawn, self.mended.model)
        elif diagnosis.verdict == "cannot tell":
            model, drawn = self._class()
        return TrainingSetup(model, drawn, diagnosis.verdict, tuple(s.effect for s in diagnosis.steps), self.believed)

    def _posterior(self) -> TrainingSetup:
        named = self._mended()
        if isinstance(named.drawn, Mixture):
            return named
        posterior: Randomization = posterior_of(self.mended)
        if isinstance(named.drawn, RandomForce):
            posterior = RandomForce(posterior, named.drawn.s, named.drawn.T)
        return dataclasses.replace(named, drawn=posterior)

    def _class(self) -> tuple[Model, Randomization]:
        """Each effect of a class that does not separate, fitted in turn, in a model that holds them all."""
        step = next(s for s in self.diagnosis.steps if s.rivals)
        fits, together = [self.mended], self.mended.model
        for name in step.rivals:
            try:
                added = add(self.mended.model.without_effect(step.effect), name, self.records, self.sensor)
                together = together.with_effect(effect(name))
            except InvalidInput:  # one that this log cannot show, or that contains another of the class
                continue
            fits.append(fit(added.estimate.model, self.records, self.sensor, added.estimate.names))
        machine = together.machine
        neutral = {
            p.name: float(p.value if p.neutral is None else p.neutral)
            for p in machine.parameters.values()
            if "." in p.name
        }
        names = [name for name in machine.parameters if any(name in f.names for f in fits)]
        alternatives = [{name: f.values.get(name, neutral.get(name, math.nan)) for name in names} for f in fits]
        return machine, Mixture(tuple(alternatives))

    def _at_once(self) -> TrainingSetup:
        """From the fit without effects, first without and then with a limit of the drive, whichever is nearer: the fit
        has no slope from "never" to a limit, and a limit that it begins with hides the rest."""
        free = [effect(name) for name in AT_ONCE if name != "saturation"]
        first = fit(dataclasses.replace(self.fitted.model, effects=tuple(free)), self.records, self.sensor)
        second = fit(first.model.with_effect(effect("saturation")), self.records, self.sensor)
        errors = [held_out_error(estimate.model, self.records, self.sensor).ratio for estimate in (first, second)]
        nearer = (first, second)[int(np.argmin(errors))]
        numbers = {"saturation.limit": PRIOR.u_max, **center(nearer).center}  # a limit that no command reaches
        return TrainingSetup(second.model.with_parameters(numbers), Band(numbers))

    def _network(self) -> TrainingSetup:
        learned = fit_network(self.fitted.model, self.records, self.sensor, np.random.default_rng([self.seed, 1]))
        return TrainingSetup(learned, center(self.fitted))

    def _random_force(self) -> TrainingSetup:
        return TrainingSetup(self.fitted.model, self._with_random_force(center(self.fitted), self.fitted.model))

    def _with_random_force(self, drawn: Randomization, model: Model) -> Randomization:
        """Random torques of the size and memory that the log asks for beyond the model."""
        residual = residual_torque(model, self.records, self.sensor)
        return RandomForce(drawn, residual.s, residual.T) if residual.present else drawn


def _at(estimate: Estimate) -> TrainingSetup:
    return TrainingSetup(estimate.model, center(estimate))


def center(estimate: Estimate, w: float = 0.0) -> Band:
    """A band of relative width w about the estimate, of what belongs to the machine; w = 0: the numbers themselves."""
    machine = estimate.model.machine.parameters
    return Band({name: value for name, value in estimate.values.items() if name in machine}, w)


def posterior_of(estimate: Estimate) -> Posterior:
    """The estimate's normal distribution; what the records leave open stays at its number."""
    machine, sd = estimate.model.machine.parameters, estimate.sd
    return Posterior.of(estimate, [name for name in estimate.names if name in machine and math.isfinite(sd[name])])
