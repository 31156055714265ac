"""Search settings: what an effect has to show before it is added, as numbers with their reasons."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.errors import InvalidInput
from sysid.estimation.prediction import BLOCKS, WINDOW

SHORTEST_HORIZON, LONGEST_HORIZON = 0.02, 600.0
"""Seconds ahead for which predictions can be asked."""


@dataclass(frozen=True)
class SearchSettings:
    """What counts as evidence, and what counts as large enough to matter.

    price          decrease of the deviance (-2 log likelihood) that each number of an effect has to pay for: beyond 3
                   it is nothing that noise does in more than 1 of 12 logs
    tolerance      share by which an effect has to lower the error of predictions, to matter
    noise_share    change of predictions, in units of the sensor noise, below which nothing matters
    horizon        how far ahead predictions have to be right [s], where it can be foreseen (`foreseeable`); None: so
                   far that they tell of the machine (`telling_horizon`)
    steps          additions, at most
    trials         single effects that a round fits for their promise at first, at most; as many again where none pays
    share          share of the largest promise that another has to promise to be tried at first
    nearly         share of the merit of the best trial from which another is chosen for its better predictions
    quiet          share of the disturbances that a model is simulated beside, where no effect pays otherwise
    simulated      candidates that are fitted then, at most
    sure           squared size of each number of an effect, in units of its variance, from which it is no accident: two
                   standard deviations
    clear          the same from which nobody asks whether the effect could be left out: ten standard deviations
    same           alikeness from which two effects are one to this log
    alike          alikeness from which it takes 100 times the evidence to tell two effects that it takes to find one
    twin           difference of the deviance below which effects that much alike are one to this log, too: far from
                   the fit their sensitivities differ a little, and what they explain does not
    close          difference of the deviance below which two effects explain a log equally well, where they are also
    rival          that much alike
    enough         excess of the error of predictions over the noise, as a multiple of the noise, from which
                   something that matters is still missing
    worse          the error of held-out data over that of what was fitted to, from which something is missing that
                   shows only where nothing was fitted; right models stay below 1.15
    most           share of the missing torque that a function of one quantity has to explain, where what remains
                   depends on that quantity still: it may be a part of anything
    recurrences    how often a ripple or a periodic torque has to come back within a record
    blocks         stretches of the log that are left out in turn when a candidate is validated
    samples        samples of a log that are searched, at most, spread over it: more would make intervals narrower, and
                   take minutes
    always         effects that are fitted in every round of a log with a random torque, which may hide them
    composites     effects that come together and of which none may pay alone; what does not pay beside the others is
                   dropped again

    Raises InvalidInput for a tolerance or a horizon out of range.
    """

    price: float = 3.0
    tolerance: float = 0.02
    noise_share: float = 0.07
    horizon: float | None = None
    steps: int = 6
    trials: int = 5
    share: float = 0.2
    nearly: float = 0.5
    quiet: float = 1e-3
    simulated: int = 3
    sure: float = 4.0
    clear: float = 100.0
    same: float = 1.0 - 1e-5
    alike: float = 0.995
    twin: float = 0.1
    close: float = 3.0
    rival: float = 0.8
    enough: float = 0.3
    worse: float = 1.25
    most: float = 2.0 / 3.0
    recurrences: float = 2.0
    blocks: int = BLOCKS
    samples: int = 6000
    always: tuple[str, ...] = ("coulomb", "viscous", "tilt", "delay")
    composites: tuple[tuple[str, ...], ...] = (
        ("viscous", "coulomb"),
        ("coulomb", "tilt"),
        ("viscous", "tilt"),
        ("coulomb", "delay"),
        ("viscous", "coulomb", "tilt"),
        ("viscous", "coulomb", "torque_bias"),
        ("viscous", "coulomb", "drag"),
        ("coulomb", "drag"),
        ("lag", "dead_zone"),
        ("saturation", "spring"),
        ("spring", "torque_bias"),
        ("coulomb", "spring", "torque_bias"),
        ("torque_speed_limit", "coulomb", "delay"),
        ("coulomb", "flexible_transmission"),
    )

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance < 1.0:
            raise InvalidInput(f"tolerance = {self.tolerance:g}: expected a share below 1, such as 0.02")
        if self.horizon is not None and not SHORTEST_HORIZON <= self.horizon <= LONGEST_HORIZON:
            choices = f"expected {SHORTEST_HORIZON:g} to {LONGEST_HORIZON:g} s"
            raise InvalidInput(f"horizon = {self.horizon:g}: {choices}")

    @property
    def ahead(self) -> float:
        """The horizon [s], where none is asked for a second."""
        return WINDOW if self.horizon is None else self.horizon


DEFAULT = SearchSettings()
