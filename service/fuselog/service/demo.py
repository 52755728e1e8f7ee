"""The demonstration: a simulated robot, fused in two ways and compared with the truth."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan, load_plan
from fuselog.replay import open_log, reprocess_to
from fuselog.replay.evaluate import Evaluation, evaluate
from fuselog.replay.measured import Measured, read_measured
from fuselog.replay.results import read_results
from fuselog.replay.simulate import simulate
from fuselog.replay.truth import Truth, read_truth
from fuselog.replay.wall_robot import arc
from fuselog.service.errors import OutputError
from fuselog.service.views.view import write_recording

Floats = NDArray[np.float64]
Step = Callable[[float, float], None]
Errors = dict[str, float | None]  # by state, None where a method does not give it

WAYS = ("optimal", "fixed")  # to fuse; each has its configuration
COMPARED = ("y", "yaw")  # what the sensors measure, m and rad


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """Errors against the truth by method, how consistent each filter is, and the files left behind."""

    seed: int
    rmse: dict[str, Errors]
    evaluation: dict[str, dict[str, Any]]  # by way to fuse, as of fuselog evaluate
    files: list[str]
    next: str  # the command to try

    def to_json(self) -> dict[str, Any]:
        """The result as plain data."""
        return {"schema": 1, **asdict(self)}


def run_demo(folder: Path, *, seed: int, duration: float, step: Step) -> Demo:
    """Simulate, fuse, compare, draw; all is left in ``folder``. Raises ``FuselogError``."""
    log, recording = folder / "wall.mcap", folder / "demo.rrd"
    configs = {way: folder / f"{way}.yaml" for way in WAYS}
    outs = {way: folder / f"{way}.mcap" for way in WAYS}
    _leave(folder, configs)
    simulate("wall", log, seed=seed, duration=duration)
    step(1, 4)
    plans = {way: _fuse(log, configs[way], outs[way]) for way in WAYS}
    step(2, 4)
    with open_log(log) as opened:
        measured = read_measured(opened, plans["optimal"])
        true = read_truth(opened, "/ground_truth")
    evaluations = {way: evaluate(read_results(outs[way]), _only_compared(true)) for way in WAYS}
    step(3, 4)
    write_recording(recording, outs=list(outs.values()), log=log)
    step(4, 4)
    return Demo(
        seed=seed,
        rmse=_errors(measured, true, evaluations),
        evaluation={way: evaluation.to_json() for way, evaluation in evaluations.items()},
        files=[str(path) for path in (log, *configs.values(), *outs.values(), recording)],
        next=f"fuselog view {outs['optimal']} {outs['fixed']} --log {log}",
    )


def _leave(folder: Path, configs: Mapping[str, Path]) -> None:
    """The configurations, for the user to change."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for config in configs.values():
            config.write_bytes((files("fuselog.service") / "demo_configs" / config.name).read_bytes())
    except OSError as error:
        raise OutputError(folder, error.strerror or str(error)) from error


def _fuse(log: Path, config: Path, out: Path) -> Plan:
    plan = load_plan(config)
    with open_log(log) as opened:
        reprocess_to(opened, plan, out)
    return plan


def _only_compared(true: Truth) -> Truth:
    return Truth(true.t_ns, {name: true.values[name] for name in COMPARED})


def _errors(measured: dict[str, Measured], true: Truth, evaluations: dict[str, Evaluation]) -> dict[str, Errors]:
    return {
        "ultrasonic alone": _rmse(measured["wall"], true),
        "gyro alone": _rmse(measured["gyro"], true),
        "wheels alone": _rmse(_dead_reckoning(measured["wheels"], true), true),
        **{f"fused, {way}": dict(evaluation.rmse) for way, evaluation in evaluations.items()},
    }


def _dead_reckoning(wheels: Measured, true: Truth) -> Measured:
    """Where the wheels lead from the true start."""
    t_ns = np.concatenate([true.t_ns[:1], wheels.t_ns])
    twist = np.stack([wheels.values["v"], wheels.values["yaw_rate"]], axis=1)
    pose = np.empty((len(t_ns), 3))
    pose[0] = [true.values[name][0] for name in ("x", "y", "yaw")]
    for i, dt_ns in enumerate(np.diff(t_ns).tolist()):
        pose[i + 1] = arc(pose[i], twist[i], dt_ns * 1e-9)
    return Measured(t_ns, {"x": pose[:, 0], "y": pose[:, 1], "yaw": pose[:, 2]})


def _rmse(found: Measured, true: Truth) -> Errors:
    """Errors at the stamps of what was found; the robot never turns round, so that angles are plain numbers."""
    errors: Errors = dict.fromkeys(COMPARED)
    for name in COMPARED:
        if name in found.values:
            at = _interpolated(true, name, found.t_ns)
            errors[name] = float(np.sqrt(np.mean((found.values[name] - at) ** 2)))
    return errors


def _interpolated(true: Truth, name: str, t_ns: NDArray[np.int64]) -> Floats:
    start = true.t_ns[0]
    return np.asarray(np.interp(t_ns - start, true.t_ns - start, true.values[name]), np.float64)
