"""The demonstration: a simulated robot, fused in two ways and compared with the truth."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import compile_plan, load_config
from fuselog.fusion.track import unpack
from fuselog.replay import open_log, reprocess_to
from fuselog.replay.simulate import simulate
from fuselog.replay.wall_robot import arc
from fuselog.service.runs import Run, Series, load_measured, load_run, load_truth
from fuselog.service.view import write_recording

Floats = NDArray[np.float64]
Step = Callable[[float, float], None]

WAYS = ("optimal", "fixed")  # to fuse; each has its configuration
COMPARED = ("y", "yaw")  # m, rad: what the sensors measure


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """Errors against the truth, how consistent each filter is, and the files left behind."""

    seed: int
    rmse: dict[str, dict[str, float | None]]  # by method, then state; None where the method does not give it
    nees: dict[str, float]  # by way to fuse: mean over the states compared, which should be their count
    nis: dict[str, dict[str, float]]  # by way and sensor: mean, which should be 1
    files: list[str]
    next: str  # the command to try

    def to_json(self) -> dict[str, Any]:
        """The result as plain data."""
        return {"schema": 1, **asdict(self)}


def run_demo(folder: Path, *, seed: int, duration: float, step: Step) -> Demo:
    """Simulate, fuse, compare and draw; everything is left in ``folder``. Raises ``FuselogError`` or ``OSError``."""
    folder.mkdir(parents=True, exist_ok=True)
    log, recording = folder / "wall.mcap", folder / "demo.rrd"
    configs = {way: folder / f"{way}.yaml" for way in WAYS}
    outs = {way: folder / f"{way}.mcap" for way in WAYS}
    simulate("wall", log, seed=seed, duration=duration)
    step(1, 5)
    for done, way in enumerate(WAYS, start=2):
        configs[way].write_bytes((files("fuselog.service") / "demo_configs" / f"{way}.yaml").read_bytes())
        plan = compile_plan(*load_config(configs[way]))
        with open_log(log) as opened:
            reprocess_to(opened, plan, outs[way])
        step(done, 5)
    runs = {way: load_run(out) for way, out in outs.items()}
    with open_log(log) as opened:
        measured = load_measured(opened, runs["optimal"].plan)
        true = load_truth(opened, runs["optimal"], "/ground_truth")
    assert true is not None
    step(4, 5)
    write_recording(recording, outs=list(outs.values()), log=log)
    step(5, 5)
    return Demo(
        seed=seed,
        rmse=_errors(measured, runs, true),
        nees={way: _nees(run, true) for way, run in runs.items()},
        nis={way: {d.sensor: float(np.nanmean(d.nis)) for d in run.decisions} for way, run in runs.items()},
        files=[str(path) for path in (log, *configs.values(), *outs.values(), recording)],
        next=f"fuselog view {outs['optimal']} {outs['fixed']} --log {log}",
    )


def _errors(
    measured: dict[str, Series], runs: dict[str, Run], true: Series
) -> dict[str, dict[str, float | None]]:
    fused = {f"fused, {way}": _rmse(run.states, true) for way, run in runs.items()}
    return {
        "ultrasonic alone": _rmse(measured["wall"], true),
        "gyro alone": _rmse(measured["gyro"], true),
        "dead reckoning": _rmse(_dead_reckoning(measured["wheels"], true), true),
        **fused,
    }


def _dead_reckoning(wheels: Series, true: Series) -> Series:
    """What the wheels say, from the true start."""
    t_ns = np.concatenate([true.t_ns[:1], wheels.t_ns])
    pose = np.empty((len(t_ns), 3))
    pose[0] = [true[name][0] for name in ("x", "y", "yaw")]
    for i, dt in enumerate(np.diff(t_ns) / 1e9):
        pose[i + 1] = arc(pose[i], wheels.values[i], float(dt))
    return Series(names=("x", "y", "yaw"), t_ns=t_ns, values=pose)


def _rmse(found: Series, true: Series) -> dict[str, float | None]:
    errors = {name: _errors_of(found, true, name) for name in COMPARED if name in found.names}
    return {name: float(np.sqrt(np.mean(errors[name] ** 2))) if name in errors else None for name in COMPARED}


def _errors_of(found: Series, true: Series, name: str) -> Floats:
    """Errors of one state at the true stamps: the newest number at each, none before the first."""
    error = found[name][_newest(found, true)] - true[name][true.t_ns >= found.t_ns[0]]
    return (error + np.pi) % (2 * np.pi) - np.pi if name == "yaw" else error


def _nees(run: Run, true: Series) -> float:
    """Mean of e' inv(P) e over the states compared."""
    error = np.stack([_errors_of(run.states, true, name) for name in COMPARED], axis=1)
    at = [run.plan.states.index(name) for name in COMPARED]
    P = np.stack([unpack(row, len(run.plan.states)) for row in run.covariance[_newest(run.states, true)]])
    return float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(P[:, at][:, :, at]), error)))


def _newest(found: Series, true: Series) -> NDArray[np.int64]:
    """The row of ``found`` that is the newest at each true stamp."""
    return np.searchsorted(found.t_ns, true.t_ns[true.t_ns >= found.t_ns[0]], side="right") - 1
