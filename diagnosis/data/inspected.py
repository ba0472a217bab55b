"""Findings of inspection about the flights, before anything is fitted: doubted speed sensors, frozen channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from diagnosis.data.misread_rotors import misread_rotors, misread_text, reading_shares
from diagnosis.data.rotor_moments import compared_moments, rotor_gains
from diagnosis.data.segment import Segment, battery_is_measured, segments
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.errors import DataError
from dynamics.excitation import COMMAND
from dynamics.rotor_places import rotor_names
from dynamics.vehicle import Vehicle
from flights import Flight
from flights.exclusion import free_flight
from flights.quality.declared import declared_wrong, flying_streams
from flights.quality.findings import Finding
from flights.quality.frozen import frozen_findings
from flights.quality.inspection import MIN_ROTOR_RATE
from flights.quality.rotor_balance import UnevenRotor, rotor_findings, uneven_rotors

TINY = 1e-3  # of a gain that is none


def inspected(
    flights: Sequence[Flight], vehicle: Vehicle, thresholds: Thresholds = DEFAULT
) -> tuple[list[Flight], tuple[Finding, ...]]:
    """The flights as far as they can be believed, and what was found about them.

    A rotor whose measured speed is far from its peers' without a command that explains it has a wrong sensor, unless
    its moments are those of its speed in the flights that read so. Then no measured speed is used where all flights
    have commands.

    Raises DataError, which names the rotor, where they have none, and for units and frames that contradict the motion.
    """
    findings: dict[Finding, None] = {}
    uneven: dict[int, list[tuple[Flight, UnevenRotor]]] = {}
    for flight in flights:
        measured, parts, name = _measured(flight, vehicle), free_flight(flight), Path(flight.provenance.path).name
        for finding in declared_wrong(flying_streams(flight, parts)):
            raise DataError(f"{name}: {finding.text}. {finding.advice}.")
        of_rotors = rotor_findings(parts) if measured else []
        for finding in (*of_rotors, *frozen_findings(flight), *_battery_findings(parts, thresholds)):
            findings[msgspec.structs.replace(finding, text=f"{name}: {finding.text}")] = None
        if not measured:
            continue
        for rotor in uneven_rotors(parts):
            if not rotor.as_commanded:
                uneven.setdefault(rotor.rotor, []).append((flight, rotor))
    if len(uneven) > 1 and (misread := _misread(uneven, vehicle, thresholds)):
        finding = Finding("error", "rotor_speed_fault", misread, "check the ESCs' telemetry and their pole counts")
        if not all(_commanded(flight) for flight in flights):
            raise DataError(f"{misread}. Repair it, or log the motor commands beside the speeds, which are then used.")
        others = (other for other in findings if other.name != finding.name)
        return [_without_speeds(flight) for flight in flights], (finding, *others)
    doubted = [of_rotor[0] for of_rotor in uneven.values() if _is_wrong(of_rotor, vehicle, thresholds)]
    if not doubted:
        return list(flights), tuple(findings)
    if all(_commanded(flight) for flight in flights):
        return [_without_speeds(flight) for flight in flights], tuple(findings)
    flight, wrong = doubted[0]
    raise DataError(f"{Path(flight.provenance.path).name}: {_doubt(wrong, vehicle)}")


def _misread(
    uneven: Mapping[int, Sequence[tuple[Flight, UnevenRotor]]], vehicle: Vehicle, thresholds: Thresholds
) -> str:
    """Which rotors' speeds are wrong, by weight and moments, where several are uneven; empty where these tell none.

    Where two of four read otherwise, no majority of peers says which two.
    """
    names = {flight.provenance.path: flight for of_rotor in uneven.values() for flight, _ in of_rotor}
    parts = [segment for flight in names.values() for segment in segments(flight, vehicle, thresholds)]
    shares = reading_shares(parts, vehicle, thresholds.rotor_moments)
    wrong = [] if shares is None else misread_rotors(shares)
    if shares is None or not wrong:
        return ""
    cause = "their measurement is wrong (rotor_speed_fault)"
    if max(shares[index] for index in wrong) > 1.0:
        cause += ", or a propeller is damaged or lost"
    files = ", ".join(Path(name).name for name in names)
    return f"{files}: {misread_text(shares, wrong, vehicle)}: {cause}"


def _is_wrong(of_rotor: Sequence[tuple[Flight, UnevenRotor]], vehicle: Vehicle, thresholds: Thresholds) -> bool:
    """Whether the speed of a rotor is wrong in the flights in which it is uneven.

    Of one flight that turns about one axis, only the difference of two opposite rotors' moments is known.
    """
    if any(uneven.as_commanded is False for _, uneven in of_rotor):
        return True
    parts = [segment for flight, _ in of_rotor for segment in segments(flight, vehicle, thresholds)]
    usual = sorted((uneven for _, uneven in of_rotor), key=lambda uneven: uneven.share)[len(of_rotor) // 2]
    return _contradicted(parts, usual, vehicle, thresholds)


def _doubt(wrong: UnevenRotor, vehicle: Vehicle) -> str:
    """Why the flights are refused. What reads too fast may also be a propeller that gives too little."""
    reads = f"{rotor_names(vehicle)[wrong.rotor]} reads {wrong.share:.2f} times the speed of its peers"
    cause = "neither a command nor its moments explain it: its speed sensor is wrong (rotor_speed_fault), not the rotor"
    if wrong.share > 1.0 and wrong.as_commanded is None:
        cause = "its moments do not: its speed sensor is wrong (rotor_speed_fault) or its propeller is damaged or lost"
    return f"{reads}, and {cause}. Repair it, or log the motor commands beside the speeds, which are then used instead."


def doubt_note(flights: Sequence[Flight], used: Sequence[Flight], findings: Sequence[Finding]) -> list[str]:
    """Notes for the user where measured speeds were left out."""
    if all(one is other for one, other in zip(flights, used, strict=True)):
        return []
    reason = next(finding.text for finding in findings if finding.name == "rotor_speed_fault")
    return [
        f"no measured rotor speed is used, because a speed sensor is wrong (rotor_speed_fault): {reason}. The motor "
        "commands are used instead"
    ]


def _battery_findings(parts: Sequence[Flight], thresholds: Thresholds) -> list[Finding]:
    if not parts or not parts[0].has("battery_voltage"):
        return []
    if all(battery_is_measured(part, thresholds.segment) for part in parts):
        return []
    lowest = min(float(np.nanmin(part["battery_voltage"], initial=np.inf)) for part in parts)
    return [
        Finding(
            "warning",
            "battery_unmeasured",
            f"the battery voltage, {lowest:.2f} V at least, is not a plausible pack voltage in flight: ignored",
            "check its sensor, its unit (V) and its scale",
        )
    ]


def _measured(flight: Flight, vehicle: Vehicle) -> bool:
    origin = flight.origins.get("rotor_speed")
    there = flight.has("rotor_speed") and flight["rotor_speed"].shape[1] == vehicle.rotors.count
    return there and (origin is None or origin.rate >= MIN_ROTOR_RATE)


def _commanded(flight: Flight) -> bool:
    rates = [
        flight.origins[name].rate if name in flight.origins else flight.rate for name in COMMAND if flight.has(name)
    ]
    return any(rate >= MIN_ROTOR_RATE for rate in rates)


def _contradicted(parts: Sequence[Segment], wrong: UnevenRotor, vehicle: Vehicle, thresholds: Thresholds) -> bool:
    """Whether the rotor's moments are nearer to those of its peers' speed than to those of the speed that it reads.

    Not where its peers' moments are off by as much: then turbulence says nothing of single rotors.
    """
    if not parts:  # it reads zero, so that nowhere in flight all rotors have a speed
        return True
    moments = compared_moments(parts, vehicle, thresholds.rotor_moments)
    if moments.explained < thresholds.rotor_moments.min_explained:
        return True
    gains = rotor_gains(moments, vehicle)
    sizes, gain = np.abs(np.log(np.maximum(gains, TINY))), float(gains[wrong.rotor])
    if sizes[wrong.rotor] < thresholds.rotor_moments.min_outlier * np.max(np.delete(sizes, wrong.rotor)):
        return False
    return gain > 1 / wrong.share if wrong.share < 1 else gain < 1 / wrong.share


def _without_speeds(flight: Flight) -> Flight:
    return replace(flight, values={name: v for name, v in flight.values.items() if name != "rotor_speed"})
