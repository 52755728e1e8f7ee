"""The configuration as data: every key with its default, unknown keys refused."""

import re
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

_UNITS = {"s": 1.0, "ms": 1e-3, "min": 60.0}
_SIZES = {"B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}


def _seconds(value: Any) -> Any:
    if isinstance(value, str):
        match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(s|ms|min)?\s*", value)
        if match is None:
            raise ValueError("expected a time such as 0.5, '0.5 s', '500 ms' or '2 min'")
        return float(match[1]) * _UNITS[match[2] or "s"]
    return value


def _bytes(value: Any) -> Any:
    if isinstance(value, str):
        match = re.fullmatch(r"\s*([0-9.]+)\s*(B|kB|MB|GB|KiB|MiB|GiB)?\s*", value)
        if match is None:
            raise ValueError("expected a size such as 1000000, '64 MiB' or '2 GB'")
        return round(float(match[1]) * _SIZES[match[2] or "B"])
    return value


Seconds = Annotated[float, BeforeValidator(_seconds)]
Bytes = Annotated[int, BeforeValidator(_bytes)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Matrix = list[list[Finite]]  # row by row


class Settings(BaseModel):
    """A part of the configuration; keys that it does not have are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class ProcessAdaptSettings(Settings):
    """One factor on the process noise and on the noise of inputs, learned from the innovations of all sensors."""

    window: Annotated[int, Field(ge=2)] = Field(200, description="samples over which it is learned")
    floor: Positive = Field(0.1, description="least factor on the densities")
    ceiling: Positive = Field(10.0, description="greatest factor on the densities")


class ModelSettings(Settings):
    """Which motion model, and its process noise as spectral densities (unit² / s), independent of the rate."""

    name: str = Field(description="one of fuselog's own, or my_robot.py:Tricycle, beside the configuration")
    process_noise: dict[str, NotNegative] = Field(default_factory=dict)
    parameters: dict[str, Finite] = Field(default_factory=dict, description="constants of the model, by name")
    adapt: ProcessAdaptSettings | None = Field(None, description="learn one factor on all process noise")
    states: dict[str, str] = Field(default_factory=dict, description="linear: units by state; rad is an angle")
    inputs: dict[str, str] = Field(default_factory=dict, description="linear: units by input")
    step: Annotated[Seconds, Field(gt=0)] | None = Field(None, description="linear: time that F, G and Q hold for")
    F: Matrix | None = Field(None, description="linear: x' = F x + G u + w after a step")
    G: Matrix | None = None
    Q: Matrix | None = Field(None, description="linear: covariance of w")
    Fc: Matrix | None = Field(None, description="linear: dx/dt = Fc x + Gc u + w, in place of F, for any time")
    Gc: Matrix | None = None
    Qc: Matrix | None = Field(None, description="linear: spectral density of w")


def _named(value: Any) -> Any:
    return {"name": value} if isinstance(value, str) else value


class FilterSettings(Settings):
    """How a sample is weighed where model or measurement is not linear."""

    kind: Literal["ekf", "iekf", "ukf"] = Field(
        "ekf",
        description="ekf: derivatives at the predicted state; iekf: at the corrected one, in turns; ukf: sigma points",
    )
    iterations: Annotated[int, Field(ge=1, le=100)] = Field(10, description="iekf: most linearisations of one sample")
    tolerance: Positive = Field(1e-6, description="iekf: change, in standard deviations, at which it is done")


def _of_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


class InitialSettings(Settings):
    """Where the filter starts. A state not given here is taken from the first measurement of it."""

    source: Literal["first_measurement"] = Field("first_measurement", alias="from")
    state: dict[str, Finite] = Field(default_factory=dict, description="values of states, in their units")
    sd: dict[str, NotNegative] = Field(default_factory=dict, description="standard deviations; 1 when not given")


class CycleSettings(Settings):
    """Samples that are fused together, as Bezmen 2019 does it: the newest of each sensor in a period, at its end."""

    period: Annotated[Seconds, Field(ge=0, le=3600)] = Field(0.0, description="0: samples of one stamp")
    max_age: Annotated[Seconds, Field(gt=0)] | None = Field(
        None, description="silence after which a sensor is missing; by default as soon as a cycle is without it"
    )
    missing: Literal["prediction", "renormalize", "rescale", "skip"] = Field(
        "rescale", description="where the weight of a missing sensor goes"
    )


class ReacquireSettings(Settings):
    """The optimal gain in place of fixed ones at the start and after a gap, until the covariance has settled again."""

    factor: Annotated[float, Field(gt=1, allow_inf_nan=False)] = Field(
        1.2, description="variances over their steady values, on average, above which it begins"
    )
    until: Annotated[float, Field(ge=1, allow_inf_nan=False)] = Field(1.05, description="and at which it ends")
    gap: Annotated[Seconds, Field(gt=0)] = Field(5.0, description="silence of all sensors after which it begins")


class RangeSettings(Settings):
    """Between what a value must be."""

    above: Finite | None = None
    below: Finite | None = None


class AgeSettings(Settings):
    """Between which ages (s) a filter must be."""

    above: Seconds | None = None
    below: Seconds | None = None


class WhenSettings(Settings):
    """Conditions that must all hold, of the estimate before a sample."""

    age: AgeSettings | None = Field(None, description="since the first sample")
    speed: RangeSettings | None = Field(None, description="length of the velocity, m/s")
    states: dict[str, RangeSettings] = Field(default_factory=dict, description="in their units")
    sensors: list[str] = Field(default_factory=list, description="those that are heard: fused within cycle.max_age")

    @property
    def empty(self) -> bool:
        """Whether it always holds."""
        return not (self.age or self.speed or self.states or self.sensors)


class VariantSettings(Settings):
    """A gain for as long as its conditions hold: those of a schedule are tried in turn, the last has none."""

    when: WhenSettings = WhenSettings.model_validate({})
    mode: Literal["optimal", "fixed", "steady_state"] | None = Field(None, description="fixed where weights are given")
    weights: dict[str, Any] = Field(default_factory=dict)
    nominal: dict[str, Finite] = Field(default_factory=dict)


class GainSettings(Settings):
    """How the gain is made: by the filter (optimal), fixed as in Bezmen 2019, or the filter's own once it is steady."""

    mode: Literal["optimal", "fixed", "steady_state", "scheduled"] = "optimal"
    form: Literal["absorb", "state", "matrix"] = Field(
        "absorb",
        description="absorb: share of each innovation; state: weights of numbers in states (eq. 29); matrix: G itself",
    )
    reference: Literal["live", "scales"] = Field("live", description="absorb: what stands for P in the gain")
    scales: dict[str, Positive] = Field(default_factory=dict, description="reference: scales: sd of each state")
    weights: dict[str, Any] = Field(
        default_factory=dict,
        description="absorb: {sensor.number: share}; state, matrix: {state: {sensor.number: weight}}",
    )
    sum: Literal["one", "at_most_one", "free"] = Field("at_most_one", description="state: what each row adds up to")
    cycle: CycleSettings | None = Field(None, description="absorb, state: fuse what a period brings at once")
    rates: dict[str, Positive] = Field(
        default_factory=dict, description="Hz of each sensor that corrects; with them, fixed gains are proved stable"
    )
    nominal: dict[str, Finite] = Field(
        default_factory=dict, description="states and inputs to linearise about; else initial, and rest"
    )
    open_loop: list[str] = Field(default_factory=list, description="states that may drift: no proof covers them")
    reacquire: ReacquireSettings | None = Field(None, description="needs rates")
    schedule: list[VariantSettings] = Field(
        default_factory=list[VariantSettings], description="scheduled: the first that holds"
    )
    covariance: Literal["joseph", "none"] = Field(
        "joseph", description="none: only x is computed, for state, matrix and steady gains; no gate, no NIS"
    )


class LagSettings(Settings):
    """How late a sample may be and still be fused at its own time."""

    window: Annotated[Seconds, Field(ge=0, le=3600)] = 1.0
    max_step: Annotated[Seconds, Field(gt=0, le=86400)] = Field(
        60.0, description="a stamp further ahead of the newest is a wrong clock, until others in a row agree with it"
    )
    order: Literal["by_stamp", "as_received"] = Field(
        "by_stamp", description="reprocess: rows in stamp order, or as the live service published them"
    )


class MountSettings(Settings):
    """Where the sensor sits on the body: base_from_sensor."""

    xyz: Vector = Field((0.0, 0.0, 0.0), description="m, body axes")
    rpy: Vector = Field((0.0, 0.0, 0.0), description="rad")


class WalkSettings(Settings):
    """A number that is estimated along with the model's states: a random walk."""

    sd: NotNegative = Field(description="of its value at the start")
    drift: NotNegative = Field(0.0, description="sd that it gains in one second; it grows with the root of time")


class StatesSettings(Settings):
    """What of a sensor is estimated: it reads (1 + scale) h + bias, at its lever arm."""

    bias: dict[str, WalkSettings] = Field(default_factory=dict, description="by number, in its unit")
    scale: dict[str, WalkSettings] = Field(default_factory=dict, description="by number; 0.01 is 1 % too much")
    lever: WalkSettings | None = Field(None, description="m, each axis, about mount xyz")


class FieldSettings(Settings):
    """How strong a magnetic field must be to be the Earth's, and what to do where it is not."""

    strength: Positive | Literal["first_second"] = Field(
        "first_second", description="in the messages' unit; by default what the first second of samples has on average"
    )
    tolerance: Positive = Field(0.1, description="greatest share that a field may be stronger or weaker")
    disturbed: Annotated[float, Field(ge=1, allow_inf_nan=False)] | Literal["refuse"] = Field(
        "refuse", description="refuse counts the sample as gated; a number is a factor on its sd"
    )


class RobustSettings(Settings):
    """Samples that are far off count less, in place of a gate that refuses them."""

    kind: Literal["huber", "student_t"] = Field(description="how the weight falls: by the distance, or its square")
    threshold: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.95, description="huber: probability that a good sample keeps its whole weight"
    )
    dof: Positive = Field(4.0, description="student_t: the smaller, the heavier the tails of the noise")


class AdaptSettings(Settings):
    """A factor on the sensor's noise, learned from its innovations."""

    window: Annotated[int, Field(ge=2)] = Field(50, description="samples over which it is learned")
    floor: Positive = Field(0.5, description="least factor on the sd")
    ceiling: Positive = Field(100.0, description="greatest factor on the sd")


class GateRecoverySettings(Settings):
    """How long a gate may refuse everything before the filter gives in."""

    samples: Annotated[int, Field(ge=2)] = Field(20, description="refused in a row")
    time: Annotated[Seconds, Field(ge=0)] = Field(0.0, description="and since the last that was fused")


class StationarySettings(Settings):
    """When a sensor's samples say that the body stands, and how surely velocity and turn rate are 0 then."""

    window: Annotated[Seconds, Field(gt=0, le=60)] = Field(0.5, description="stretch that is judged as a whole")
    gyro: Positive = Field(0.01, description="rad/s: most sd of each turn rate")
    bias: Positive = Field(0.1, description="rad/s: most mean of each turn rate, which may be bias")
    acceleration: Positive = Field(0.05, description="m/s²: most sd of each acceleration")
    speed: Positive = Field(0.001, description="m/s: most sd and mean of each velocity")
    velocity_sd: Positive = Field(0.01, description="m/s: sd of a velocity of 0")
    turn_sd: Positive = Field(0.001, description="rad/s: sd of a turn rate of 0")
    gate: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.9999, description="the estimate denies a standstill that is less probable than this leaves"
    )


class SensorSettings(Settings):
    """One stream of samples and what of it is fused."""

    topic: str = Field(min_length=1)
    enabled: bool = Field(True, description="false: its samples are counted as disabled, and not used")
    type: str | None = Field(None, description="message type; by default as the log or the publisher says")
    reliable: bool = Field(
        False, description="live: ask publishers that keep their samples for those missed, and for those before us"
    )
    kind: Literal[
        "state", "linear", "polar", "beacon_range", "magnetometer", "pressure", "constant", "zero_velocity", "input"
    ] = "state"
    fuse: list[str] = Field(default_factory=list, description="names of states, or of what the kind measures")
    fields: dict[str, str] = Field(default_factory=dict, description="name: path in the message, for other types")
    value: str | None = Field(None, description="beacon_range, pressure: path of the range or the pressure")
    beacon: str | None = Field(None, description="beacon_range: path of the beacon's position (x, y, z)")
    variance: dict[str, str] = Field(default_factory=dict, description="name: path of its variance in the message")
    covariance: str | None = Field(None, description="path of a square covariance of the numbers, in their order")
    stamp: str | None = Field(None, description="path of the stamp; found by itself as a rule")
    rate: Positive | None = Field(None, description="Hz at which samples are expected; health says when it is another")
    noise: dict[str, Positive] = Field(
        default_factory=dict, description="sd in place of the message's; of an input: per root hertz"
    )
    H: dict[str, dict[str, Finite]] = Field(
        default_factory=dict, description="linear: {number: {state: factor}}; what is not there is 0"
    )
    R: Matrix | None = Field(None, description="covariance of all numbers, in the order of fuse, in place of noise")
    noise_floor: dict[str, Positive] = Field(default_factory=dict, description="least sd")
    noise_scale: Positive = Field(1.0, description="factor on the message's sd")
    scale: dict[str, Finite] = Field(default_factory=dict, description="factor on the value")
    offset: dict[str, Finite] = Field(default_factory=dict, description="added to the scaled value")
    gate: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None, description="probability that a good sample passes (chi-square by its degrees of freedom)"
    )
    gate_recovery: GateRecoverySettings | None = Field(None, description="end a lock-out; by default none ends")
    robust: RobustSettings | None = Field(None, description="weigh far samples less, in place of a gate")
    adapt: AdaptSettings | None = Field(None, description="learn the size of the noise")
    stationary: StationarySettings | None = Field(None, description="tell from its samples when the body stands")
    mount: MountSettings | Literal["from_tf"] = MountSettings.model_validate({})
    frame: str | None = Field(None, description="from_tf: the sensor's frame; by default as the message says")
    hold: Literal["next", "previous"] = Field("next", description="input: holds after its stamp, or up to it")
    remove_gravity: bool = Field(True, description="accelerations are specific force, as an IMU gives")
    declination: Finite = Field(0.0, description="magnetometer: of magnetic from true north, rad, positive to the east")
    station: Vector = Field((0.0, 0.0, 0.0), description="polar: where the station is, m, world")
    datum: Literal["first_fix"] | Vector = Field(
        "first_fix", description="NavSatFix: latitude, longitude (deg), altitude (m) of the origin"
    )
    reference: Positive | Literal["first_sample"] = Field("first_sample", description="pressure: Pa where z is 0")
    field: FieldSettings | None = Field(None, description="magnetometer: check of the field's strength")
    when: str | None = Field(
        None, description="constant, zero_velocity: path of a number; messages where it is 0 are no samples"
    )
    states: StatesSettings = Field(StatesSettings.model_validate({}), description="what of the sensor is estimated")


class OutputSettings(Settings):
    """Where estimates go and how their frames are called."""

    estimate: str = "fused/odom"
    frame: str = "odom"
    child: str = "base_link"
    encoding: Literal["cdr", "json", "protobuf"] = Field(
        "cdr", description="of what a live service publishes; recordings and logs hold CDR"
    )
    rate: Positive | None = Field(None, description="most estimates per second of event time; by default one a sample")
    ticks: Annotated[float, Field(gt=0, le=1000)] | None = Field(
        None, description="Hz: estimates predicted to the multiples of 1/ticks in event time; by default none"
    )
    settled: bool = Field(False, description="also publish the estimates in the order of stamps, behind the lag window")
    now: Annotated[float, Field(gt=0, le=200)] | None = Field(
        None, description="Hz: estimates predicted to the time of the machine's clock, live only; by default none"
    )


class SmoothSettings(Settings):
    """Estimates that know what came some seconds after them, published beside the others."""

    lag: Annotated[Seconds, Field(gt=0, le=3600)] = Field(description="of which later samples an estimate knows")
    rate: Positive = Field(10.0, description="most estimates per second of event time")


class TlsSettings(Settings):
    """Certificates (PEM) for endpoints of tls/ and quic/; paths are from the folder of the configuration."""

    ca: str = Field(min_length=1, description="file: who may have signed the other side's certificate")
    certificate: str | None = Field(None, description="file: our own, which both listening and connecting show")
    key: str | None = Field(None, description="file that others cannot read: the certificate's private key")
    mutual: bool = Field(True, description="who connects shows a certificate too")
    verify_name: bool = Field(True, description="connect only where the certificate is for the endpoint's host")


class RosSettings(Settings):
    """ROS 2 by rmw_zenoh: its keys beside the plain ones, for what is read and what is published."""

    domain: Annotated[int, Field(ge=0, le=232)] = Field(0, description="ROS_DOMAIN_ID")


class ZenohSettings(Settings):
    """How the service meets others. The default listens on loopback only and looks for nobody."""

    mode: Literal["peer", "client"] = "peer"
    listen: list[str] = Field(default_factory=lambda: ["tcp/127.0.0.1:7447"])
    connect: list[str] = Field(default_factory=list)
    multicast: bool = False
    tls: TlsSettings | None = Field(None, description="for endpoints tls/HOST:PORT and quic/HOST:PORT")
    user: str | None = Field(None, min_length=1, description="who we say we are; needs a password")
    password_file: str | None = Field(None, description="file that others cannot read, with the password only")
    password_env: str | None = Field(None, description="or the environment variable that holds it")
    users_file: str | None = Field(None, description="who may connect to us: lines user:password")
    access: str | None = Field(None, description="JSON5 file: Zenoh's access_control of this session")
    max_payload: Annotated[Bytes, Field(ge=1)] | None = Field(
        None, description="bytes of payload and attachment; larger samples of others are dropped, uncounted"
    )
    cache: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        0, description="samples of each output that are kept for who missed them; 0: none, and no recovery"
    )
    ros: RosSettings | None = Field(None, description="topics of ROS 2 as rmw_zenoh has them, beside plain keys")
    raw: dict[str, Any] = Field(default_factory=dict, description="any other key of Zenoh's configuration by its path")


class HttpTlsSettings(Settings):
    """The service's certificate (PEM); paths are from the folder of the configuration."""

    certificate: str = Field(min_length=1, description="file: the certificate, and those up to its authority")
    key: str = Field(min_length=1, description="file that others cannot read: the certificate's private key")


class HttpSettings(Settings):
    """Where the service answers, and whom."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    tokens: str | None = Field(
        None, description="file that others cannot read, from the folder of the configuration: who may read and control"
    )
    tls: HttpTlsSettings | None = Field(None, description="HTTPS in place of HTTP")
    hosts: list[str] = Field(
        default_factory=list, description="names that requests may be for; those of loopback may always be used"
    )
    streams: Annotated[int, Field(ge=0, le=1000)] = Field(64, description="most clients of the stream at one time")


class RecordSettings(Settings):
    """A log of what the service receives and publishes: NAME_0.mcap, NAME_1.mcap, ..., beginning at a free number."""

    path: str = Field(min_length=1, description="NAME.mcap, from the folder where the service runs")
    compression: Literal["lz4", "zstd", "none"] = "lz4"
    durability: Literal["none", "flush", "fsync"] = Field(
        "flush", description="what a crash leaves: of the process (flush) or the machine (fsync), all but a second"
    )
    max_size: Annotated[Bytes, Field(ge=1 << 16)] | None = Field(None, description="bytes, then another file begins")
    max_duration: Annotated[Seconds, Field(gt=0)] | None = Field(None, description="then another file begins")
    snapshot: Annotated[Seconds, Field(gt=0, le=3600)] | None = Field(
        None, description="time kept in memory, and written only at SIGUSR1"
    )
    snapshot_memory: Annotated[Bytes, Field(ge=1 << 20)] = Field(256 << 20, description="bytes of memory for it")
    latched: list[str] = Field(default_factory=lambda: ["/tf_static"], description="topics repeated in every file")


class CheckpointSettings(Settings):
    """What a service puts aside of its filters, to go on from after a restart."""

    folder: str = Field(min_length=1, description="one file for each filter, from the folder where the service runs")
    every: Annotated[Seconds, Field(gt=0, le=3600)] = 1.0


class FleetSettings(Settings):
    """Filters that topics with captures make, such as fleet/{robot}/imu: one for each name."""

    most: Annotated[int, Field(ge=1, le=10_000)] = Field(100, description="filters at a time")
    expire: Annotated[Seconds, Field(gt=0)] = Field(60.0, description="silence of all its topics that ends a filter")


class Config(Settings):
    """One filter: model, start, gain, sensors, and where its results go."""

    version: Literal[1] = Field(alias="fuselog")
    id: str = Field("filter", pattern=r"^[A-Za-z0-9_.{}-]{1,64}$")
    model: Annotated[ModelSettings, BeforeValidator(_named)]
    filter: Annotated[FilterSettings, BeforeValidator(_of_kind)] = FilterSettings.model_validate({})
    initial: InitialSettings = InitialSettings.model_validate({})
    gain: GainSettings = GainSettings.model_validate({})
    lag: LagSettings = LagSettings.model_validate({})
    gravity: Positive = Field(9.80665, description="m/s²")
    sensors: dict[str, SensorSettings] = Field(min_length=1)
    output: OutputSettings = OutputSettings.model_validate({})
    smooth: SmoothSettings | None = Field(None, description="fixed-lag smoothing; by default none")
    zenoh: ZenohSettings = ZenohSettings.model_validate({})
    http: HttpSettings = HttpSettings.model_validate({})
    record: RecordSettings | None = Field(None, description="of a live service; by default nothing is recorded")
    fleet: FleetSettings = FleetSettings.model_validate({})
    checkpoint: CheckpointSettings | None = Field(None, description="by default a service begins anew")
