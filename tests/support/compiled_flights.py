"""Flights of any effect in a second: a rigid body, its effects and a geometric controller as machine code.

The physics is that of `dynamics`, so these flights test how diagnosis decides, not whether a formula is right; that is
what RotorPy's flights are for. Integration (RK4, 1 kHz), controller (500 Hz), turbulence of the rotors and sensors are
unlike the mock's. Lee, Leok, McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), CDC 2010.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.codegen import CompiledFunction, compile_functions
from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Values
from dynamics.effects import CATALOGUE
from dynamics.integrators import rk4, with_unit_attitude
from dynamics.model import RIGID_BODY_STATES, Model, build_model
from dynamics.references import named_reference
from dynamics.references.flatness import ReferenceSamples
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle
from flights import Flight
from tests.support.planted import MANOEUVRES
from tests.support.rotorpy_sensors import EXTRA, Sensors, as_flight, wandering

Floats = NDArray[np.float64]

STEP, HELD, KEPT = 0.001, 2, 4  # s; steps that a command is held; steps between rows
DURATION = 12.0  # s at most
MOTOR_LAG = 0.03  # s, where speeds are logged
TURBULENCE, TURBULENCE_TIME = 0.004, 0.05  # share of a rotor's thrust, s
POSITION_GAIN, VELOCITY_GAIN, ATTITUDE_GAIN, RATE_GAIN = 6.0, 4.0, 180.0, 22.0
FULL, EMPTY = 8.35, 7.0  # V at the beginning of the first flight and the end of the last
READ_WRONG = ("imu_bias", "gyro_bias", "time_delay", "rotor_speed_fault")  # made by the sensors


def _flickering(body: Physics, p: Values, _: Environment, __: int | None) -> Physics:
    share = ca.vertcat(*[p[f"rotor_{i}"] for i in range(body.rotor_count)])
    return replace(body, thrust_constant=body.thrust_constant * share)


FLICKER = Effect(
    "flicker",
    "Turbulence: each rotor's thrust comes and goes",
    "coloured noise",
    tuple(Parameter(f"rotor_{i}", "1", "share of thrust", 0, 2, lambda _: Prior(1, 0), neutral=1.0) for i in range(4)),
    physics=_flickering,
)


@dataclass(frozen=True, eq=False)
class _Code:
    model: Model
    control: CompiledFunction
    plant: CompiledFunction


def compiled_flights(
    vehicle: Vehicle,
    effects: Sequence[EffectUse] = (),
    *,
    catalogue: Mapping[str, Effect],
    seed: int,
    noise: float = 1.0,
    commands: bool = False,
    manoeuvres: Sequence[str] = MANOEUVRES,
) -> list[Flight]:
    """One flight of each manoeuvre on a vehicle that hides effects of a catalogue from its file.

    noise: factor on what sensors and turbulence add. commands: log what the motors were told instead of their speed.
    """
    faults = [use for use in effects if use.name in READ_WRONG]
    moving = [use for use in effects if use.name not in READ_WRONG]
    if not commands:
        moving.append(EffectUse("motor_lag", {"time_constant": MOTOR_LAG}))
    named = tuple((use.name, use.rotor) for use in moving)
    code = _code(vehicle.name, named, tuple({**CATALOGUE, **catalogue}[name] for name, _ in named))
    p = code.model.parameter_values.copy()
    for use in moving:
        key = use.name if use.rotor is None else f"{use.name}[{use.rotor}]"
        for name, value in use.parameters.items():
            p[code.model.parameter_index(f"{key}.{name}")] = value
    flights = []
    for i, text in enumerate(manoeuvres):
        random = np.random.default_rng([seed, i])
        share = np.array([i, i + 1]) / len(manoeuvres)
        true = _fly(code, vehicle, text, p, share, noise, random)
        sensors = Sensors.drawn(noise, random, faults)
        flight = as_flight(true, sensors, f"flight_{i}.csv", commands=commands, random=random)
        at = np.interp(flight.time, true["time"], true["voltage"]) + 0.02 * random.standard_normal(len(flight))
        flights.append(with_column(flight, "battery_voltage", np.round(at, 2)))
    return flights


def with_column(flight: Flight, name: str, values: Floats) -> Flight:
    """The flight with one more column."""
    columns = {**flight.columns, name: values}
    return Flight(flight.time, columns, flight.provenance, flight.origins, flight.parameters, flight.metadata)


@cache
def _code(vehicle_name: str, moving: tuple[tuple[str, int | None], ...], effects: tuple[Effect, ...]) -> _Code:
    from dynamics.vehicle_file import read_vehicle
    from vehicles import FOLDER

    vehicle = read_vehicle(FOLDER / f"{vehicle_name}.toml")
    catalogue = {e.name: e for e in (*effects, FLICKER)}
    uses = [EffectUse(n, {}, rotor) for n, rotor in (*moving, ("flicker", None))]
    model = build_model(vehicle, effects=uses, catalogue=catalogue)
    code = compile_functions([_control(vehicle), _plant(model)])
    return _Code(model, code["control"], code["plant"])


def _control(vehicle: Vehicle) -> ca.Function:
    """(state, wanted) -> commanded rotor speeds. wanted: position, velocity, acceleration (world), yaw, its rate."""
    x, wanted = ca.SX.sym("x", RIGID_BODY_STATES), ca.SX.sym("wanted", 11)
    pull = POSITION_GAIN * (wanted[0:3] - x[0:3]) + VELOCITY_GAIN * (wanted[3:6] - x[3:6]) + wanted[6:9]
    force = pull + ca.vertcat(0, 0, GRAVITY)
    axis = force / ca.norm_2(force)
    left = ca.cross(axis, ca.vertcat(ca.cos(wanted[9]), ca.sin(wanted[9]), 0))
    left = left / ca.norm_2(left)
    desired = ca.horzcat(ca.cross(left, axis), left, axis)
    turn = quaternion.rotation_matrix(x[6:10])
    off = desired.T @ turn
    error = ca.vertcat(off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]) / 2
    rate = x[10:13]
    inertia = ca.DM(vehicle.body.inertia)
    slower = ca.vertcat(1, 1, 0.3)  # yaw has little authority
    turning = -slower * (ATTITUDE_GAIN * error + RATE_GAIN * (rate - turn.T @ ca.vertcat(0, 0, wanted[10])))
    moment = inertia * turning + ca.cross(rate, inertia * rate)
    thrust = vehicle.body.mass * ca.dot(force, turn[:, 2])
    squares = ca.DM(np.linalg.pinv(vehicle.rotors.allocation)) @ ca.vertcat(thrust, moment)
    low, high = (0.15 * vehicle.hover_speed) ** 2, vehicle.rotors.speed_max**2
    speed = ca.sqrt(ca.fmin(ca.fmax(squares, low), high))
    return ca.Function("control", [x, wanted], [ca.densify(speed)], ["x", "wanted"], ["command"])


def _plant(model: Model) -> ca.Function:
    """One millisecond: (state, command, p, e, w) -> the same later, specific force, rotor speeds."""
    x, command = ca.SX.sym("x", model.state_count), ca.SX.sym("command", model.input_count)
    p, e, w = ca.SX.sym("p", len(model.parameter_names)), ca.SX.sym("e", 2), ca.SX.sym("w", model.hidden_count)
    after = with_unit_attitude(rk4(lambda state: model.derivative(state, command, p, e, w), x, STEP))
    force, _, turning = model.observe(x, command, p, e)
    outputs = [ca.densify(value) for value in (after, force, turning)]
    names = ["x", "command", "p", "e", "w"]
    return ca.Function("plant", [x, command, p, e, w], outputs, names, ["after", "force", "turning"])


def _fly(
    code: _Code, vehicle: Vehicle, manoeuvre: str, p: Floats, battery: Floats, noise: float,
    random: np.random.Generator,
) -> dict[str, Floats]:  # fmt: skip
    """What was true every 4 ms, by RotorPy's names. battery: share of its charge used at the beginning and the end."""
    reference = named_reference(manoeuvre, vehicle)
    length = min(DURATION, reference.duration) + 2 * EXTRA
    steps = round(length / STEP) // KEPT * KEPT
    wanted = _wanted(reference.sample(np.arange(0, steps, HELD) * STEP - EXTRA))
    flicker = noise * TURBULENCE * wandering(steps // HELD, HELD * STEP / TURBULENCE_TIME, random, 4)
    white = random.standard_normal((steps // HELD, code.model.hidden_count)) / np.sqrt(HELD * STEP)
    used = np.linspace(*battery, steps)
    x = code.model.initial_state(reference.states(np.zeros(1))[0])
    control, plant = code.control, code.plant
    plant.inputs["p"][:] = p
    turbulent = [code.model.parameter_index(f"flicker.rotor_{rotor}") for rotor in range(4)]
    rows: list[Floats] = []
    volts = []
    for i in range(steps):
        if i % HELD == 0:
            command = control(x=x[:RIGID_BODY_STATES], wanted=wanted[i // HELD])["command"]
            voltage = FULL + (EMPTY - FULL) * used[i] - 1e-7 * float(np.sum(command**2))
            plant.inputs["command"][:], plant.inputs["p"][turbulent] = command, 1 + flicker[i // HELD]
            plant.inputs["w"][:], plant.inputs["e"][:] = white[i // HELD], (0.0, voltage / 8.4)
        found = plant(x=x)
        if i % KEPT == 0:
            rows.append(np.concatenate([x[:RIGID_BODY_STATES], found["force"], found["turning"], command]))
            volts.append(voltage)
        x = found["after"].copy()
    if not np.isfinite(x).all():
        raise ValueError(f"the vehicle did not stay in the air on {manoeuvre}")
    table = np.array(rows)
    return {
        "time": np.arange(0, steps, KEPT) * STEP - EXTRA, "x": table[:, 0:3], "v": table[:, 3:6],
        "q": np.roll(table[:, 6:10], -1, axis=1), "w": table[:, 10:13], "force": table[:, 13:16],
        "rotor_speeds": table[:, 16:20], "command": table[:, 20:24], "voltage": np.array(volts),
    }  # fmt: skip


def _wanted(samples: ReferenceSamples) -> Floats:
    """(n, 11) position, velocity, acceleration, yaw and its rate."""
    yaw = np.unwrap(samples.yaw)
    rate = np.gradient(yaw, HELD * STEP)
    return np.column_stack([samples.position, samples.velocity, samples.acceleration, yaw, rate])
