"""What the command line of sysid understands: one dataclass a command, made of groups that several share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg


def option(metavar: str | None = None, default: str = "", name: str | None = None) -> Any:
    """How help shows an option: what stands for its value, what is taken where it is left out, and its name."""
    return arg(metavar=metavar, help_behavior_hint=default and f"(default: {default})", name=name)


Files = Annotated[Positional[tuple[Path, ...]], option("LOG")]
File = Annotated[Path | None, option("FILE")]
Output = Annotated[File, arg(aliases=["-o"])]
Number = Annotated[float | None, option("S")]
Switch = FlagCreatePairsOff[Annotated[bool, option()]]
AS_LOG = "the log's"


@dataclass(frozen=True)
class LogOptions:
    """How the log is read."""

    files: Files = ()
    """CSV, JSON, .npz, .mat, .xlsx or Parquet with columns t [s], theta [rad] and/or theta_dot [rad/s], torque [N m]
    (none: a free swing), rollout (where a file has several); of a linear axis [m], [m/s], [N]; ROS 2 bags and MCAP.
    Several files are several rollouts."""

    columns: Annotated[str, option("t=NAME,...")] = ""
    """The file's own names of columns, as in t=time_s,theta=angle_rad,torque=tau (or voltage=duty, as --input says);
    "theta_dot=" leaves one out. Without a row of names they are 1, 2, ...; "t=" is for rows written every --dt s."""

    zero: Annotated[Literal["upright", "hanging"] | float | None, option("WHERE", default="upright")] = None
    """Where the log's angle is 0, "upright" or "hanging"; or, as a number, the log's angle where the joint hangs."""

    flip_torque: Switch = False
    """A positive torque of the log lowers its angle."""

    degrees: Switch = False
    """The log has degrees and degrees/s."""

    begin: Annotated[Number, arg(name="from")] = None
    """Leave out what comes before this time [s] of the log."""

    end: Annotated[Number, arg(name="to")] = None
    """Leave out what comes after this time [s] of the log."""

    input: Annotated[Literal["torque", "current", "voltage", "position"] | None, option(default="torque")] = None
    """What column torque holds: a torque; a current [A]; a voltage [V] or a duty cycle; or the position that a servo
    was told, in the units of the angle."""

    dt: Number = None
    """Sample interval [s] to resample to; by default the log's own."""

    time_unit: Annotated[Literal["s", "ms", "us"] | None, option()] = None
    """What the log's time counts; by default what the name of the column or the speed shows."""

    joint: Annotated[str, option("NAME")] = ""
    """The joint of a ROS 2 bag or an MCAP file, where it has several (sensor_msgs/JointState; effort is the torque)."""

    noise: Annotated[str, option("theta=SD,theta_dot=SD")] = ""
    """Noise of the sensors [rad], [rad/s] (of an axis [m], [m/s]); by default it is found without any model."""

    hold_out: Annotated[float | None, option("SHARE")] = None
    """What no fit sees: a share, spread over the log, or a number of the last rollouts; by default a quarter."""

    settings: Annotated[Path | None, option("FILE.toml", name="log")] = None
    """A file with these options (columns, zero, from, ...) and plant as keys; what is given here overrides it. By
    default log.toml in the log's folder, where there is one ("none": none)."""

    def reading(self) -> dict[str, Any]:
        """What `sysid.read` is told of these options, by its own names, where they say something."""
        names = ("columns", "zero", "flip_torque", "degrees", "begin", "end", "dt", "time_unit", "joint")
        given = {name: getattr(self, name) for name in names} | {"command": self.input}
        return {name: value for name, value in given.items() if not (value is None or value is False or value == "")}


@dataclass(frozen=True)
class ModelOptions:
    """The model to begin with."""

    model: File = None
    """A model.json; by default the plain plant."""

    plant: Annotated[Literal["rod", "point", "joint", "axis"] | None, option(default="rod")] = None
    """rod: a uniform rod of m, l. point: a point mass m at l. joint: inertia J and gravity torque G. axis: a linear
    drive of mass m that a force moves, in m and N."""

    set: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=NUMBER", help_behavior_hint="(repeatable)")] = ()
    """Fix what is known, as in l=0.45 or g=9.8; of an effect that is not in the model yet: --with."""

    effects_from_start: Annotated[str, option("EFFECT,EFFECT.NAME=NUMBER", name="with")] = ""
    """Effects in the model from the start, as in coulomb,viscous.b=0.1: a number fixes that parameter, without one it
    is fitted (`sysid effects` lists them)."""

    effects: File = None
    """A Python file with effects of your own (@sysid.register), which is run; they are ranked like ours."""


@dataclass(frozen=True)
class OnLog:
    """What every command on a log is told."""

    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)


@dataclass(frozen=True)
class EndsInModel(OnLog):
    """What every command is told whose answer holds a model."""

    out: Output = None
    """Write the model here, as model.json."""

    json: File = None
    """Write the answer here."""


@dataclass(frozen=True)
class FitCommand(EndsInModel):
    """The plant's parameters with intervals, the noise found, and what cannot be told apart."""


@dataclass(frozen=True)
class CompareCommand(OnLog):
    """How far a model is off on data that it has not seen, and where."""

    json: File = None
    """Write the answer here."""

    html: File = None
    """Write a report here that opens offline."""

    figure: File = None
    """Draw the answer here (.png, .pdf, .svg)."""

    parquet: File = None
    """Write the whole log here as Parquet: measured, predicted over 1 s, residual, and the torque that is lacking."""


@dataclass(frozen=True)
class DiagnoseCommand(EndsInModel):
    """Which physical effects the model lacks, with the evidence. Begins with the plain plant, or with --model."""

    html: File = None
    """Write a report here that opens offline."""

    tolerance: Annotated[float, arg(metavar="SHARE")] = 0.02
    """What matters: an effect is added where it lowers the error of predictions by this share."""

    horizon: Annotated[
        float | None, arg(metavar="S", help_behavior_hint="(default: 1; of a free swing, until it has halved)")
    ] = None
    """How far ahead [s] predictions have to be right: shorter for what shakes (and by itself for what balances),
    longer for what decays slowly."""


@dataclass(frozen=True)
class OfEffect:
    """What a command on one effect is told: first of all, on which."""

    effect: Annotated[Positional[str], arg(metavar="EFFECT")]
    """Its name in the catalogue (`sysid effects` lists them)."""


@dataclass(frozen=True)
class AddCommand(EndsInModel, OfEffect):
    """Add one effect: the error before and after."""


@dataclass(frozen=True)
class ExperimentCommand(OnLog):
    """What to play next: the torque that tells effects apart, or that narrows the widest interval."""

    between: Annotated[str, option("EFFECT,EFFECT")] = ""
    """The effects to tell apart; by default the widest interval shrinks."""

    u_max: Annotated[float | None, option("TORQUE", AS_LOG)] = None
    """Largest torque [N m], of an axis force [N]."""

    duration: Annotated[float | None, option("S", AS_LOG)] = None
    """Length of a rollout [s]."""

    rollouts: Annotated[int | None, option("N", AS_LOG)] = None
    """How many rollouts to play."""

    theta_max: Annotated[float | None, option("ANGLE", AS_LOG, "reach")] = None
    """Farthest that the motion may go from rest [rad], of an axis [m]."""

    theta_dot_max: Annotated[float | None, option("SPEED", "any", "speed")] = None
    """Largest speed [rad/s], of an axis [m/s]."""

    out: Output = None
    """Write what the rig plays here, as CSV with columns rollout, t [s], torque [N m] (of an axis [N])."""

    json: File = None
    """Write the answer here."""


@dataclass(frozen=True)
class WorkbenchCommand(OnLog):
    """A local web page for all of this: see where the model fails, click the missing effect, watch the error fall."""

    port: int = 8050
    """Where the page is: http://127.0.0.1:PORT (0: a free one)."""

    host: str = "127.0.0.1"
    """The address that it listens on; on any but this machine's own it wants a token."""

    folder: Annotated[Path, arg(metavar="FOLDER")] = Path("workbench")
    """Where sessions are kept; nothing is written elsewhere."""

    token: Annotated[str, option("TEXT")] = ""
    """What a browser has to know; where one is needed and none is given, one is made up and printed."""


@dataclass(frozen=True)
class ExportCommand:
    """A model for a simulator: MuJoCo's MJCF, or URDF; and a sentence on each thing that the file cannot say."""

    model: Annotated[Positional[Path], arg(metavar="MODEL")]
    """A model.json."""

    to: Annotated[Path, arg(metavar="FILE")]
    """Write it here: .xml is MJCF, .urdf is URDF."""

    into: File = None
    """An MJCF file of your own: what is written is that file, with other numbers at one joint and its actuator."""

    joint: Annotated[str, arg(metavar="NAME")] = "hinge"
    """The joint's name, of --into the one that is changed."""

    effects: File = None
    """A Python file with effects of your own that the model has; it is run."""

    force: Switch = False
    """Write over a file that is there."""

    json: File = None
    """Write the answer here."""


@dataclass(frozen=True)
class EffectsCommand:
    """The catalogue: formula, parameters, units, and what each effect is confused with."""

    effects: File = None
    """A Python file with effects of your own, which is run."""


COMMANDS: dict[str, Callable[..., Any]] = {
    "fit": FitCommand,
    "compare": CompareCommand,
    "diagnose": DiagnoseCommand,
    "add": AddCommand,
    "experiment": ExperimentCommand,
    "export": ExportCommand,
    "effects": EffectsCommand,
    "workbench": WorkbenchCommand,
}
