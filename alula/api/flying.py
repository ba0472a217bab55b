"""Flights with a model in the controller: simulated in one process, or of a vehicle on a link."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from alula.api.planning import plan_flight
from alula.api.reference_file import planned_reference
from alula.api.signals import landing_on_signals
from alula.workbench import workbench
from dynamics.trust import approve_given

if TYPE_CHECKING:
    from dynamics.vehicle import EffectUse, Vehicle
    from runtime.control.verification import Verification
    from runtime.flight_request import FlightReport
    from simulation.lockstep import FlownReference


def simulate(
    reference: str,
    *,
    vehicle: Vehicle | str | Path | None = None,
    bundle: str | Path | None = None,
    hidden: Sequence[str | EffectUse] = (),
    effect_files: Sequence[str | Path] = (),
    duration: float | None = None,
    seed: int = 0,
) -> FlownReference:
    """Track a reference on a simulated vehicle in lockstep: simulated time, no link, the same bits for the same seed.

    reference: name, "NAME:speed=0.8,size=1.2,plane=yz,height=1,laps=3", a CSV file of your own, or what `plan_flight`
        takes, "identify:for=drag".
    vehicle: what `load_vehicle` returned, a vehicle file, or the name of a bundled one.
    bundle: folder of an exported model that flies, instead of a vehicle.
    hidden: effects of the simulated vehicle that the controller's model lacks: "name:key=value,...".
    effect_files: Python files with effects of your own, beside those that the vehicle names.
    duration: length of the reference, s; by default its own.
    seed: seed of sensors and gusts.

    Returns a FlownReference: `log` is what the vehicle would have logged, `truth` the ground truth.
    Raises RequestError for a reference that the vehicle cannot fly, VehicleError when it does not reach the start.

    Example:
        flown = alula.simulate("hover:laps=1", vehicle="arpl_250g", hidden=["rotor_drag:coefficient=4e-5"])
        print(flown.position_rmse, alula.Flight.from_log(flown.log).duration)
    """
    with workbench("alula.simulate"):
        from simulation.lockstep import fly_reference
    from dynamics.own_effects import catalogue_of
    from dynamics.references import check_feasibility, is_identification, named_reference
    from dynamics.vehicle_file import parse_effect, parse_vehicle
    from runtime.control.controller import Controller
    from runtime.flight_setup import exported_bundle, flown_vehicle_text, hovering_vehicle

    approve_given(effect_files)
    folder = None if bundle is None else Path(bundle)
    flying = parse_vehicle(flown_vehicle_text(_path_or_vehicle(vehicle), folder, effect_files))
    learned = exported_bundle(folder)
    trim = hovering_vehicle(flying)
    if is_identification(reference):
        path = plan_flight(flying, reference, trial=False).plan.reference
    else:
        path = named_reference(reference, trim, duration=duration)
    check_feasibility(path, trim).require()
    catalogue, count = catalogue_of(flying), flying.rotors.count
    uses = [parse_effect(use, count, catalogue=catalogue) if isinstance(use, str) else use for use in hidden]
    return fly_reference(
        flying,
        path,
        effects=uses,
        seed=seed,
        name=reference,
        controller=None if learned is None else Controller.from_bundle(learned),
        nominal=None if learned is None else Controller.fallback_from_bundle(learned),
    )


def fly(
    reference: str,
    *,
    vehicle: Vehicle | str | Path | None = None,
    bundle: str | Path | None = None,
    link: str = "udpin:127.0.0.1:14540",
    duration: float | None = None,
    height: float = 1.5,
    origin: Literal["takeoff", "estimate"] = "takeoff",
    rate: float | None = None,
    settings: Sequence[str] = (),
    effect_files: Sequence[str | Path] = (),
    adapt: Literal["off", "shadow", "on"] = "off",
    network: Literal["off", "shadow", "on"] | None = None,
    follow: Sequence[str] | None = None,
    record: str | Path | None = None,
    record_limit: int | None = None,
    last_setpoint: Literal["auto", "replace", "off"] = "auto",
    arm: bool = True,
    resume: bool = False,
    priority: int | None = None,
    processor: int | None = None,
    system: int | None = None,
    roaming: bool = False,
    signing_key: str | Path | None = None,
    timeout: float | None = None,
    announce: Callable[[str], None] = print,
) -> FlightReport:
    """Take off, track a reference with real-time MPC beside PX4, land.

    Called from the main thread, SIGINT and SIGTERM land the vehicle; a second one stops streaming at once.

    reference: as for `simulate`.
    vehicle: what `load_vehicle` returned, a vehicle file, or the name of a bundled one.
    bundle: folder of an exported model, instead of a vehicle.
    link: where the vehicle is: "udpin:", "udpout:", "tcp:", "tcpin:" or "serial:".
    duration: length of the reference, s; by default its own.
    height: of take-off, m.
    origin: of the reference's coordinates: "takeoff", where the vehicle stands, or "estimate", the estimator's zero.
    rate: of control, Hz; by default that of the vehicle's [controller].
    settings: of the controller, in place of the vehicle file's: "controller.horizon=0.8".
    effect_files: Python files with effects of your own, beside those that the vehicle names.
    adapt: whether the model follows in flight: "shadow" estimates and records what it would fly.
    follow: effects whose parameters follow, beside a disturbance; by default wind, rotor_drag and parasitic_drag where
        CasADi and a compiler are installed.
    network: whether the last layer of a learned model follows, too; by default "shadow", where its bundle can.
    record: folder for the recording (MCAP and tlog).
    record_limit: bytes of the recording, written in parts of which the oldest goes; by default all of the flight stays.
    last_setpoint: "replace" setpoints after which the vehicle would leave its box or hit the ground if this process
        died; "auto": unless the flight is planned with such setpoints.
    arm: arm the vehicle, or wait for the pilot to do so.
    resume: take control of a vehicle that is armed already.
    priority: of SCHED_FIFO, which `alula fly` sets to 50; all threads of this process become real-time ones in flight.
    processor: number of the processor that the control thread stays on.
    system: the vehicle's system id; by default that of the one vehicle on the link, and several are refused.
    roaming: let the vehicle continue from another address after 2 s of silence, as behind a modem.
    signing_key: file of the key under which all is signed, and nothing unsigned accepted; none by default.
    timeout: longest wait for the vehicle, s, 10 by default; with arm=False also for the pilot to arm, who has no limit
        by default.
    announce: called with a line for every event.

    Returns a FlightReport: `landed`, `completed`, tracking errors, timing, events, the recording.
    Raises RequestError for a flight that makes no sense, VehicleError for a vehicle that cannot be reached or engaged.

    Example:
        report = alula.fly("Lemniscate", vehicle="px4_sih", duration=20.0, record="recordings")
        print(report.completed, report.tracking.position_rmse)
    """
    from dynamics.references import is_identification
    from runtime.daemon import Daemon
    from runtime.flight_setup import FlightSetup, prepare_flight
    from simulation.flight_check import read_check

    approve_given(effect_files)
    if is_identification(reference):
        place = bundle if vehicle is None else vehicle
        planned = planned_reference(reference, place, effect_files=effect_files, duration=duration, folder=record)
        announce(planned.text)
        reference = planned.file
    setup = FlightSetup(
        link=link,
        vehicle=_path_or_vehicle(vehicle),
        bundle=None if bundle is None else Path(bundle),
        reference=reference,
        duration=duration,
        height=height,
        origin=origin,
        rate=rate,
        settings=tuple(settings),
        effect_files=tuple(map(Path, effect_files)),
        adapt=adapt,
        network=network,
        follow=None if follow is None else tuple(follow),
        record=None if record is None else Path(record),
        record_limit=record_limit,
        last_setpoint=last_setpoint,
        arm=arm,
        resume=resume,
        priority=priority,
        processor=processor,
        system=system,
        roaming=roaming,
        signing_key=None if signing_key is None else Path(signing_key),
        timeout=timeout,
    )
    flight = prepare_flight(setup)
    if flight.bundle is not None and (check := read_check(flight.bundle.folder)) is not None and check.warning:
        announce(f"warning: {check.warning}")
    daemon = Daemon(flight.request, flight.vehicle, flight.reference, announce, bundle=flight.bundle)
    with landing_on_signals(daemon.interrupt):
        return daemon.fly()


def verify(bundle: str | Path) -> Verification:
    """Repeat a bundle's recorded ticks with its kernels on this computer, and measure their time.

    bundle: folder of an exported model, such as one that was cross-compiled for this computer.

    Returns a Verification: `agreements` with the answers at the export, `timings`, `lines`; `require()` raises
    DataError where something does not hold.
    Raises RequestError for a bundle that is damaged, or built for another processor.

    Example:
        exported = alula.export("arpl_250g", "bundle", windows=50)
        alula.verify(exported.folder).require()
    """
    from runtime.control.bundle import read_bundle
    from runtime.control.verification import verify_bundle

    return verify_bundle(read_bundle(Path(bundle)))


def _path_or_vehicle(vehicle: Vehicle | str | Path | None) -> Vehicle | str | None:
    return str(vehicle) if isinstance(vehicle, Path) else vehicle
