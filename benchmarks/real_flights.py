"""Diagnosis of real flights, some with known faults. Writes results/real_flights.md.

    python -m benchmarks.real_flights [--full FOLDER] [--statements]

The flights are the small copies that the tests use (tests/data, each with source and licence); with --full the whole
logs of the same sets in a folder of them, all nine flights of NanoBench among them. --statements: that section alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.provenance import write_result
from diagnosis.data.command_curve import CommandCurve, fit_command_curve
from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset, read_dataset
from diagnosis.data.segment import segments
from diagnosis.diagnose import DiagnosisDetails, diagnose_dataset
from diagnosis.estimation.evaluation import residuals
from diagnosis.hover_trim import read_trim
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError
from dynamics.state import VELOCITY
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.real_flights import SETS, diagnose, full_sets
from flights import Flight
from vehicles import FOLDER

DATA = Path(__file__).resolve().parents[1] / "tests" / "data"
MANUAL = DATA / "arpl_crazyflie" / "log10_cut.csv.gz"
LEE = [DATA / "crazyflie" / "log20.gz", *(DATA / "imrc_lee_crazyflie" / f"log{n}.gz" for n in ("54", "100", "136_2"))]
LEE_MASS = 0.037  # kg
TRIM = DATA / "crazypad_trim"
NORMAL = {"E8": ("normal_flight_E8_log00", "normal_flight_E8_log03"), "E9": ("normal_flight_E9_log00",)}
FAULTY = (
    ("tape_on_propeller_M3_E8_log00", "E8"),
    ("cut_propeller_M3_3mm_E8_log01", "E8"),
    ("cut_propeller_M3_3mm_E9_log00", "E9"),
    ("add_weight_W3_near_M3_E9_log02", "E9"),
)
REFUSED = (
    ("CrazyPAD, no gyro, no pitch", DATA / "crazyflie" / "E8_log00.gz", "crazyflie"),
    ("PX4, motors at 10 Hz", DATA / "px4_sih_offboard" / "offboard_hover_topics.ulg.gz", "px4_sih"),
    ("PX4 in hover, MAVLink telemetry", DATA / "px4_sih_offboard" / "offboard_hover.tlog.gz", "px4_sih"),
    ("PX4, ESC telemetry at 4 Hz", DATA / "pyulog_samples" / "sample_px4_events.ulg.gz", "px4_sih"),
)


def main() -> None:
    """Diagnose all of them and write the table."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--full", type=Path, help="folder with the whole logs")
    made.add_argument("--statements", action="store_true", help="what must be said and what must not, alone")
    options = made.parse_args()
    claims = "## What must be claims and what must not\n\n" + statements(options.full)
    if options.statements:
        write_result("real_statements", "Real flights as statements", claims)
        return
    crazyflie = read_vehicle(FOLDER / "crazyflie.toml")
    body = msgspec.structs.replace(crazyflie.body, mass=LEE_MASS)
    rotors = msgspec.structs.replace(crazyflie.rotors, speed_max=3300.0)
    upgraded = msgspec.structs.replace(crazyflie, body=body, rotors=rotors)
    parts = [
        claims,
        diagnosed("Crazyflie, manual flight, gyro, accelerometer and motor signals", [MANUAL], crazyflie),
        diagnosed("Crazyflie under a Lee controller, commanded thrust and torque", LEE, upgraded),
        lateral_drag(upgraded),
        "## CrazyPAD: hover trim against the same vehicle's normal flights\n\n" + trims(crazyflie),
        "## Logs that cannot answer\n\n" + refusals(),
    ]
    write_result("real_flights", "Diagnosis of real flights", "\n\n".join(parts))


def statements(full: Path | None) -> str:
    """A row for each statement about each set, and how many hold."""
    lines = ["| flights | answer | statement | holds |", "| --- | --- | --- | --- |"]
    held = count = 0
    for real in SETS if full is None else full_sets(full):
        answer = diagnose(real) if full is None else diagnose(real, full)
        for i, statement in enumerate(real.statements):
            holds = statement.holds(answer)
            held, count = held + holds, count + 1
            first = (real.name, str(answer).replace("|", "/")) if i == 0 else ("", "")
            lines.append(f"| {first[0]} | {first[1]} | {statement.text} | {'yes' if holds else '**no**'} |")
    return "\n".join([f"{held} of {count} statements hold.", "", *lines])


def diagnosed(title: str, logs: Sequence[Path], vehicle: Vehicle) -> str:
    """A section about one vehicle's flights."""
    dataset = read_dataset(list(logs), vehicle)
    findings = diagnose_dataset(dataset, vehicle, CATALOGUE)
    curve = command_curve(logs, vehicle)
    gains = [gain.mean for gain in curve.gains.values()]
    lines = [
        f"## {title}",
        "",
        f"{len(logs)} log{'s' if len(logs) > 1 else ''}, {sum(s.duration for s in dataset.everything):.0f} s. Thrust "
        f"over what the vehicle file makes of the commands: {min(gains):.2f} to {max(gains):.2f}; explained of the "
        f"vertical force: {curve.without_lag:.2f} without lag, {curve.explained:.2f} with {1e3 * curve.lag:.0f} ms. "
        f"Verdict: {findings.diagnosis.verdict}.",
        "",
        effects_table(findings),
        "",
        channels_table(findings),
    ]
    return "\n".join(lines)


def command_curve(logs: Sequence[Path], vehicle: Vehicle) -> CommandCurve:
    """The curve of all flights together."""
    return fit_command_curve([s for log in logs for s in segments(Flight.read(log), vehicle)], (), vehicle)


def effects_table(findings: DiagnosisDetails) -> str:
    """The named effects with 95 % intervals."""
    lines = ["| effect | values | resamples that agree | ambiguous with |", "| --- | --- | --- | --- |"]
    for effect in findings.diagnosis.effects:
        values = ", ".join(f"{n} {p.value:.3g} ± {1.96 * p.std:.1g} {p.unit}" for n, p in effect.parameters.items())
        rivals = ", ".join(effect.ambiguous_with) or "-"
        lines.append(f"| {effect.name} | {values} | {100 * effect.confidence:.0f} % | {rivals} |")
    return "\n".join(lines)


def channels_table(findings: DiagnosisDetails) -> str:
    """Held-out errors."""
    lines = ["| channel, held out | before | after | floor | unit |", "| --- | --- | --- | --- | --- |"]
    for kind, error in findings.diagnosis.channels.items():
        lines.append(f"| {kind} | {error.before:.3g} | {error.after:.3g} | {error.floor:.3g} | {error.unit} |")
    return "\n".join(lines)


def lateral_drag(vehicle: Vehicle) -> str:
    """Drag per mass along body x and y of each Lee-controller flight, by least squares on the pose's acceleration."""
    dataset: Dataset = read_dataset(list(LEE), vehicle)
    rows = residuals(vehicle, CATALOGUE, dataset.everything)
    lines = ["| flight | along | drag over mass, 1/s | share explained |", "| --- | --- | --- | --- |"]
    for segment, row in zip(dataset.everything, rows, strict=True):
        velocity = np.einsum("nji,nj->ni", segment.to_world, segment.smooth[:, VELOCITY])[segment.decimated]
        for axis in range(2):
            if np.std(velocity[:, axis]) < 0.2:
                continue
            columns = np.column_stack([-velocity[:, axis], np.ones(len(velocity))])
            acceleration = row[:, 3 + axis]
            theta = np.linalg.lstsq(columns, acceleration, rcond=None)[0]
            explained = 1 - np.var(acceleration - columns @ theta) / np.var(acceleration)
            lines.append(f"| {Path(segment.flight).name} | {'xy'[axis]} | {theta[0]:.3f} | {explained:.2f} |")
    return "\n".join(lines)


def trims(vehicle: Vehicle) -> str:
    """Each faulty flight against its vehicle's normal flights."""
    lines = [
        "| flight | normal flights | rotor 1 (motor 3): normal, now, still usual | verdict | weak_rotor loss |",
        "| --- | --- | --- | --- | --- |",
    ]
    cases = [*FAULTY, *((name, vehicle_of) for vehicle_of in ("E8",) for name in NORMAL[vehicle_of])]
    for name, of in cases:
        normal = [TRIM / f"{n}.csv.gz" for n in NORMAL[of] if n != name]
        trim = read_trim([TRIM / f"{name}.csv.gz"], normal, vehicle, None)
        rotor = trim.rotors[1]
        verdict = "nothing claimed"
        loss = "-"
        for effect in trim.effects:
            verdict = f"{effect.name} of rotor {effect.rotor} or {effect.ambiguous_with[0]}"
            value = effect.parameters["loss"]
            loss = f"{value.value:.2f} ± {1.96 * value.std:.2f}"
        shares = f"{rotor.normal:.3f}, {rotor.now:.3f}, {rotor.limit:.3f}"
        lines.append(f"| {name} | {len(normal)} | {shares} | {verdict} | {loss} |")
    return "\n".join(lines)


def refusals() -> str:
    """The messages for logs without a diagnosis."""
    lines = ["| log | exit code | message |", "| --- | --- | --- |"]
    for title, log, name in REFUSED:
        try:
            vehicle = read_vehicle(FOLDER / f"{name}.toml")
            require_answerable(read_dataset([log], vehicle).everything, vehicle)
        except AlulaError as error:
            message = str(error).replace(f"{log}", log.name)
            lines.append(f"| {title} | {error.exit_code} | {message} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
