"""What a policy is worth on a model: its mean return over the paper's start states.

    answer = evaluate(policy, model, *start_states(seed=0))
    print(answer)        # return -330.7 +- 35.0 (20 episodes)

A policy is any callable `u = policy(state, t)`: it receives the state of all episodes at once (theta (E,) unwrapped
[rad], theta_dot (E,) [rad/s], float64; as the model's sensors show it) and the time t [s] since the start, and answers
with the command u (E,) [N m] or one number for all. A network makes its float32 observation of that state, a
time-dependent policy reads its table at round(t / dt), LQR wraps theta. A policy with an attribute `history` = k > 0
is called with the last k commands too, `policy(state, t, past_commands)`: (E, k) [N m], the latest first, 0 at the
start.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from policies.environments import task
from policies.environments.random_streams import Purpose, generator
from sysid import InvalidInput, Model, State
from sysid.physics.ops import Array

EVALUATION_SEED = 50_000
"""Episode e of seed s starts from a generator seeded s + 50,000 + e (the paper's)."""


class Policy(Protocol):
    """A policy: any callable `u = policy(state, t)` that answers states with commands.

        u = policy(state, t)        with an attribute history = k > 0:  u = policy(state, t, past_commands)

    Parameters
    ----------
    state : State
        The state of E episodes at once, as the model's sensors show it: theta (E,) unwrapped [rad], theta_dot (E,)
        [rad/s], float64.
    t : float
        The time since the start [s].

    Returns
    -------
    array (E,) or float
        The command u [N m], of each episode or one for all. It may exceed the limits; it is clipped.

    Notes
    -----
    A policy with an attribute `history` = k > 0 is called with the last k commands too: past_commands (E, k) [N m],
    the latest first, 0 at the start.
    """

    def __call__(self, state: State, t: float) -> Array | float: ...


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What the episodes of one policy on one model returned.

    Attributes
    ----------
    returns : array (E,)
        The return of each episode.
    """

    returns: Array

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(np.mean(self.returns))

    @property
    def std(self) -> float:
        """Standard deviation over the episodes (divided by E, as the paper's tables are)."""
        return float(np.std(self.returns))

    @property
    def sem(self) -> float:
        """Standard error of the mean: sample standard deviation / sqrt(E); nan for one episode."""
        episodes = len(self.returns)
        return float(np.std(self.returns, ddof=1)) / math.sqrt(episodes) if episodes > 1 else math.nan

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Student's t interval of the mean over start states.

        Parameters
        ----------
        level : float, optional
            The share of such intervals that hold the mean.

        Returns
        -------
        tuple of two floats
            The lower and the upper end.
        """
        from scipy.special import stdtrit

        half = float(stdtrit(len(self.returns) - 1, 0.5 + 0.5 * level)) * self.sem
        return self.mean - half, self.mean + half

    def __str__(self) -> str:
        return f"return {self.mean:.1f} +- {self.sem:.1f} ({len(self.returns)} episodes)"


def start_states(seed: int, episodes: int = 20) -> tuple[Array, Array]:
    """Draw the paper's start states of a seed.

    Parameters
    ----------
    seed : int
        The seed s.
    episodes : int, optional
        The number E of start states.

    Returns
    -------
    theta, theta_dot : array (E,)
        The start states [rad], [rad/s]: episode e has those that
        `gymnasium.make("Pendulum-v1").reset(seed=seed + 50_000 + e)` draws.
    """
    return _drawn([np.random.Generator(np.random.PCG64(seed + EVALUATION_SEED + e)) for e in range(episodes)])


def fresh_start_states(seed: int, episodes: int = 20, block: int = 0) -> tuple[Array, Array]:
    """Draw start states that no other seed or block shares.

    Parameters
    ----------
    seed : int
        The seed.
    episodes : int, optional
        The number E of start states.
    block : int, optional
        Which of the blocks of this seed is drawn.

    Returns
    -------
    theta, theta_dot : array (E,)
        The start states [rad], [rad/s].

    Notes
    -----
    The paper's episode e of seed s starts where episode e - 1 of seed s + 1 does: neighbouring seeds share 19 of 20.
    These come from a generator of the seed's own, in the same distribution.
    """
    return _drawn([generator(seed, Purpose.EVALUATION, block)] * episodes)


def _drawn(rngs: Sequence[np.random.Generator]) -> tuple[Array, Array]:
    theta, theta_dot = task.draw_start_states(rngs)
    return theta.copy(), theta_dot.copy()


def evaluate(policy: Policy, model: Model, theta: Array, theta_dot: Array, horizon: int | None = None) -> Evaluation:
    """Run a policy on a model from every start state at once, in float64; the command is clipped to +-u_max.

    Parameters
    ----------
    policy : Policy
        What answers the states with commands.
    model : Model
        What the policy runs on.
    theta, theta_dot : array (E,)
        The start states [rad], [rad/s].
    horizon : int, optional
        The steps in an episode; by default those of 10 s.

    Returns
    -------
    Evaluation
        What each episode returned.

    Raises
    ------
    InvalidInput
        If the start states are not two finite vectors of one length, or if the policy answers with a wrong shape or a
        number that is not finite.
    """
    theta, theta_dot = _start(theta, theta_dot)
    returns = np.zeros(theta.shape)
    for state, u in _steps(policy, model, theta, theta_dot, horizon):
        returns += task.reward(state, u, model.dt)
    return Evaluation(returns)


@dataclass(frozen=True, eq=False)
class Episodes:
    """What E episodes did: at N instants the machine's own state theta (N, E) [rad], unwrapped, and theta_dot (N, E)
    [rad/s], and the command u (N, E) [N m] that was held from there on; and what they returned (E,)."""

    theta: Array
    theta_dot: Array
    u: Array
    returns: Array


def rollout(policy: Policy, model: Model, theta: Array, theta_dot: Array, horizon: int | None = None) -> Episodes:
    """The episodes that `evaluate` sums the rewards of. Raises InvalidInput as it does."""
    seen = list(_steps(policy, model, *_start(theta, theta_dot), horizon))
    states, u = np.array([(state.theta, state.theta_dot) for state, _ in seen]), np.array([u for _, u in seen])
    rewards = task.reward(State(states[:, 0], states[:, 1]), u, model.dt)
    return Episodes(states[:, 0], states[:, 1], u, np.sum(rewards, axis=0))


def _start(theta: Array, theta_dot: Array) -> tuple[Array, Array]:
    theta, theta_dot = np.asarray(theta, dtype=np.float64), np.asarray(theta_dot, dtype=np.float64)
    if theta.ndim != 1 or theta.shape != theta_dot.shape or theta.size == 0:
        raise InvalidInput(
            f"start states have shapes {theta.shape} and {theta_dot.shape}; expected two vectors of one length (E,)"
        )
    if not (np.isfinite(theta).all() and np.isfinite(theta_dot).all()):
        raise InvalidInput("start states contain NaN or infinity; expected finite angles [rad] and speeds [rad/s]")
    return theta, theta_dot


def _steps(
    policy: Policy, model: Model, theta: Array, theta_dot: Array, horizon: int | None
) -> Iterator[tuple[State, Array]]:
    """The state before every step and the command (E,) that follows it."""
    state, sensing = model.initial_state(theta, theta_dot), model.sensing(theta, theta_dot)
    history = getattr(policy, "history", 0)
    past_commands = np.zeros((len(theta), history))
    for k in range(task.horizon(model.dt) if horizon is None else horizon):
        t = k * model.dt
        reading, sensing = model.read(state.theta, state.theta_dot, sensing, t)
        seen = State(*reading, state.memory)
        answer = policy(seen, t, past_commands) if history else policy(seen, t)
        u = _command(answer, theta.shape, model.u_max, t)
        yield state, u
        state = model.advance(state, u, t)
        past_commands = np.column_stack((u, past_commands))[:, :history]


def _command(answer: Array | float, shape: tuple[int, ...], u_max: float, t: float) -> Array:
    u = np.asarray(answer, dtype=np.float64)
    if u.shape not in ((), shape):
        raise InvalidInput(f"the policy answered with shape {u.shape} at t = {t:g} s; expected {shape} or one number")
    if not np.isfinite(u).all():
        raise InvalidInput(f"the policy answered with a torque that is not finite at t = {t:g} s")
    return np.clip(np.broadcast_to(u, shape), -u_max, u_max)


@dataclass(frozen=True, eq=False)
class PolicyBatch:
    """Policies side by side, each on its own share of the episodes: a fine simulation costs nearly the same for one
    policy as for all of them."""

    policies: tuple[Policy, ...]

    @property
    def history(self) -> int:
        """As many past commands as any of them asks for."""
        return max(getattr(policy, "history", 0) for policy in self.policies)

    def __call__(self, state: State, t: float, past_commands: Array | None = None) -> Array:
        shares = np.split(np.arange(len(state.theta)), len(self.policies))
        commands = []
        for policy, share in zip(self.policies, shares, strict=True):
            seen, known = State(state.theta[share], state.theta_dot[share]), getattr(policy, "history", 0)
            history = (past_commands[share, :known],) if known and past_commands is not None else ()
            commands.append(policy(seen, t, *history))
        return np.concatenate(commands)


def batch_returns(policies: Sequence[Policy], model: Model, theta: Array, theta_dot: Array) -> Array:
    """Returns (P, E) of policies from start states (E,), the same for all, or (P, E), of each its own.

    Raises InvalidInput as `evaluate` does.
    """
    shape = (len(policies), np.shape(theta)[-1])
    starts = (np.broadcast_to(values, shape).ravel() for values in (theta, theta_dot))
    return evaluate(PolicyBatch(tuple(policies)), model, *starts).returns.reshape(shape)
