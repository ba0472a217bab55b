"""Rotors against each other: one whose measured speed is far from its peers' while commands and motion are healthy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynamics.arrays import Floats
from flights.filters import runs
from flights.flight import Flight
from flights.quality.findings import Finding

FAR_OFF = 0.8  # of the peers' speed, below which no quadrotor flies with a rotor
NEAR = 0.85  # of the peers' command, above which the controller asks nothing unusual of it
DEAD_TIME = 0.5  # s without turning in flight

COMMANDS = ("rotor_speed_command", "rotor_thrust_command", "rotor_command")


def rotor_findings(pieces: Sequence[Flight]) -> list[Finding]:
    """Speeds of single rotors that cannot be true. pieces: segments of free flight."""
    if not pieces or not pieces[0].has("rotor_speed"):
        return []
    speed = np.concatenate([piece["rotor_speed"] for piece in pieces])
    asked = next((np.concatenate([p[name] for p in pieces]) for name in COMMANDS if pieces[0].has(name)), None)
    usual = _share_of_peers(speed)
    wanted = None if asked is None or asked.shape != speed.shape else _share_of_peers(asked)
    found = []
    for rotor, share in enumerate(usual.tolist()):
        if not (share < FAR_OFF or share > 1 / FAR_OFF):
            continue
        if wanted is not None and not NEAR < wanted[rotor] < 1 / NEAR:
            text = f"rotor {rotor} turns at {share:.2f} times the speed of its peers, as it is told to"
            found.append(Finding("warning", "uneven_rotor", text, "look for a bent propeller or a load off centre"))
            continue
        agree = "and no command explains it" if wanted is None else "while its command is as theirs"
        found.append(_fault(rotor, f"reads {share:.2f} times the speed of its peers, {agree}"))
    return found or _dropouts(pieces)


def _fault(rotor: int, seen: str) -> Finding:
    return Finding(
        "error", "rotor_speed_fault", f"rotor {rotor} {seen}: its measurement is wrong, not the rotor",
        f"do not use rotor_speed_{rotor}; check the ESC's telemetry, its pole count and its mapping to the motor",
    )  # fmt: skip


def _dropouts(pieces: Sequence[Flight]) -> list[Finding]:
    found = []
    for rotor in range(pieces[0]["rotor_speed"].shape[1]):
        dead = [(stop - start) * piece.period for piece in pieces for start, stop in runs(_dead(piece, rotor))]
        if max(dead, default=0.0) > DEAD_TIME:
            found.append(_fault(rotor, f"reads zero for {max(dead):.1f} s of flight"))
    return found


def _dead(piece: Flight, rotor: int) -> np.ndarray:
    speed = piece["rotor_speed"]
    others = np.delete(speed, rotor, axis=1)
    return np.asarray((speed[:, rotor] < 1.0) & (np.median(others, axis=1) > 50.0))


def _share_of_peers(values: Floats) -> Floats:
    """Each column's mean over the median of the others' means; 1 where nothing is known."""
    columns = [np.abs(column[np.isfinite(column)]) for column in values.T]
    mean = np.array([column.mean() if len(column) else np.nan for column in columns])
    peers = np.array([np.median(np.delete(mean, k)) if len(mean) > 1 else np.nan for k in range(len(mean))])
    known = np.isfinite(mean) & np.isfinite(peers) & (peers > 0)
    return np.asarray(np.divide(mean, peers, out=np.ones_like(mean), where=known))
