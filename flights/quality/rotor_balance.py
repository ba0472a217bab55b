"""Comparison of rotors: one whose measured speed is far from its peers' while commands and motion are healthy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from dynamics.excitation import COMMAND
from flights.filters import runs
from flights.flight import Flight
from flights.quality.findings import Finding

FAR_OFF = 0.8  # of the peers' speed, or its inverse: uneven
FAULTY = 0.6  # the same, beyond which a sensor is wrong without any command (a convention: 0.36 of its peers' thrust)
NEAR = 0.85  # of the peers' command, above which the rotor's command is usual
UNEVEN_ADVICE = (
    "log the motor commands, too: a load off the centre or a propeller that is bent or canted needs it, else the "
    "measurement is wrong"
)
DEAD_TIME = 0.5  # s without turning in flight


@dataclass(frozen=True)
class UnevenRotor:
    """A rotor whose mean measured speed is far from its peers'.

    share: of the peers' speed.
    as_commanded: whether its command is as far from theirs; None without commands.
    """

    rotor: int
    share: float
    as_commanded: bool | None


def uneven_rotors(segments: Sequence[Flight]) -> tuple[UnevenRotor, ...]:
    """Rotors whose measured speed is far from the others'. segments: of free flight."""
    if not segments or not segments[0].has("rotor_speed"):
        return ()
    speed = np.concatenate([segment["rotor_speed"] for segment in segments])
    command = next((np.concatenate([p[name] for p in segments]) for name in COMMAND if segments[0].has(name)), None)
    command_share = None if command is None or command.shape != speed.shape else _share_of_peers(command)
    return tuple(
        UnevenRotor(rotor, share, None if command_share is None else not NEAR < command_share[rotor] < 1 / NEAR)
        for rotor, share in enumerate(_share_of_peers(speed).tolist())
        if share < FAR_OFF or share > 1 / FAR_OFF
    )


def rotor_findings(segments: Sequence[Flight]) -> list[Finding]:
    """Speeds of single rotors that cannot be true. segments: of free flight."""
    if not segments or not segments[0].has("rotor_speed"):
        return []
    findings: list[Finding] = []
    every = uneven_rotors(segments)
    if sum(not uneven.as_commanded for uneven in every) > 1:
        return [_disagreement(segments)]
    for uneven in every:
        rotor, share = uneven.rotor, uneven.share
        if uneven.as_commanded:
            text = f"rotor {rotor} turns at {share:.2f} times the speed of its peers, as commanded"
            findings.append(Finding("warning", "uneven_rotor", text, "look for a bent propeller or a load off centre"))
            continue
        if uneven.as_commanded is None and FAULTY <= share <= 1 / FAULTY:
            text = f"rotor {rotor} reads {share:.2f} times the speed of its peers, and no command tells why"
            findings.append(Finding("warning", "uneven_rotor", text, UNEVEN_ADVICE))
            continue
        agree = "and no command explains it" if uneven.as_commanded is None else "while its command is as theirs"
        findings.append(_fault(rotor, f"reads {share:.2f} times the speed of its peers, {agree}"))
    return findings or _dropouts(segments)


def _disagreement(segments: Sequence[Flight]) -> Finding:
    """Several rotors that differ: of two against two no majority says which are wrong."""
    mean = _means(np.concatenate([segment["rotor_speed"] for segment in segments]))
    ratios = ", ".join(f"{share:.2f}" for share in mean / np.max(mean[np.isfinite(mean)]))
    return Finding(
        "error",
        "rotor_speed_fault",
        f"the rotors' speeds are in the ratio {ratios}, and no command explains it: several measurements are wrong, "
        "and no majority tells which",
        "compare the flight with its vehicle file, whose weight and moments tell which (`alula diagnose`); check the "
        "ESCs' telemetry, pole counts and mapping to the motors",
    )


def _fault(rotor: int, evidence: str) -> Finding:
    return Finding(
        "error",
        "rotor_speed_fault",
        f"rotor {rotor} {evidence}: its measurement is wrong, not the rotor",
        f"do not use rotor_speed_{rotor}; check the ESC's telemetry, its pole count and its mapping to the motor",
    )


def _dropouts(segments: Sequence[Flight]) -> list[Finding]:
    findings = []
    for rotor in range(segments[0]["rotor_speed"].shape[1]):
        dead = [
            (stop - start) * segment.period for segment in segments for start, stop in runs(_reads_zero(segment, rotor))
        ]
        if max(dead, default=0.0) > DEAD_TIME:
            findings.append(_fault(rotor, f"reads zero for {max(dead):.1f} s of flight"))
    return findings


def dropout_rows(flight: Flight) -> np.ndarray:
    """(n,) rows in which a rotor's measured speed is zero for a while although the others turn."""
    rows = np.zeros(len(flight), dtype=bool)
    for rotor in range(flight["rotor_speed"].shape[1]):
        for start, stop in runs(_reads_zero(flight, rotor)):
            if (stop - start) * flight.period > DEAD_TIME:
                rows[start:stop] = True
    return rows


def _reads_zero(flight: Flight, rotor: int) -> np.ndarray:
    speed = flight["rotor_speed"]
    others = np.delete(speed, rotor, axis=1)
    return np.asarray((speed[:, rotor] < 1.0) & (np.median(others, axis=1) > 50.0))


def _means(values: Floats) -> Floats:
    """Each column's mean size, NaN where it has no value. values: (n, k)."""
    columns = [np.abs(column[np.isfinite(column)]) for column in values.T]
    return np.array([column.mean() if len(column) else np.nan for column in columns])


def _share_of_peers(values: Floats) -> Floats:
    """Each column's mean over the median of the others' means; 1 where it is undefined."""
    mean = _means(values)
    peers = np.array([np.median(np.delete(mean, k)) if len(mean) > 1 else np.nan for k in range(len(mean))])
    valid = np.isfinite(mean) & np.isfinite(peers) & (peers > 0)
    return np.asarray(np.divide(mean, peers, out=np.ones_like(mean), where=valid))
