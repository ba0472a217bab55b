"""Margin of healthy models to the limits at which an oscillating model is replaced, and flights of oscillating ones.

Three brisk manoeuvres in lockstep on the vehicle with the campaign's hidden effects: the nominal model and every
bundled trained model, with the usual noise on gyro and estimate and with multiples of it. Of each flight: the maximum
running means of the setpoints' second difference from tick to tick (turns back) and of the body rates' error against
them (missed), while the reference was tracked; how often and how long physics flew; the error.

    python -m benchmarks.oscillation [--noise 1,2]
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.provenance import write_result
from dynamics.references import named_reference
from dynamics.references.campaign import REAL_WORLD
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from export.bundle import ExportOptions, export_bundle
from export.trained import read_model
from runtime.control.controller import Controller
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from runtime.flight.events import Event
from runtime.flight.health import FlightHealth, HealthLimits
from runtime.flight_setup import exported_bundle
from simulation.lockstep import FlownReference, fly_reference
from sitl_mock.vehicle.sensors import SensorErrors
from sitl_mock.vehicle.vehicle import VehicleOptions

VEHICLE = "arpl_250g"
MODELS = ("nominal", "grey_box", "pi_tcn", "pi_mlp", "res_tcn", "mse_tcn")
MANOEUVRES = ("Lemniscate", "TransposedParabola", "ExtendedLemniscate")
DURATION = 15.0  # s
SHAKEN = ("gyro", "position", "velocity", "tilt", "yaw")  # what a controller sees of a vehicle's errors
AGE = SensorErrors().delay  # s
WINDOWS = 20  # of the parity proof, which is not what is measured here


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--noise", default="1,2", help="factors on the usual noise of gyro and estimate")
    factors = [float(text) for text in parser.parse_args().noise.split(",")]
    body = read_vehicle(find_vehicle(VEHICLE))
    with tempfile.TemporaryDirectory() as folder:
        lines = [
            _row(body, model, manoeuvre, noise, Path(folder))
            for model in MODELS
            for noise in factors
            for manoeuvre in MANOEUVRES
        ]
    write_result("oscillation", "How far from oscillating models fly", "\n".join([*_head(), *lines]))


def _head() -> list[str]:
    limits = HealthLimits()
    return [
        f"{DURATION:g} s of each in lockstep. Greatest running mean over {limits.swing_time:g} s, rad/s; a learned "
        f"model is left beyond {limits.chatter:g} of turning back, or {limits.swing:g} of missed body rates.",
        "",
        "| model | sensor noise | manoeuvre | turns back | missed | left | physics flew | error | ended |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]


def _controllers(model: str, folder: Path) -> tuple[Controller, Controller | None]:
    path = find_vehicle(VEHICLE)
    if model == "nominal":
        return Controller.build(read_vehicle(path)), None
    if not (folder / model).exists():
        options = ExportOptions(Problem(), native_processor(), windows=WINDOWS)
        export_bundle(read_model(path.with_suffix(f".{model}.pt")), folder / model, options)
    bundle = exported_bundle(folder / model)
    assert bundle is not None
    return Controller.from_bundle(bundle), Controller.fallback_from_bundle(bundle)


def _row(body: Vehicle, model: str, manoeuvre: str, noise: float, folder: Path) -> str:
    controller, nominal = _controllers(model, folder)
    usual = SensorErrors()
    sensors = dataclasses.replace(usual, **{name: noise * getattr(usual, name) for name in SHAKEN})
    flown = fly_reference(
        body,
        named_reference(manoeuvre, controller.trim, duration=DURATION),
        options=VehicleOptions(sensors=sensors),
        effects=[parse_effect(text, body.rotors.count) for text in REAL_WORLD],
        controller=controller,
        nominal=nominal,
    )
    chatter, swing = _greatest(body, flown)
    left = flown.events.get(Event.MODEL_OSCILLATES.value, 0)
    share = flown.fallback_seconds / flown.seconds if flown.seconds else 1.0
    row = (
        f"| {model} | {noise:g} | {manoeuvre} | {chatter:.2f} | {swing:.2f} | {left} | {share:.0%} | "
        f"{100 * flown.position_rmse:.1f} cm | {flown.aborted} |"
    )
    print(row, flush=True)
    return row


def _greatest(body: Vehicle, flown: FlownReference) -> tuple[float, float]:
    """Maximum running means, from the log's setpoints and gyro, the latter delayed like an estimate."""
    rate_setpoint, gyro = flown.log.stream("rate_setpoint"), flown.log.stream("rate")
    if rate_setpoint is None or gyro is None:
        return float("nan"), float("nan")
    health, state, peaks = FlightHealth(body), np.zeros(13), [(0.0, 0.0)]
    for time, setpoint in zip(rate_setpoint.time, rate_setpoint.values, strict=True):
        health.sent(setpoint, 0.0, float(time))
        state[10:13] = gyro.values[min(int(np.searchsorted(gyro.time, time - AGE)), len(gyro.time) - 1)]
        health.flight(state, float(time))
        peaks.append(health.oscillation)
    chatter, swing = np.max(peaks, axis=0)
    return float(chatter), float(swing)


if __name__ == "__main__":
    main()
