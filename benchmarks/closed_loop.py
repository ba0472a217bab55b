"""Damping of controller, autopilot and vehicle in hover, for the files that `alula add` can write.

Each file flies on the vehicle that it describes, with the gains of an autopilot that was tuned for the file before the
first addition; then with motor lag, inertia, rate-loop gain and latency off by the ratios below, in all
combinations.
Linear poles (`runtime.control.closed_loop`); nothing is flown.

    python -m benchmarks.closed_loop      some minutes
"""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.provenance import write_result
from dynamics.rate_loop import autopilot_gains, modelled_motor_lag, rate_loop
from dynamics.vehicle import Vehicle
from fixtures.closed_loop_cases import MEETINGS, NOMINAL, VEHICLES, Meeting, bundled, files, oscillation


def row(name: str, added: str, versions: tuple[Vehicle, ...]) -> str:
    """Damping of a file as it states the vehicle, and the least over all meetings; gains read, and not."""
    owner, written = versions[0], versions[-1]
    gain = rate_loop(written, gains=autopilot_gains(owner)).tilt_speed
    as_stated = oscillation(written, written, owner)
    uncorrected = oscillation(owner, written, owner)
    blind = oscillation(written, written, owner, gains_read=False)
    lowest, where = worst(written, written, owner)
    before, _ = worst(owner, written, owner)
    lag = f"{1e3 * modelled_motor_lag(written.effects):.0f}"
    cells = [name, added, lag, f"{gain:.1f}", f"{uncorrected.damping:.2f}", f"{before:.2f}"]
    cells += [
        f"{as_stated.damping:.2f} at {as_stated.frequency:.1f} Hz",
        f"{blind.damping:.2f}",
        f"{lowest:.2f}",
        where,
    ]
    return f"| {' | '.join(cells)} |"


def worst(flown: Vehicle, real: Vehicle, owner: Vehicle) -> tuple[float, str]:
    """The least damping over all meetings, and where."""
    dampings = [(oscillation(flown, real, owner, meeting).damping, meeting) for meeting in MEETINGS]
    damping, meeting = min(dampings, key=lambda pair: pair[0])
    return damping, described(meeting)


def described(meeting: Meeting) -> str:
    latency = f" + {1e3 * meeting.latency:.0f} ms" if meeting.latency else ""
    return f"lag x {meeting.lag:g}, inertia x {meeting.inertia:g}, gain x {meeting.gain:g}{latency}"


def ratios(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in sorted(set(values)))


def main() -> None:
    body = [
        "| vehicle | added | lag of the file, ms | rate gain, 1/s | uncorrected file | its least | as stated "
        "| gains not read | least | where |",
        "| --- " * 10 + "|",
    ]
    body += [row(name, added, versions) for name in VEHICLES for added, versions in files(bundled(name)).items()]
    note = (
        f"Damping ratios of the least damped oscillation. Least: over {len(MEETINGS)} combinations of lag x "
        f"{ratios(m.lag for m in MEETINGS)}, inertia x {ratios(m.inertia for m in MEETINGS)}, rate gain x "
        f"{ratios(m.gain for m in MEETINGS)}, latency + {ratios(1e3 * m.latency for m in MEETINGS)} ms beyond the "
        f"usual {1e3 * NOMINAL.latency + 5:.0f} ms, the gains read over the link. A load's own swing, which no "
        "measurement shows and the loop does not damp, counts where it is less damped than by itself (0.01)."
    )
    write_result("closed_loop", "Damping of what `alula add` can write", "\n".join([*body, "", note]))


if __name__ == "__main__":
    main()
