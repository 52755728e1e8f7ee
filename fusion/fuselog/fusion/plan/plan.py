"""From a configuration to numbers: every choice made once, every mistake found before the first sample."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Config, Problem, Source, did_you_mean, read_source, validate
from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.kernel.cache import ModelCard, kernel_module, model_card
from fuselog.fusion.kernel.declared import LINEAR, Declaration, Declared, ModelError, find_model, known_models
from fuselog.fusion.kernel.fit import Fit
from fuselog.fusion.kernel.tables import Role, Tables
from fuselog.fusion.plan.gains import gain_tables
from fuselog.fusion.plan.keys import check_keys, check_shared
from fuselog.fusion.plan.linear import check_seen, read_linear, without_matrices
from fuselog.fusion.plan.robust import robust_tables
from fuselog.fusion.plan.sensors import FORCE, SensorPlan, plan_sensor, quantity_of
from fuselog.fusion.plan.states import check_levers, sensor_states, walks
from fuselog.fusion.plan.steady import Lag, check_frozen, check_rates, settle_gains


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A configuration in numbers, and the names that belong to them."""

    config: Config
    source: Source
    model: Declaration
    card: ModelCard
    sensors: tuple[SensorPlan, ...]
    measured: tuple[str, ...]  # the generated quantities, in the order of their numbers
    tables: Tables
    lags: Mapping[str, Lag]  # by sensor, where gains are steady
    x: NDArray[np.float64]  # (N,) initial state
    P: NDArray[np.float64]  # (N, N) initial covariance
    known: NDArray[np.bool_]  # (N,) which states are given; the others wait for their first measurement

    @property
    def kernel(self) -> ModuleType:
        """The compiled filter."""
        return self._kernel(abreast=False)

    @property
    def abreast(self) -> ModuleType:
        """The same, compiled for several filters that see the same samples with other numbers."""
        return self._kernel(abreast=True)

    def _kernel(self, *, abreast: bool) -> ModuleType:
        return kernel_module(self.model, self.measured, self.config.filter.kind, Fit.of(self.tables), abreast=abreast)

    @property
    def states(self) -> tuple[str, ...]:
        """State names, in order."""
        return tuple(self.card.states)

    def sensor(self, name: str) -> SensorPlan:
        """The sensor of that name; raises ``KeyError``."""
        return next(sensor for sensor in self.sensors if sensor.name == name)


def load_plan(path: str | Path) -> Plan:
    """Read a configuration file and compile it; raises ``ConfigError`` with every problem, of form or of meaning."""
    source = read_source(path)
    config, problems = validate(source)
    if config is None:
        raise source.complain(problems)
    return compile_plan(config, source, problems)


def compile_plan(config: Config, source: Source, known_problems: Sequence[Problem] = ()) -> Plan:
    """Resolve names, rows, gates and gains; raises ``ConfigError`` with every problem, the known ones included."""
    problems: list[Problem] = [] if config.model.name == LINEAR else without_matrices(config.model)
    linear = read_linear(config.model, problems) if config.model.name == LINEAR else None
    if config.model.name == LINEAR and linear is None:
        raise source.complain(_all_problems(known_problems, problems))
    try:
        model = linear[0] if linear else find_model(config.model.name, Path(source.name).parent)
        card = model_card(model)
    except (KeyError, ModelError) as error:
        reason = str(error)
        if isinstance(error, KeyError):
            reason = f"there is no model {config.model.name!r}{did_you_mean(config.model.name, known_models())}"
        raise source.complain([*known_problems, Problem(("model", "name"), reason)]) from error
    sensors = [
        plan_sensor(rank, name, settings, card, problems)
        for rank, (name, settings) in enumerate(config.sensors.items())
    ]
    for sensor in sensors:
        check_keys(sensor, problems)
    check_shared(sensors, problems)
    own_noise, added = list(card.noise), sensor_states(sensors, card, problems)
    if added and not isinstance(model, Declared):
        problems.append(Problem(("sensors",), "a model by matrices has no states of sensors; put them into it"))
    elif isinstance(model, Declared) and added and not problems:
        model = model.with_sensors(added)
        card = model_card(model)
        check_levers(added, card, problems)
    walk = walks(added, config)
    problems += _check_names(config, card, own_noise, [*card.states, *(walk if problems else ())])
    measured: list[str] = []
    rows = [_rows(sensor, card, measured, problems) for sensor in sensors]
    gains = gain_tables(config, card, sensors, rows, problems)
    robust = robust_tables(config, card, sensors, gains["gain"], problems)
    problems += check_rates(config, card, sensors)
    problems += _check_without_covariance(config)
    problems += _check_kind(config)
    if linear and linear[1].step and config.output.ticks is not None:
        problems.append(Problem(("output", "ticks"), "a model of fixed steps has no estimate between them"))
    if linear and not problems:
        H = [_seen(sensor, sensor_rows, card) for sensor, sensor_rows in zip(sensors, rows, strict=True)]
        problems += check_seen(config, linear[1], sensors, H)
    problems = _all_problems(known_problems, problems)
    if problems:
        raise source.complain(problems)
    given = np.array([state in config.initial.state for state in card.states])
    fed = {seed for sensor_rows in rows for _, seed in sensor_rows}
    if any(_level(sensor, card) >= 0 for sensor in sensors):
        fed |= {list(card.states).index(name) for name in ("roll", "pitch")}
    begin = {state: value for state, (_, value) in walk.items()} | config.initial.state
    drifts = {state: each.drift**2 for state, (each, _) in walk.items()}
    deviation = {state: each.sd for state, (each, _) in walk.items()} | config.initial.sd
    sd = np.array([deviation.get(state, 1.0) for state in card.states])
    M = max(sensor.dof for sensor in sensors)
    x, P = np.array([begin.get(state, 0.0) for state in card.states]), np.diag(sd**2)
    tables = Tables(
        M=M,
        S=len(sensors),
        role=np.array([sensor.role for sensor in sensors]),
        rows=np.array([sensor.dof for sensor in sensors]),
        what=_table([[what for what, _ in r] for r in rows], M, np.int64),
        seed=_table([[seed for _, seed in r] for r in rows], M, np.int64),
        turn=np.array([sensor.turn for sensor in sensors]),
        angle=_table([sensor.angles for sensor in sensors], M, np.uint8),
        threshold=np.array([_thresholds(sensor, M) for sensor in sensors]).ravel(),
        sensor=np.array([_place(sensor, config) for sensor in sensors]).ravel(),
        level=np.array([_level(sensor, card) for sensor in sensors]),
        q=np.concatenate([linear[1].numbers if linear else _constants(config, card, drifts), _factors(sensors)]),
        window_ns=round(config.lag.window * 1e9),
        step_ns=round(linear[1].step * 1e9) if linear else 0,
        iterations=config.filter.iterations,
        tolerance=config.filter.tolerance,
        **gains,
        **robust,
    )
    kernel = kernel_module(model, measured, config.filter.kind, Fit.of(tables))
    problems += check_frozen(config, x, card, sensors, tables, kernel, P)
    settled = settle_gains(config, x, card, sensors, tables, kernel)
    if isinstance(settled, Problem):
        raise source.complain([*problems, settled])
    if problems:
        raise source.complain(problems)
    return Plan(
        config=config,
        source=source,
        model=model,
        card=card,
        sensors=tuple(sensors),
        measured=tuple(measured),
        tables=settled.tables,
        lags=settled.lags,
        x=x,
        P=P,
        known=given | np.array([index not in fed for index in range(len(card.states))]),
    )


def _all_problems(known: Sequence[Problem], more: Sequence[Problem]) -> list[Problem]:
    """What is missing may be what is wrong: nothing more is said of a place below which there is a known problem."""
    told = {problem.place[:depth] for problem in known for depth in range(len(problem.place) + 1)}
    return [*known, *(problem for problem in more if problem.place not in told)]


def _check_names(config: Config, card: ModelCard, noise: Sequence[str], states: Sequence[str]) -> list[Problem]:
    named: list[tuple[tuple[str, ...], Mapping[str, object], Sequence[str]]] = [
        (("model", "process_noise"), config.model.process_noise, noise),
        (("model", "parameters"), config.model.parameters, list(card.parameters)),
        (("initial", "state"), config.initial.state, states),
        (("initial", "sd"), config.initial.sd, states),
        (("gain", "scales"), config.gain.scales, states),
    ]
    return [
        Problem((*place, name), f"{card.name} has no {name!r}{did_you_mean(name, known)}")
        for place, given, known in named
        for name in given
        if name not in known
    ]


def _check_without_covariance(config: Config) -> list[Problem]:
    if config.gain.covariance != "none":
        return []
    keys = ("gate", "robust", "adapt", "stationary")
    places: list[tuple[str, ...]] = [
        ("sensors", name, key) for name, s in config.sensors.items() for key in keys if getattr(s, key) is not None
    ]
    places += [("model", "adapt")] if config.model.adapt else []
    return [Problem(place, "needs the covariance, and gain.covariance is none") for place in places]


def _check_kind(config: Config) -> list[Problem]:
    """What only the extended filter has."""
    kind, keys = config.filter.kind, ("robust", "adapt", "gate_recovery", "stationary")
    if kind == "ekf":
        return []
    places: list[tuple[str, ...]] = [
        ("sensors", name, key) for name, s in config.sensors.items() for key in keys if getattr(s, key) is not None
    ]
    places += [("model", "adapt")] if config.model.adapt else []
    places += [("smooth",)] if config.smooth is not None else []
    return [Problem(place, f"needs filter: ekf, and the filter is {kind}") for place in places]


def _rows(sensor: SensorPlan, card: ModelCard, measured: list[str], problems: list[Problem]) -> list[tuple[int, int]]:
    """For each number of the sensor: what it measures (a state, or -1 - a quantity), and the state it can give."""
    states = list(card.states)
    rows: list[tuple[int, int]] = []
    for name in sensor.names if sensor.role == Role.MEASURES else ():
        own = f"{sensor.name}.{name}"
        quantity = own if own in card.quantities else quantity_of(sensor, name, card)
        given = {"polar": None, "beacon_range": None, "magnetometer": "yaw"}.get(sensor.settings.kind, name)
        seed = states.index(given) if given in states else -1
        if sensor.settings.kind == "linear":
            combined = sum(other.startswith("combination ") for other in measured)
            measured.append(" ".join(["combination", str(combined), *_factors_of(sensor, name)]))
            rows.append((-len(measured), -1))
            continue
        if quantity not in card.quantities and sensor.settings.kind in ("polar", "beacon_range", "magnetometer"):
            problems.append(Problem(("sensors", sensor.name, "kind"), f"{card.name} has no body to be seen: no {name}"))
        if quantity is None or quantity not in card.quantities:
            rows.append((max(seed, 0), seed))
            continue
        if quantity not in measured:
            measured.append(quantity)
        rows.append((-1 - measured.index(quantity), seed))
    return rows or [(0, -1)] * sensor.dof


def _level(sensor: SensorPlan, card: ModelCard) -> int:
    """Where the specific force begins among the sensor's numbers that can say how roll and pitch are; or -1."""
    if not card.rotates or not {*FORCE} <= {*sensor.names} or not sensor.settings.remove_gravity:
        return -1
    first = sensor.names.index("ax")
    return first if sensor.names[first : first + 3] == tuple(FORCE) else -1


def _factors_of(sensor: SensorPlan, name: str) -> dict[str, float]:
    """The factors of the states in a number of a linear sensor, but for those that are 0."""
    return {state: factor for state, factor in sensor.settings.H.get(name, {}).items() if factor != 0}


def _factors(sensors: Sequence[SensorPlan]) -> NDArray[np.float64]:
    """The factors of all linear sensors, in the order of the combinations."""
    linear = [(sensor, name) for sensor in sensors if sensor.settings.kind == "linear" for name in sensor.names]
    return np.array([factor for sensor, name in linear for factor in _factors_of(sensor, name).values()])


def _seen(sensor: SensorPlan, rows: Sequence[tuple[int, int]], card: ModelCard) -> NDArray[np.float64]:
    """H (m, N) of a sensor of a model by matrices."""
    H, states = np.zeros((len(rows), len(card.states))), list(card.states)
    for i, (name, (what, _)) in enumerate(zip(sensor.names, rows, strict=True)):
        for state, factor in (_factors_of(sensor, name) if what < 0 else {states[what]: 1.0}).items():
            H[i, states.index(state)] = factor
    return H


def _constants(config: Config, card: ModelCard, drifts: Mapping[str, float]) -> NDArray[np.float64]:
    """Noise densities and parameters of the model, in their order."""
    given, densities = {"gravity": config.gravity} | config.model.parameters, {**config.model.process_noise, **drifts}
    noise = [densities.get(name, default) for name, default in card.noise.items()]
    return np.array([*noise, *(given.get(name, default) for name, default in card.parameters.items())])


def _thresholds(sensor: SensorPlan, most: int) -> list[float]:
    """The gate for 1, 2, ... ``most`` numbers; fewer than all take part while others start the filter."""
    if sensor.settings.gate is None or sensor.role != Role.MEASURES:
        return [np.inf] * most
    return [chi_square_quantile(sensor.settings.gate, dof) for dof in range(1, most + 1)]


def _place(sensor: SensorPlan, config: Config) -> list[float]:
    mount = sensor.settings.mount
    lever = (0.0, 0.0, 0.0) if mount == "from_tf" else mount.xyz
    return [*lever, config.gravity, *sensor.settings.station]


def _table(rows: Sequence[Sequence[int]], width: int, kind: type[np.generic]) -> NDArray[np.generic]:
    table: NDArray[np.generic] = np.zeros((len(rows), width), kind)
    for index, row in enumerate(rows):
        table[index, : len(row)] = row
    return table.ravel()
