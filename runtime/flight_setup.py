"""The preparation of a flight from the user's options, or from a recording: vehicle, reference, request."""

from __future__ import annotations

import hashlib
import sys
import tempfile
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import msgspec

from dynamics import symbolic
from dynamics.codegen import has_compiler
from dynamics.command import command_line
from dynamics.decoding import decode_json
from dynamics.effect_source import (
    EffectFile,
    as_carried,
    carried_files,
    effect_file,
    read_effect_file,
    without_duplicates,
)
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError, RequestError
from dynamics.references import Reference, check_feasibility, named_reference
from dynamics.signing_key import read_signing_key
from dynamics.trust import require_approved
from dynamics.unpacking import read_packed
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import (
    effect_entries,
    effect_files_in,
    find_vehicle,
    parse_vehicle,
    vehicle_text,
    vehicle_toml,
    with_added_files,
    with_settings,
    with_texts,
)
from dynamics.version import __version__
from runtime.control.adaptation_settings import AdaptationSettings, Mode, NetworkSettings
from runtime.control.bundle import MANIFEST, ONNX, VEHICLE, Bundle, Manifest, parse_manifest, read_bundle
from runtime.control.followed_parameters import with_followed
from runtime.control.kernel_model import KernelModel, trim_of
from runtime.control.rti.prebuilt import flown_model
from runtime.flight.decision import FlyerSettings, LastSetpointMode
from runtime.flight.engagement import EngagementSettings
from runtime.flight.failsafe import FallbackBounds
from runtime.flight.health import HealthLimits
from runtime.flight.mission import Origin, Plan
from runtime.flight_request import FlightRequest
from runtime.link.connection import parse_endpoint
from runtime.record.parts import MIN_LIMIT
from runtime.record.recording import FlightRecording

SHIFTED_TIME = 0.1  # s of the shifted solution
VEHICLE_TIMEOUT = 10.0  # s to wait for the vehicle
FOLLOWED = tuple(name for name, effect in CATALOGUE.items() if effect.followed)
LIBRARIES = ("numpy", "casadi", "pymavlink", "msgspec", "mcap")
VEHICLE_TEXT, REFERENCE_TEXT = "vehicle.toml", "reference.csv"  # attachments of a recording
EFFECT_FOLDER = "effects/"  # before the names of effect files among them


class FlightSetup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The user's options of a flight, unchecked; see `alula fly`.

    link: endpoint of the vehicle.
    reference: name or CSV file.
    vehicle: file, name of a bundled one, or the vehicle itself.
    bundle: folder of an exported model, instead of the vehicle.
    duration: s of the reference; its own where left out.
    height: of take-off, m.
    origin: of the reference's coordinates: the place of take-off, or the estimator's own zero.
    rate: control rate, Hz; that of the vehicle's [controller] where left out.
    effect_files: with effects of the user's own, beside those that the vehicle names.
    settings: of the controller, in place of the vehicle file's, such as "controller.horizon=0.8".
    adapt: whether the model follows in flight.
    follow: effects whose parameters do, beside a disturbance; None for the usual ones, as far as this install can.
    network: whether a learned model's last layer does; None for shadow, where its bundle can.
    record: folder of the recording.
    record_limit: bytes of the recording, of which the oldest part goes; None for all of the flight.
    last_setpoint: whether setpoints that must not be the last ones are replaced.
    arm: whether to request arming, or leave it to the pilot.
    resume: whether to take control of a vehicle that is armed already.
    priority: of SCHED_FIFO, None for none.
    processor: that the control thread stays on.
    system: the vehicle's system id, None for the one on the link.
    roaming: whether the vehicle may continue from another address after a silence.
    signing_key: file of the key under which the link is signed, None for an unsigned one.
    timeout: s to wait for the vehicle, and for a pilot who is to arm; left out, the pilot has no limit.
    """

    link: str
    reference: str
    vehicle: str | Vehicle | None = None
    bundle: Path | None = None
    duration: float | None = None
    height: float = 1.5
    origin: Origin = "takeoff"
    rate: float | None = None
    effect_files: tuple[Path, ...] = ()
    settings: tuple[str, ...] = ()
    adapt: Mode = "off"
    follow: tuple[str, ...] | None = None
    network: Mode | None = None
    record: Path | None = None
    record_limit: int | None = None
    last_setpoint: LastSetpointMode = "auto"
    arm: bool = True
    resume: bool = False
    priority: int | None = None
    processor: int | None = None
    system: int | None = None
    roaming: bool = False
    signing_key: Path | None = None
    timeout: float | None = None


class PreparedFlight(msgspec.Struct, frozen=True):
    """The daemon's arguments; the vehicle can fly the reference."""

    request: FlightRequest
    vehicle: Vehicle
    reference: Reference
    bundle: Bundle | None = None


def prepare_flight(setup: FlightSetup, *, flown_before: bool = False) -> PreparedFlight:
    """Read and check everything that a flight needs. Raises RequestError for what is invalid or cannot be flown.

    flown_before: the vehicle has flown this already, whatever the limits in its file.
    """
    endpoint = parse_endpoint(setup.link)
    text = flown_vehicle_text(setup.vehicle, setup.bundle, setup.effect_files)
    bundle = exported_bundle(setup.bundle)
    vehicle = parse_vehicle(text)
    if setup.settings:
        vehicle = with_settings(vehicle, setup.settings)
        text = vehicle_toml(vehicle)
    rate = setup.rate or vehicle.controller.rate
    _check_controller(setup, vehicle, bundle, rate)
    trim = hovering_vehicle(vehicle, None if bundle is None else bundle.manifest)
    reference = named_reference(setup.reference, trim, duration=setup.duration)
    if not flown_before:
        # the box is checked from the place of take-off, which only the vehicle knows
        anywhere = msgspec.structs.replace(trim, limits=msgspec.structs.replace(trim.limits, box=None))
        check_feasibility(reference, anywhere if setup.origin == "takeoff" else trim).require()
    if vehicle.effect_files:
        text = with_texts(text, as_carried(vehicle.effect_files))
    attachments = {VEHICLE_TEXT: text, **_effect_texts(vehicle)}
    if bundle is not None:
        attachments[MANIFEST] = (bundle.folder / MANIFEST).read_text(encoding="utf-8")
    if Path(setup.reference).is_file():
        attachments[REFERENCE_TEXT] = _table_text(Path(setup.reference))
    adaptation = AdaptationSettings(
        mode=setup.adapt,
        follow=_followed(setup, vehicle, bundle),
        network=NetworkSettings(mode=_network_mode(setup, bundle)),
    )
    request = FlightRequest(
        endpoint=endpoint,
        adaptation=adaptation,
        rate=rate,
        plan=Plan(height=setup.height, duration=setup.duration, origin=setup.origin),
        settings=FlyerSettings(
            engagement=EngagementSettings(arm=setup.arm, resume=setup.resume, pilot_patience=setup.timeout),
            bounds=FallbackBounds(shifted_ticks=max(round(SHIFTED_TIME * rate), 1)),
            health=HealthLimits.for_vehicle(vehicle),
            last_setpoint=setup.last_setpoint,
        ),
        record=setup.record,
        record_limit=_record_limit(setup),
        system=setup.system,
        roaming=setup.roaming,
        signing_key=None if setup.signing_key is None else read_signing_key(setup.signing_key),
        timeout=VEHICLE_TIMEOUT if setup.timeout is None else setup.timeout,
        priority=setup.priority,
        processor=setup.processor,
        metadata=_metadata(setup, attachments),
        attachments=attachments,
    )
    return PreparedFlight(request, vehicle, reference, bundle)


def _record_limit(setup: FlightSetup) -> int | None:
    """The limit of the recording, bytes. Raises RequestError for one without a recording, or too small."""
    limit = setup.record_limit
    if limit is not None and setup.record is None:
        raise RequestError("--record-limit bounds a recording, and there is none: give --record DIR as well.")
    if limit is not None and limit < MIN_LIMIT:
        raise RequestError(
            f"--record-limit is {limit / 1e6:g} MB; at least {MIN_LIMIT / 1e6:g} MB are needed, for half a minute."
        )
    return limit


def _followed(setup: FlightSetup, vehicle: Vehicle, bundle: Bundle | None) -> tuple[str, ...]:
    """Effects whose parameters follow. Raises RequestError for names that cannot, or without --adapt."""
    if setup.adapt == "off":
        if setup.follow:
            raise RequestError(f"--follow {setup.follow[0]} needs --adapt shadow or --adapt on.")
        return ()
    if bundle is not None:  # its kernel has the effects of its vehicle file and no others
        there = {use.name for use in vehicle.effects}
        if lacking := set(setup.follow or ()) - there:
            raise RequestError(
                f"{', '.join(sorted(lacking))} cannot be followed: {bundle.folder} is without. Export it with "
                "a vehicle file that has the effect, at its neutral value if nothing is known of it."
            )
        return tuple(name for name in (setup.follow or FOLLOWED) if name in there)
    if setup.follow is None:
        return FOLLOWED if symbolic.is_installed() and has_compiler() else ()
    with_followed(vehicle, setup.follow)
    return setup.follow


def _network_mode(setup: FlightSetup, bundle: Bundle | None) -> Mode:
    """Whether the last layer follows. Raises RequestError where it cannot, or the model beside it does not."""
    able = bundle is not None and bundle.last_layer is not None
    if setup.network in (None, "off") or (setup.network == setup.adapt == "shadow" and able):
        return setup.network or ("shadow" if able else "off")
    if not able:
        what = "has no network" if bundle is None or not bundle.manifest.learned else "was trained without its moments"
        name = setup.bundle or setup.vehicle
        raise RequestError(
            f"--network {setup.network}: {name} {what}. Leave it out, or give a --bundle of a model that this alula "
            "trained, or to which `python -m training.last_layer MODEL.pt LOG...` added them, exported again."
        )
    if setup.adapt == "off" or (setup.network == "on" and setup.adapt != "on"):
        raise RequestError(
            f"--network {setup.network} needs --adapt {setup.network if setup.adapt == 'off' else 'on'}."
        )
    return setup.network


def _check_controller(setup: FlightSetup, vehicle: Vehicle, bundle: Bundle | None, rate: float) -> None:
    """Raises RequestError for a rate that the controller cannot fly, or a horizon that is not the bundle's kernel's."""
    msgspec.structs.replace(vehicle.controller, rate=rate)  # its constructor refuses what cannot be flown
    if bundle is None:
        return
    for name in ("nodes", "horizon", "growth"):
        value, compiled = getattr(vehicle.controller, name), getattr(bundle.manifest.problem, name)
        if value != compiled and any(text.startswith(f"controller.{name}") for text in setup.settings):
            raise RequestError(
                f"controller.{name} = {value:g}, but the kernel in {bundle.folder} was compiled for {compiled:g}: "
                "leave it out, or export the model again with it."
            )


def hovering_vehicle(vehicle: Vehicle, manifest: Manifest | None = None) -> Vehicle:
    """The vehicle without effects that has the mass and thrust constant of the vehicle's model in hover.

    manifest: of a bundle with this vehicle file. Raises RequestError where the model needs CasADi, which is not there.
    """
    model = flown_model(vehicle) if manifest is None else KernelModel.of(vehicle, manifest.vehicle_facts)
    return trim_of(model).vehicle


def exported_bundle(folder: Path | None) -> Bundle | None:
    """A bundle of `alula export`, None for a folder with a vehicle file alone. Raises RequestError for a bad one."""
    if folder is None or not any((folder / name).exists() for name in (MANIFEST, ONNX)):
        return None
    return read_bundle(folder)


def flown_vehicle_text(
    vehicle: str | Vehicle | None, bundle: Path | None, effect_files: Sequence[str | Path] = ()
) -> str:
    """The text of the vehicle file with the texts of its effect files.

    Raises RequestError unless exactly one of the two is given and can be read, or for effects that are not approved.
    """
    if vehicle is not None and bundle is not None:
        name = vehicle.name if isinstance(vehicle, Vehicle) else vehicle
        raise RequestError(
            f"{bundle} has its own vehicle file, which its model was trained with: leave --vehicle {name} out, or "
            "train and export the model for that vehicle."
        )
    if vehicle is None and bundle is None:
        raise RequestError("nothing to fly: give either --vehicle V.toml or --bundle B.")
    if isinstance(vehicle, Vehicle):
        return vehicle_toml(with_added_files(vehicle, effect_files))
    path = bundle / VEHICLE if bundle is not None else find_vehicle(vehicle or "")
    if bundle is not None and not path.is_file():
        raise RequestError(f"{bundle} is no bundle: it has no {VEHICLE}. Give a folder that `alula export` wrote.")
    exported_bundle(bundle)  # whose approval is that of its effects
    text = vehicle_text(path, effect_files=effect_files)
    require_approved(effect_files_in(text), carrier=path)
    return text


def _effect_texts(vehicle: Vehicle) -> dict[str, str]:
    """The vehicle's effect files by the names that a recording keeps them under, to be read."""
    return {f"{EFFECT_FOLDER}{file.name}": file.text for file in vehicle.effect_files}


def recorded_flight(
    recording: FlightRecording, vehicle: str | None, bundle: Path | None, effect_files: Sequence[str | Path] = ()
) -> tuple[Vehicle, Reference, Bundle | None]:
    """Vehicle, reference and bundle of a recording. vehicle, bundle: to fly instead of the recorded vehicle.
    effect_files: in place of those that were flown, or beside those of the other vehicle.

    Raises DataError when it does not hold them, or was flown by a bundle and neither that nor a vehicle is given.
    """
    parts = {
        "vehicle": VEHICLE_TEXT in recording.attachments,
        "reference": "reference" in recording.metadata,
        "plan": "plan" in recording.metadata,
    }
    if missing := [part for part, there in parts.items() if not there]:
        raise DataError(
            f"{recording.path} holds no {' and no '.join(missing)}: `alula fly` did not write it, or not all."
        )
    replaced = vehicle is not None or bundle is not None
    recorded = _recorded_vehicle(recording, () if replaced else effect_files)
    trim = hovering_vehicle(recorded, _recorded_manifest(recording))
    duration = decode_json(recording.metadata["plan"], Plan).duration
    # the reference is that of the recorded vehicle, whatever vehicle flies it now
    if (table := recording.attachments.get(REFERENCE_TEXT)) is None:
        reference = named_reference(recording.metadata["reference"], trim, duration=duration)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / REFERENCE_TEXT
            path.write_text(table, encoding="utf-8")
            reference = named_reference(str(path), trim, duration=duration)
    if not replaced and MANIFEST in recording.attachments:
        raise DataError(
            f"{recording.path} was flown by an exported model: give its bundle with --bundle, or fly it with the "
            "model of a vehicle file with --vehicle."
        )
    flown = parse_vehicle(flown_vehicle_text(vehicle, bundle, effect_files)) if replaced else recorded
    return flown, reference, exported_bundle(bundle)


def _recorded_manifest(recording: FlightRecording) -> Manifest | None:
    """The manifest of the bundle that flew; None without one, or for one of another version."""
    text = recording.attachments.get(MANIFEST)
    try:
        return None if text is None else parse_manifest(text)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None


def _recorded_vehicle(recording: FlightRecording, effect_files: Sequence[str | Path]) -> Vehicle:
    """The vehicle that a recording holds, with other effect files where some are given.

    Raises DataError where one of these is another than at the flight, RequestError for effects that the user has not
    approved: the recording's own texts are data.
    """
    flown = recorded_effect_files(recording)
    further = [read_effect_file(path) for path in effect_files]
    for file in further:
        flown_so = {other.sha256 for other in flown if other.name == file.name}
        if flown_so and file.sha256 not in flown_so:
            raise DataError(
                f"{recording.path} was flown with another {file.name}: the recording holds it as the attachment "
                f"{EFFECT_FOLDER}{file.name}. Put that back, or give it with --effects."
            )
    files = further or flown
    if not files and (entries := effect_entries(recording.attachments[VEHICLE_TEXT])):
        raise RequestError(f"{recording.path} names {entries[0]} and does not hold it. Give it with --effects.")
    require_approved(files, carrier=recording.path)
    return parse_vehicle(with_texts(recording.attachments[VEHICLE_TEXT], files))


def recorded_effect_files(recording: FlightRecording) -> list[EffectFile]:
    """The effect files whose texts a recording carries; none are run.

    Recordings of earlier versions name them by their whole paths, which are not opened: the text is an attachment.
    """
    entries = effect_entries(recording.attachments.get(VEHICLE_TEXT, ""))
    names = [Path(entry).name for entry in entries if isinstance(entry, str)]
    texts = {name: recording.attachments.get(f"{EFFECT_FOLDER}{name}") for name in names}
    attached = [effect_file(name, text) for name, text in texts.items() if text is not None]
    return without_duplicates([*as_carried(carried_files(entries)), *attached])


def _table_text(path: Path) -> str:
    return read_packed(path).decode()


def _metadata(setup: FlightSetup, attachments: dict[str, str]) -> dict[str, str]:
    hashes = {f"sha256 of {name}": hashlib.sha256(text.encode()).hexdigest() for name, text in attachments.items()}
    versions = {f"version of {name}": version for name in LIBRARIES if (version := _version(name))}
    return {
        "command": command_line(),
        "reference": setup.reference,
        "seed": "none, nothing in the daemon is random",
        "version": __version__,
        "python": sys.version.split()[0],
        **versions,
        **hashes,
    }


def _version(library: str) -> str:
    """Of an installed library, empty where it is not: a bundle flies without CasADi."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return ""
