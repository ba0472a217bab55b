"""The scenario file: effects hidden from the vehicle file, sensor errors, and faults over time."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from dynamics.decoding import parse_toml
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.effects.wind import steady_wind
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import check_effect, refuse_unknown_keys
from sitl_mock.autopilot.fault_schedule import Fault
from sitl_mock.vehicle.battery import BatteryPack
from sitl_mock.vehicle.clock import ClockKind
from sitl_mock.vehicle.estimator import ERRORS, Estimator
from sitl_mock.vehicle.ground import Ground
from sitl_mock.vehicle.sensors import SensorErrors
from sitl_mock.vehicle.vehicle import VehicleOptions

START_HEIGHT_ERROR_MAX = 100.0  # m


class Wind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Steady wind, world ENU, m/s: short for the effect of that name."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Clock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The vehicle's clock.

    kind: steady, or sitl: counting in steps of 4 ms of a simulation that runs 11 ms per second slow and in steps of 5
        to 18 ms, as PX4's own; None for the one that suits the vehicle.
    drift: time that it gains against the simulation, s per second.
    """

    kind: ClockKind | None = None
    drift: float = 2e-5

    def __post_init__(self) -> None:
        if not abs(self.drift) <= 0.1:
            raise RequestError(f"clock drift of {self.drift} s per second: wanted -0.1 to 0.1.")


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All of a scenario file; a key that it omits is as without a scenario.

    effects: hidden from the vehicle file.
    wind: steady wind.
    battery: None for one that suits the vehicle.
    estimator: whose errors the estimate has; None for the one that suits the vehicle.
    start_height_error: of the estimate, m; None for one by chance.
    sensors: fields of `SensorErrors` in place of the estimator's.
    clock: the vehicle's clock.
    ground: its kind, slope and motion.
    ground_height: m, at the origin.
    position: of the start, east and north, m.
    yaw: of the start, rad from east.
    rotor_noise: standard deviation of a rotor's speed over its speed.
    parameters: PX4 parameters by name.
    faults: what goes wrong when.
    """

    effects: tuple[EffectUse, ...] = ()
    wind: Wind | None = None
    battery: BatteryPack | None = None
    estimator: Estimator | None = None
    start_height_error: float | None = None
    sensors: dict[str, float] = {}
    clock: Clock = Clock()
    ground: Ground = Ground()
    ground_height: float = 0.0
    position: tuple[float, float] = (0.0, 0.0)
    yaw: float = math.pi / 2  # north, as PX4's own simulators stand
    rotor_noise: float = 0.002
    parameters: dict[str, float] = {}
    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        error = self.start_height_error
        if error is not None and not abs(error) <= START_HEIGHT_ERROR_MAX:
            raise RequestError(
                f"start_height_error of {error} m: wanted -{START_HEIGHT_ERROR_MAX:g} to {START_HEIGHT_ERROR_MAX:g}."
            )

    def hidden_effects(self) -> tuple[EffectUse, ...]:
        """The effects, the wind among them."""
        if self.wind is None:
            return self.effects
        return (*self.effects, steady_wind(self.wind.x, self.wind.y, self.wind.z))

    def vehicle_options(self, estimator: Estimator = "mocap") -> VehicleOptions:
        """The part that the simulated vehicle needs. estimator: where the file names none."""
        sensors, wander = ERRORS[self.estimator or estimator]
        return VehicleOptions(
            sensors=replace(sensors, **self.sensors),
            wander=wander,
            start_height_error=self.start_height_error,
            ground=self.ground,
            ground_height=self.ground_height,
            position=self.position,
            yaw=self.yaw,
            rotor_noise=self.rotor_noise,
            battery=self.battery,
        )


def read_scenario(path: str | Path, rotor_count: int, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> Scenario:
    """A scenario from its file.

    Raises RequestError when the file cannot be read, holds a key that does not exist (naming the nearest one that
    does), or a value that is not possible.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(f"cannot read the scenario {path}: {error}. Give a TOML file, see docs/mock.md.") from error
    try:
        return parse_scenario(text, rotor_count, catalogue=catalogue)
    except RequestError as error:
        raise RequestError(f"{path}: {error}") from error


def parse_scenario(text: str, rotor_count: int, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> Scenario:
    """A scenario from the text of its file. Raises RequestError as `read_scenario`."""
    try:
        table = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise RequestError(f"not valid TOML: {error}.") from error
    return scenario_of(table, rotor_count, catalogue=catalogue)


def scenario_of(table: dict[str, Any], rotor_count: int, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> Scenario:
    """A scenario from the table of its file. Raises RequestError as `read_scenario`."""
    refuse_unknown_keys(table, Scenario)
    try:
        scenario = msgspec.convert(table, Scenario)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, RequestError):
            raise error.__cause__ from None
        raise RequestError(f"{described(error)}.") from error
    for use in scenario.hidden_effects():
        check_effect(use, rotor_count, catalogue=catalogue)
    _check_sensors(scenario.sensors)
    return scenario


def _check_sensors(sensors: dict[str, float]) -> None:
    refuse_unknown_keys(sensors, _SensorKeys, "sensors")
    for name, value in sensors.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise RequestError(f"[sensors] {name} = {value}: wanted a number of 0 or more.")
    if sensors.get("delay", 0.0) > 0.5:
        raise RequestError(f"[sensors] delay = {sensors['delay']}: wanted at most 0.5 s.")


_SensorKeys = msgspec.defstruct(
    "_SensorKeys", [(name, float) for name in SensorErrors.__dataclass_fields__], namespace={"__module__": __name__}
)
