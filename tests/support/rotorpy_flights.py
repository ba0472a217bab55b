"""Flights by an independent simulator: a vehicle file's numbers in RotorPy's dynamics under RotorPy's controller.

Nothing of ours computes a force here, so a formula or a sign that is wrong in `dynamics` shows. Nine flights of 12 s
excite one axis after the other and several together; sensors, their clocks and the rotors' turbulence are below.
Folk, Paulos, Kumar, RotorPy: A Python-based multirotor simulator with aerodynamics, 2023.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.multirotor import Multirotor
from rotorpy.wind.dryden_winds import DrydenGust
from scipy.integrate import OdeSolver
from scipy.spatial.transform import Rotation

from diagnosis.dataset import Dataset, make_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from flights import Flight
from tests.support.rotorpy_sensors import EXTRA, Sensors, as_flight, wandering

Floats = NDArray[np.float64]
Parameters = dict[str, Any]
Values = Mapping[str, float]

STEP = 0.01  # s, of dynamics and controller
FINE_STEP = 0.005  # s, where the commands are logged: each is held for a step, which looks like half a step of lag
DURATION, SETTLING = 12.0, 1.5  # s; what is flown before the log begins
USUAL_LAG = 0.035  # s
LOST = 3.0  # m from the path
TURBULENCE, TURBULENCE_TIME = 0.0033, 0.05  # share of each rotor's thrust that comes and goes, and for how long, s
ATTITUDE_GAINS = {"kp_att": 200.0, "kd_att": 24.0}  # that a motor lag of 35 ms bears

# Sines of position and yaw about (0, 0, height), amplitude in m or rad and frequency in Hz; the last two held out.
Path = tuple[float, Mapping[str, tuple[float, float]]]
PATHS: tuple[Path, ...] = (
    (2.0, {"x": (1.4, 0.35), "y": (1.4, 0.23), "yaw": (0.8, 0.15)}),
    (2.4, {"x": (2.1, 0.25), "z": (0.4, 0.4)}),
    (2.0, {"y": (2.0, 0.27), "z": (0.6, 0.3)}),
    (2.0, {"x": (2.2, 0.36), "z": (0.1, 0.2)}),
    (0.30, {"x": (0.7, 0.2), "y": (0.5, 0.25), "z": (0.18, 0.35)}),
    (1.5, {"x": (0.8, 0.2), "y": (0.9, 0.24), "yaw": (3.0, 0.17)}),
    (2.0, {"x": (0.5, 0.17), "z": (0.8, 0.4), "yaw": (0.8, 0.25)}),
    (2.0, {"x": (1.5, 0.33), "y": (1.0, 0.27), "z": (0.45, 0.45), "yaw": (1.0, 0.15)}),
    (1.5, {"x": (0.8, 0.31), "y": (1.0, 0.36), "z": (0.2, 0.3), "yaw": (2.0, 0.2)}),
)

# The effects of our catalogue that RotorPy knows, in its parameters.
MADE: dict[str, Callable[[Parameters, Values], Parameters]] = {
    "rotor_drag": lambda p, v: {**p, "k_d": v["coefficient"]},
    "axial_inflow": lambda p, v: {**p, "k_z": v["coefficient"]},
    "translational_lift": lambda p, v: {**p, "k_h": v["coefficient"]},
    "blade_flapping": lambda p, v: {**p, "k_flap": v["coefficient"]},
    "parasitic_drag": lambda p, v: {**p, **{f"c_D{axis}": v["coefficient"] for axis in "xyz"}},
    "mass": lambda p, v: {**p, "mass": p["mass"] * v["ratio"]},
    "inertia": lambda p, v: {**p, **{f"I{a}{a}": p[f"I{a}{a}"] * v[f"ratio_{a}"] for a in "xyz"}},
    "thrust_constant": lambda p, v: {**p, "k_eta": p["k_eta"] * v["ratio"]},
    "torque_constant": lambda p, v: {**p, "k_m": p["k_m"] * v["ratio"]},
    "centre_of_mass": lambda p, v: {
        **p, "rotor_pos": {i: r - np.array([v["x"], v["y"], v["z"]]) for i, r in p["rotor_pos"].items()}
    },
    "motor_lag": lambda p, v: {**p, "tau_m": v["time_constant"]},
}  # fmt: skip
WINDS = ("wind", "gust")  # of the air; RotorPy's vehicles feel it through their drag alone
READ_WRONG = ("imu_bias", "gyro_bias", "time_delay", "rotor_speed_fault")  # made by our sensors here
NOT_MADE = {
    "linear_drag": "RotorPy's body drag is quadratic",
    "rotational_damping": "no moment of the air on a turning body",
    "ground_effect": "its ground only carries",
    "wall_effect": "no walls in the air",
    "rotor_gyroscopic": "rotors have no inertia",
    "battery_sag": "no battery",
    "weak_rotor": "one thrust constant for all rotors",
    "rotor_cant": "all rotors push along body z",
    "slung_load": "no load",
}


def rotorpy_dataset(
    vehicle: Vehicle, effects: Sequence[EffectUse] = (), *, seed: int, noise: float = 1.0, commands: bool = False
) -> Dataset:
    """The nine flights as diagnosis reads them, the last two held out."""
    return make_dataset(rotorpy_flights(vehicle, effects, seed=seed, noise=noise, commands=commands), vehicle)


def rotorpy_flights(
    vehicle: Vehicle,
    effects: Sequence[EffectUse] = (),
    *,
    seed: int,
    noise: float = 1.0,
    commands: bool = False,
    paths: Sequence[Path] = PATHS,
    duration: float = DURATION,
) -> list[Flight]:
    """One flight of each path on a vehicle that hides effects from its file.

    noise: factor on all that sensors and turbulence add; biases and clock offsets keep their size. commands: log what
    the motors were told instead of their speed. Raises ValueError for an effect that RotorPy cannot make,
    RuntimeError when the vehicle cannot be held on its path.
    """
    used = {use.name: use for use in (*vehicle.effects, *effects)}
    parameters = with_effects(rotorpy_parameters(vehicle), list(used.values()))
    if set(used) & set(WINDS) and not any(parameters[key] for key in ("k_d", "c_Dx")):
        raise ValueError("RotorPy feels wind through drag: give the vehicle rotor_drag or parasitic_drag as well.")
    faults = [use for use in effects if use.name in READ_WRONG]
    flights, step = [], FINE_STEP if commands else STEP
    for i, path in enumerate(paths):
        random = np.random.default_rng([seed, i])
        flown = _fly(
            rotorpy_parameters(vehicle), parameters, path, _air(used, duration, step, random), step, noise, random
        )
        sensors = Sensors.drawn(noise, random, faults)
        flights.append(as_flight(flown, sensors, f"rotorpy_{i}.csv", commands=commands, random=random))
    return flights


def with_effects(parameters: Parameters, effects: Sequence[EffectUse]) -> Parameters:
    """RotorPy's dictionary with the vehicle's own effects in it. Raises ValueError for one that RotorPy cannot make."""
    for use in effects:
        if use.name in NOT_MADE:
            raise ValueError(f"RotorPy cannot make {use.name}: {NOT_MADE[use.name]}.")
        if use.name in MADE:
            neutral = {p.name: p.neutral for p in CATALOGUE[use.name].parameters}
            parameters = MADE[use.name](parameters, {**neutral, **use.parameters})
    return parameters


def rotorpy_parameters(vehicle: Vehicle) -> Parameters:
    """A vehicle file's textbook numbers as RotorPy's dictionary; RotorPy's rotor places are from the centre of mass."""
    moments = dict(zip(("Ixx", "Iyy", "Izz"), vehicle.body.inertia, strict=True))
    centre = np.array(vehicle.body.centre_of_mass)
    rotors = vehicle.rotors
    return {
        "mass": vehicle.body.mass, **moments, "Ixy": 0.0, "Ixz": 0.0, "Iyz": 0.0,
        "num_rotors": rotors.count, "rotor_directions": np.array(rotors.spin),
        "rotor_pos": {f"r{i}": np.array(place) - centre for i, place in enumerate(rotors.position)},
        "rotor_speed_min": rotors.speed_min, "rotor_speed_max": rotors.speed_max,
        "k_eta": rotors.thrust_constant, "k_m": rotors.torque_constant, "tau_m": USUAL_LAG,
        **dict.fromkeys(("k_d", "k_z", "k_h", "k_flap", "c_Dx", "c_Dy", "c_Dz"), 0.0), **ATTITUDE_GAINS,
    }  # fmt: skip


class _Turbulent(Multirotor):  # type: ignore[misc]
    """RotorPy's vehicle with a share of each rotor's thrust that comes and goes without its speed."""

    flicker: Floats

    def compute_body_wrench(self, body_rates: Floats, rotor_speeds: Floats, airspeed: Floats) -> tuple[Floats, Floats]:
        force, moment = super().compute_body_wrench(body_rates, rotor_speeds, airspeed)
        lift = self.flicker * self.k_eta * rotor_speeds**2
        at = self.rotor_geometry
        added = np.array([0.0, 0.0, lift.sum()]), np.array([at[:, 1] @ lift, -at[:, 0] @ lift, 0.0])
        return force + added[0], moment + added[1]


class _OneStep(OdeSolver):  # type: ignore[misc]
    """The whole interval by one classical Runge-Kutta step; an adaptive solver spends most of its time on choosing."""

    def __init__(self, fun: Any, t0: float, y0: Floats, t_bound: float, vectorized: bool = False) -> None:
        super().__init__(fun, t0, y0, t_bound, vectorized)

    def _step_impl(self) -> tuple[bool, None]:
        dt = self.t_bound - self.t
        k1 = self.fun(self.t, self.y)
        k2 = self.fun(self.t, self.y + dt / 2 * k1)
        k3 = self.fun(self.t, self.y + dt / 2 * k2)
        k4 = self.fun(self.t, self.y + dt * k3)
        self.y = self.y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.t = self.t_bound
        return True, None


def _fly(
    known: Parameters, real: Parameters, path: Path, air: Floats, step: float, noise: float,
    random: np.random.Generator,
) -> dict[str, Floats]:  # fmt: skip
    """What was true at every step, by RotorPy's names; time is 0 where the log begins. air: (steps, 3)."""
    steps = len(air)
    time = np.arange(steps) * step - SETTLING - EXTRA
    flat = _flat(path, time, random)
    controller = SE3Control(known)
    vehicle = _Turbulent(real, integrator_kwargs={"method": _OneStep})
    flicker = noise * TURBULENCE * wandering(steps, step / TURBULENCE_TIME, random, real["num_rotors"])
    hover = np.sqrt(known["mass"] * vehicle.g / (known["num_rotors"] * known["k_eta"]))
    state = {
        "x": flat[0]["x"], "v": flat[0]["x_dot"], "w": np.zeros(3), "wind": air[0],
        "q": Rotation.from_euler("z", flat[0]["yaw"]).as_quat(), "rotor_speeds": np.full(known["num_rotors"], hover),
    }  # fmt: skip
    rows: dict[str, list[Floats]] = {name: [] for name in (*state, "force", "command")}
    for i in range(steps):
        vehicle.flicker, state["wind"] = flicker[i], air[i]
        command = np.clip(
            controller.update(time[i], state, flat[i])["cmd_motor_speeds"],
            vehicle.rotor_speed_min, vehicle.rotor_speed_max,
        )  # fmt: skip
        airspeed = Rotation.from_quat(state["q"]).inv().apply(state["v"] - state["wind"])
        force, _ = vehicle.compute_body_wrench(state["w"], state["rotor_speeds"], airspeed)
        for name, value in (*state.items(), ("force", force / vehicle.mass), ("command", command)):
            rows[name].append(np.array(value))
        state = vehicle.step(state, {"cmd_motor_speeds": command}, step)
        if np.linalg.norm(state["x"] - flat[i]["x"]) > LOST:
            raise RuntimeError(f"the vehicle lost its path at {time[i]:.1f} s: the effects are more than it can bear.")
    return {"time": time, **{name: np.array(values) for name, values in rows.items()}}


def _flat(path: Path, time: Floats, random: np.random.Generator) -> list[dict[str, Any]]:
    """RotorPy's flat outputs along a path whose sines begin anywhere."""
    height, sines = path
    waves = {}
    for name in ("x", "y", "z", "yaw"):
        size, frequency = sines.get(name, (0.0, 0.1))
        turning, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
        waves[name] = [size * turning**k * np.sin(turning * time + phase + k * np.pi / 2) for k in range(3)]
    place, velocity, acceleration = (np.column_stack([waves[n][k] for n in "xyz"]) for k in range(3))
    return [
        {
            "x": place[i] + [0.0, 0.0, height], "x_dot": velocity[i], "x_ddot": acceleration[i],
            "x_dddot": np.zeros(3), "x_ddddot": np.zeros(3), "yaw": waves["yaw"][0][i], "yaw_dot": waves["yaw"][1][i],
        }
        for i in range(len(time))
    ]  # fmt: skip


def _air(used: Mapping[str, EffectUse], duration: float, step: float, random: np.random.Generator) -> Floats:
    """(steps, 3) the air's velocity, world, m/s; a gust by RotorPy's Dryden filter, scaled to its intensity."""
    steps = round((SETTLING + duration + 2 * EXTRA) / step)
    air = np.zeros((steps, 3))
    if "wind" in used:
        air += [used["wind"].parameters.get(axis, 0.0) for axis in "xyz"]
    if "gust" in used:
        before = np.random.get_state()  # the filter draws from numpy's global generator
        np.random.seed(random.integers(2**31))
        filtered = DrydenGust(dt=step)
        gust = np.array([filtered.update(0.0, np.zeros(3)) for _ in range(steps)])
        np.random.set_state(before)
        air += used["gust"].parameters["intensity"] * gust / np.std(gust, axis=0) * [1.0, 1.0, 0.5]
    return air
