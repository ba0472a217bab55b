"""Vehicles and flights: what the other functions start from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from alula.api.inputs import catalogue_with, log_paths, vehicle_of
from alula.workbench import workbench
from dynamics.errors import RequestError
from dynamics.recorded_vehicle import system_chosen

if TYPE_CHECKING:
    from dynamics.effect_card import EffectCard
    from dynamics.vehicle import Vehicle
    from flights import Flight, Log
    from flights.health import Health
    from flights.quality import Inspection


def load_vehicle(vehicle: str | Path, *, effect_files: Sequence[str | Path] = ()) -> Vehicle:
    """A vehicle from its file: body, rotors, limits, controller settings and effects.

    vehicle: TOML file, or the name of a bundled one such as "arpl_250g".
    effect_files: Python files with effects of your own, beside those that the vehicle file names.

    Returns the vehicle, a frozen struct.
    Raises RequestError for a file that cannot be read, an unknown key, or a vehicle that cannot exist.

    Example:
        vehicle = alula.load_vehicle("arpl_250g")
        print(vehicle.body.mass, vehicle.hover_speed)
    """
    return vehicle_of(vehicle, effect_files)


def describe_effects(
    names: Sequence[str] = (), vehicle: Vehicle | str | Path | None = None, *, effect_files: Sequence[str | Path] = ()
) -> tuple[EffectCard, ...]:
    """The catalogue: formula, parameters and usual size of effects, what to fly to see them, and what looks alike.

    names: of effects; by default all.
    vehicle: what `load_vehicle` returned, a vehicle file, or the name of a bundled one: usual sizes are for it.
    effect_files: Python files with effects of your own, beside those that the vehicle names.

    Returns an EffectCard for each effect. Raises RequestError for an unknown name or a file that cannot be used.

    Example:
        (card,) = alula.describe_effects(["rotor_drag"], "arpl_250g")
        print(card.formula, card.usual(card.effect.parameters[0]), card.confounded_with)
    """
    from dynamics.effect_card import effect_cards
    from dynamics.own_effects import catalogue_of
    from dynamics.spelling import nearest

    loaded = None if vehicle is None else vehicle_of(vehicle, effect_files)
    catalogue = catalogue_with(effect_files) if loaded is None else catalogue_of(loaded)
    for name in names:
        if name not in catalogue:
            names_of_all = ", ".join(catalogue)
            raise RequestError(f"unknown effect {name!r}{nearest(name, catalogue)}. Known: {names_of_all}.")
    cards = effect_cards(loaded, catalogue=catalogue)
    return tuple(card for card in cards if not names or card.effect.name in names)


def read_flight(
    log: str | Path, *, mapping: str | Path | None = None, rate: float | None = None, system: int | None = None
) -> Flight:
    """One flight from a log of any known format, as one table on one clock.

    log: ULog, CSV, Parquet, MCAP, tlog, DataFlash, blackbox, Crazyflie log or ROS bag; the content decides which.
    mapping: column mapping (TOML) for a CSV file of another tool.
    rate: rows a second, Hz; by default the rate of the log's gyro.
    system: system id of the vehicle to read where a tlog holds several; by default the first autopilot.

    Returns a Flight: `flight.time` is (n,) s, `flight["velocity"]` (n, 3) m/s, NaN where there was no sample.
    Raises RequestError for a path, mapping or format that is wrong, DataError for a log without a flight.

    Example:
        flight = alula.read_flight("logs/flight_0.csv")
        print(flight.duration, flight["velocity"].shape)
    """
    with workbench("alula.read_flight"):
        from flights import Flight
    with system_chosen(system):
        return Flight.read(log, mapping=mapping, rate=rate)


def read_flights(
    logs: str | Path | Sequence[str | Path], *, mapping: str | Path | None = None, system: int | None = None
) -> tuple[Flight, ...]:
    """The flights of several logs at one rate, that of the slowest, as comparisons and diagnoses need them.

    logs: paths, a folder, or a pattern such as "logs/*.ulg". A folder stands for every log below it; a tlog beside an
        MCAP recording of the same name is the same flight and left out.
    mapping: column mapping (TOML) for CSV files of another tool.
    system: as for `read_flight`.

    Returns the flights in the order of the logs.
    Raises RequestError and DataError as `read_flight`, naming the log.

    Example:
        flights = alula.read_flights("logs")
        print(len(flights), flights[0].rate)
    """
    with workbench("alula.read_flights"):
        from diagnosis.data.dataset import read_flights as read
    with system_chosen(system):
        return tuple(read(log_paths(logs, mapping), mapping=mapping))


def inspect(
    log: Log | str | Path,
    *,
    mapping: str | Path | None = None,
    effect_files: Sequence[str | Path] = (),
    system: int | None = None,
) -> Inspection:
    """Whether a log is good enough, and for what: rates, gaps, clocks, frozen or impossible channels, excitation.

    log: a file, or what `alula.read_log` returned.
    mapping: column mapping (TOML) for a CSV file of another tool.
    effect_files: Python files with effects of your own, which might be identified from the log.
    system: as for `read_flight`.

    Returns an Inspection: `verdict` is "good", "limited" or "unusable", `sentence` the reason, `effects` what can be
        identified, `advice` what would make a better log.
    Raises RequestError and DataError for a log that cannot be read; a poor log gets a poor verdict.

    Example:
        inspection = alula.inspect("logs/flight_0.csv")
        print(inspection.sentence, *inspection.advice, sep="\\n")
    """
    with workbench("alula.inspect"):
        from flights import read_log
        from flights.quality.inspection import judge
    with system_chosen(system):
        content = read_log(log, mapping=mapping) if isinstance(log, (str, Path)) else log
    return judge(content, catalogue_with(effect_files))


def assess_health(log: Log | str | Path, *, mapping: str | Path | None = None, system: int | None = None) -> Health:
    """The health of a flight by what logs at default rates have: who gave up first, and what followed.

    log: a file, or what `alula.read_log` returned; ULog and DataFlash also tell what the autopilot says of itself.
    mapping: column mapping (TOML) for a CSV file of another tool.
    system: as for `read_flight`.

    Returns a Health: `sentences` are two, `advice` what to do, `statements` each with evidence and certainty, `events`
        in the order of time, `unknown` what the log cannot tell.
    Raises RequestError and DataError for a log that cannot be read.

    Example:
        health = alula.assess_health("logs/flight_0.csv")
        print(*health.sentences, *health.advice, sep="\\n")
    """
    with workbench("alula.assess_health"):
        from flights import read_log
        from flights.health import read_health
    with system_chosen(system):
        content = read_log(log, mapping=mapping) if isinstance(log, (str, Path)) else log
    return read_health(content)
