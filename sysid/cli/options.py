"""What the command line of sysid understands: one dataclass a command, made of groups that several share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

Files = Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG", help_behavior_hint="")]
File = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Number = Annotated[float | None, arg(metavar="S", help_behavior_hint="")]
AS_LOG = "(default: the log's)"
Switch = FlagCreatePairsOff[Annotated[bool, arg(help_behavior_hint="")]]


@dataclass(frozen=True)
class LogOptions:
    """How the log is read."""

    files: Files = ()
    """CSV, .npz, .mat or Parquet with columns t [s], theta [rad] and/or theta_dot [rad/s], torque [N m] (none: a free
    swing), rollout (where a file has several); of a linear axis [m], [m/s], [N]; ROS 2 bags and MCAP. Several files are
    several rollouts."""

    columns: Annotated[str, arg(metavar="t=NAME,...", help_behavior_hint="")] = ""
    """The file's own names of columns, as in t=time_s,theta=angle_rad,torque=i_meas; "theta_dot=" leaves one out."""

    zero: Annotated[
        Literal["upright", "hanging"] | None,
        arg(metavar="{upright,hanging}", help_behavior_hint="(default: upright)"),
    ] = None
    """Where the log's angle is 0."""

    flip_torque: Switch = False
    """A positive torque of the log lowers its angle."""

    degrees: Switch = False
    """The log has degrees and degrees/s."""

    begin: Annotated[Number, arg(name="from")] = None
    """Leave out what comes before this time [s] of the log."""

    end: Annotated[Number, arg(name="to")] = None
    """Leave out what comes after this time [s] of the log."""

    input: Annotated[
        Literal["torque", "current", "voltage", "position"] | None,
        arg(metavar="{torque,current,voltage,position}", help_behavior_hint="(default: torque)"),
    ] = None
    """What column torque holds: a torque; a current [A]; a voltage [V] or a duty cycle; or the position that a servo
    was told, in the units of the angle."""

    dt: Number = None
    """Sample interval [s] to resample to; by default the log's own."""

    time_unit: Annotated[Literal["s", "ms", "us"] | None, arg(metavar="{s,ms,us}", help_behavior_hint="")] = None
    """What the log's time counts; by default what the name of the column or the speed shows."""

    joint: Annotated[str, arg(metavar="NAME", help_behavior_hint="")] = ""
    """The joint of a ROS 2 bag or an MCAP file, where it has several (sensor_msgs/JointState; effort is the torque)."""

    noise: Annotated[str, arg(metavar="theta=SD,theta_dot=SD", help_behavior_hint="")] = ""
    """Noise of the sensors [rad], [rad/s] (of an axis [m], [m/s]); by default it is found without any model."""

    hold_out: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="")] = None
    """What no fit sees: a share of the log, or a number of rollouts; by default the last quarter."""

    settings: Annotated[Path | None, arg(name="log", metavar="FILE.toml", help_behavior_hint="")] = None
    """A file with these options (columns, zero, from, ...) and plant as keys; what is given here overrides it. By
    default log.toml in the log's folder, where there is one ("none": none)."""


@dataclass(frozen=True)
class ModelOptions:
    """The model to begin with."""

    model: File = None
    """A model.json; by default the plain plant."""

    plant: Annotated[
        Literal["rod", "point", "joint", "axis"] | None,
        arg(metavar="{rod,point,joint,axis}", help_behavior_hint="(default: rod)"),
    ] = None
    """rod: a uniform rod of m, l. point: a point mass m at l. joint: inertia J and gravity torque G. axis: a linear
    drive of mass m that a force moves, in m and N."""

    set: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=NUMBER", help_behavior_hint="(repeatable)")] = ()
    """Fix what is known, as in l=0.45; of an effect that is not in the model yet: --with."""

    effects_from_start: Annotated[str, arg(name="with", metavar="EFFECT,EFFECT.NAME=NUMBER", help_behavior_hint="")] = (
        ""
    )
    """Effects in the model from the start, as in coulomb,viscous.b=0.1: a number fixes that parameter, without one it
    is fitted (`sysid effects` lists them)."""

    gravity: Annotated[float | None, arg(metavar="G", help_behavior_hint="(default: 9.81)")] = None
    """Gravity [m/s^2]."""

    effects: File = None
    """A Python file with effects of your own (@sysid.register), which is run; they are ranked like ours."""


@dataclass(frozen=True)
class FitCommand:
    """The plant's parameters with intervals, the noise found, and what cannot be told apart."""

    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)
    out: Annotated[File, arg(aliases=["-o"])] = None
    """Write the fitted model here, as model.json."""

    json: File = None
    """Write the numbers here."""


@dataclass(frozen=True)
class CompareCommand:
    """How far a model is off on data that it has not seen, and where."""

    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)
    json: File = None
    """Write the answer here."""

    html: File = None
    """Write a report here that opens offline."""

    figure: File = None
    """Draw the answer here (.png, .pdf, .svg)."""

    parquet: File = None
    """Write the whole log here as Parquet: measured, predicted over 1 s, residual, and the torque that is lacking."""


@dataclass(frozen=True)
class DiagnoseCommand:
    """Which physical effects the model lacks, with the evidence. Begins with the plain plant, or with --model."""

    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)
    out: Annotated[File, arg(aliases=["-o"])] = None
    """Write the mended model here, as model.json."""

    json: File = None
    """Write the answer here, as schema gapfinder/diagnosis/1."""

    html: File = None
    """Write a report here that opens offline."""

    tolerance: Annotated[float, arg(metavar="SHARE")] = 0.02
    """What matters: an effect is added where it lowers the error of 1 s predictions by this share."""


@dataclass(frozen=True)
class AddCommand:
    """Add one effect: the error before and after."""

    effect: Annotated[Positional[str], arg(metavar="EFFECT")]
    """Its name in the catalogue (`sysid effects` lists them)."""

    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)
    out: Annotated[File, arg(aliases=["-o"])] = None
    """Write the better model here, as model.json."""

    json: File = None
    """Write the numbers here."""


@dataclass(frozen=True)
class ExperimentCommand:
    """What to play next: the torque that tells effects apart, or that narrows the widest interval."""

    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)
    between: Annotated[str, arg(metavar="EFFECT,EFFECT", help_behavior_hint="")] = ""
    """The effects to tell apart; by default the widest interval shrinks."""

    u_max: Annotated[float | None, arg(metavar="TORQUE", help_behavior_hint=AS_LOG)] = None
    """Largest torque [N m], of an axis force [N]."""

    duration: Annotated[float | None, arg(metavar="S", help_behavior_hint=AS_LOG)] = None
    """Length of a rollout [s]."""

    rollouts: Annotated[int | None, arg(metavar="N", help_behavior_hint=AS_LOG)] = None
    """How many rollouts to play."""

    theta_max: Annotated[float | None, arg(name="reach", metavar="ANGLE", help_behavior_hint=AS_LOG)] = None
    """Farthest that the motion may go from rest [rad], of an axis [m]."""

    theta_dot_max: Annotated[float | None, arg(name="speed", metavar="SPEED", help_behavior_hint="(default: any)")] = (
        None
    )
    """Largest speed [rad/s], of an axis [m/s]."""

    payload: Annotated[tuple[float, float] | None, arg(metavar="MASS DISTANCE", help_behavior_hint="")] = None
    """A known weight that can be hung on: its mass [kg], and its distance from the axis [m]."""

    out: Annotated[File, arg(aliases=["-o"])] = None
    """Write what the rig plays here, as CSV with columns rollout, t [s], torque [N m] (of an axis [N])."""

    json: File = None
    """Write the answer here."""


@dataclass(frozen=True)
class WorkbenchCommand:
    """A local web page for all of this: see where the model fails, click the missing effect, watch the error fall."""

    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)
    port: int = 8050
    """Where the page is: http://127.0.0.1:PORT (0: a free one)."""

    host: str = "127.0.0.1"
    """The address that it listens on; on any but this machine's own it wants a token."""

    folder: Annotated[Path, arg(metavar="FOLDER")] = Path("workbench")
    """Where sessions are kept; nothing is written elsewhere."""

    token: Annotated[str, arg(metavar="TEXT", help_behavior_hint="")] = ""
    """What a browser has to know; where one is needed and none is given, one is made up and printed."""


@dataclass(frozen=True)
class ExportCommand:
    """A model for a simulator: MuJoCo's MJCF, or URDF; and a sentence on each thing that the file cannot say."""

    model: Annotated[Positional[Path], arg(metavar="MODEL")]
    """A model.json."""

    to: Annotated[Path, arg(metavar="FILE")]
    """Write it here: .xml is MJCF, .urdf is URDF."""

    format: Annotated[
        Literal["mjcf", "urdf"] | None,
        arg(metavar="{mjcf,urdf}", help_behavior_hint="(default: by the ending of --to)"),
    ] = None
    """The language, where the ending does not say it."""

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
