"""Closed-loop poles of controller, autopilot and vehicle in hover: linear, sampled, and pure.

Near hover the controller is linear: the quadratic program of its horizon without active bounds is a finite-horizon
linear-quadratic regulator (Rawlings, Mayne, Diehl, Model Predictive Control, 2017, section 1.3), and PX4's rate loop
between its setpoints and the rotors is a PID with filters. One control period of all of it together is a matrix, whose
eigenvalues z are poles s = log(z) / period. `benchmarks/results/closed_loop.md` has the table of what files can hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynamics.allocation import mixer
from dynamics.arrays import Floats
from dynamics.integrators import required_steps, step_function
from dynamics.model import ENVIRONMENT_DEFAULT, Model
from dynamics.rate_loop import ACTUATION_DELAY, RateController
from dynamics.state import ATTITUDE, RATE, RIGID_BODY_STATES
from dynamics.trim import FAR_FROM_GROUND, find_trim
from dynamics.vehicle import Vehicle
from runtime.control.controller import ControllerOptions
from runtime.control.rti.problem import INPUT_SCALE

STEP = 0.001  # s, of the autopilot and of the vehicle
REDUCED = 12  # rigid-body states with a rotation vector in place of the quaternion
DIFFERENCE = 1e-5  # of a state, by which it is linearised; of an input, times its hover speed
QUEUE = round(ACTUATION_DELAY / STEP)
NEGLIGIBLE = 1e-6  # of an eigenvalue: what it belongs to has passed within a period
ALIKE = 0.15  # relative distance of a swing that the loop hardly moves
MAX_STEP = 0.05  # s, of a model
MEMORY = 4  # ticks of inputs and hidden states that the controller remembers here
SLOWEST = 2.0  # rad/s, below which a pole is no oscillation of the attitude
Step = Callable[[Floats, Floats, float], Floats]


@dataclass(frozen=True, eq=False)
class HoverModel:
    """A model about its hover, linear. Reduced states: position, velocity, rotation vector, body rates, hidden ones.

    step: (state (nx,), rotor speeds (nu,) rad/s, s) -> next state (nx,).
    state: (nx,) of the hover, at rest and level.
    rotor_speed: (nu,) rad/s.
    lagged: places of the rotors' real speeds in a state state, one for each lag of theirs.
    """

    step: Step
    state: Floats
    rotor_speed: Floats
    lagged: tuple[slice, ...] = ()
    _linear: dict[float, tuple[Floats, Floats]] = field(default_factory=dict)

    def over(self, seconds: float) -> tuple[Floats, Floats]:
        """A (n, n) and B (n, nu) of one step over a time, s."""
        if seconds not in self._linear:
            self._linear[seconds] = self._linearised(seconds)
        return self._linear[seconds]

    def _linearised(self, seconds: float) -> tuple[Floats, Floats]:
        size, inputs = self.state.size - 1, self.rotor_speed.size
        still, hover = np.zeros(size), np.zeros(inputs)
        scale = DIFFERENCE * self.rotor_speed
        states = [self._slope(seconds, row * DIFFERENCE, hover, DIFFERENCE) for row in np.eye(size)]
        driven = [self._slope(seconds, still, row * scale, float(row @ scale)) for row in np.eye(inputs)]
        return np.stack(states, axis=1), np.stack(driven, axis=1)

    @property
    def settled(self) -> Floats:
        """(n, nu) change of the rotors' real speeds, among the reduced states, with that of the inputs."""
        change = np.zeros((self.state.size - 1, self.rotor_speed.size))
        for place in self.lagged:
            change[place.start - 1 : place.stop - 1] = np.eye(self.rotor_speed.size)
        return change

    def _slope(self, seconds: float, state: Floats, speed: Floats, size: float) -> Floats:
        up, down = (
            self._reduced(self.step(self._full_state(sign * state), self.rotor_speed + sign * speed, seconds))
            for sign in (1, -1)
        )
        return np.asarray((up - down) / (2 * size))

    def _full_state(self, reduced: Floats) -> Floats:
        state = self.state.copy()
        half = 0.5 * reduced[6:9]
        state[:6] += reduced[:6]
        state[ATTITUDE] = [math.sqrt(1 - half @ half), *half]
        state[RATE] += reduced[9:REDUCED]
        state[RIGID_BODY_STATES:] += reduced[REDUCED:]
        return state

    def _reduced(self, state: Floats) -> Floats:
        turned = 2 * state[ATTITUDE][1:]
        change = state - self.state
        return np.concatenate([change[:6], turned, change[RATE], change[RIGID_BODY_STATES:]])


def hover_model(model: Model) -> HoverModel:
    """The linear model of a flight model about its hover, far from the ground."""
    trim = find_trim(model)
    state = model.initial_state(np.array([0.0, 0.0, FAR_FROM_GROUND, *[0.0] * 3, 1.0, *[0.0] * 6]))
    for place in model.rotor_speed_places:
        state[place] = trim.rotor_speed
    still = np.zeros(model.hidden_count)
    function = step_function(model, substeps=required_steps(model, MAX_STEP))

    def step(x: Floats, u: Floats, seconds: float) -> Floats:
        return np.array(function(x, u, model.parameter_values, ENVIRONMENT_DEFAULT, still, seconds)).ravel()

    return HoverModel(step, state, trim.rotor_speed, model.rotor_speed_places)


@dataclass(frozen=True)
class Timing:
    """Times of a control period, s.

    age: of an estimate when its tick begins; its stamp shows it.
    latency: from the beginning of a tick to the action of its setpoint.
    """

    age: float = 0.004
    latency: float = 0.005


@dataclass(frozen=True)
class Oscillation:
    """The least damped oscillation.

    damping: ratio; negative for one that grows.
    frequency: Hz.
    """

    damping: float
    frequency: float

    @property
    def is_stable(self) -> bool:
        """Whether it decays."""
        return self.damping > 0


@dataclass(frozen=True, eq=False)
class LinearController:
    """The controller about hover: u = -gain x, setpoint = command x; x is the reduced state that it predicts.

    gain: (nu, n). command: (4, n), body rates, rad/s, and collective thrust over the maximum.
    predict: (A, B) of a millisecond of its model.
    """

    options: ControllerOptions
    gain: Floats
    command: Floats
    predict: tuple[Floats, Floats]

    @property
    def swings(self) -> Floats:
        """Poles, 1/s, with which hidden states of its model swing by themselves, as a load on a line does."""
        values = np.linalg.eigvals(self.predict[0][REDUCED:, REDUCED:]).astype(complex)
        poles = np.log(values[np.abs(values) > NEGLIGIBLE]) / STEP
        return np.asarray(poles[poles.imag > SLOWEST])


def linear_controller(model: HoverModel, options: ControllerOptions, vehicle: Vehicle) -> LinearController:
    """The controller that plans with a model. vehicle: of the model, as it hovers."""
    problem = options.problem
    steps = {interval: model.over(interval) for interval in set(problem.intervals)}
    A, B = steps[problem.node]
    gain = _regulator([steps[interval] for interval in problem.intervals], options, vehicle.hover_speed)
    turning = np.zeros((3, len(A)))
    turning[:, 9:REDUCED] = np.eye(3)
    inputs = -gain
    follows = np.eye(len(A))
    if options.setpoint == "commanded" and model.lagged:
        lags = model.settled.any(axis=1)
        follows[lags] = 0.0
        follows = follows + model.settled @ inputs
    lookahead = np.array([options.rate_lookahead] * 2 + [options.yaw_lookahead]) / problem.node
    slope = turning @ (A @ follows + B @ inputs) - turning
    thrust = 2 * vehicle.rotors.thrust_constant * model.rotor_speed / vehicle.rotors.thrust_max
    command = np.vstack([turning + lookahead[:, None] * slope, thrust @ inputs])
    return LinearController(options, gain, command, model.over(STEP))


def closed_loop_poles(
    controller: LinearController, plant: HoverModel, vehicle: Vehicle, autopilot: RateController, timing: Timing
) -> Floats:
    """Poles, 1/s, of a controller on a vehicle whose autopilot has a rate controller.

    Without those of a load that swings by itself no less: the loop does not cause it and no measurement shows it.
    plant: the vehicle as it is. vehicle: the same as the autopilot's mixer knows it.
    """
    states = _Places(controller, plant, timing)
    inner = _inner_step(states, plant, vehicle, autopilot)
    period = round(controller.options.period / STEP)
    latency = round(timing.latency / STEP) % period
    sampled = (period - round(timing.age / STEP)) % period
    matrix = _tick(states, controller)
    for step in range(period):
        if step == latency:
            matrix = _copied(states, "pending", "setpoint") @ matrix
        if step == sampled and timing.age > 0:
            matrix = _sampled(states) @ matrix
        matrix = inner @ matrix
    values = np.linalg.eigvals(matrix)
    poles = np.log(values[np.abs(values) > NEGLIGIBLE].astype(complex)) / controller.options.period
    for swing in controller.swings:
        poles = poles[(np.abs(poles - swing) > ALIKE * np.abs(swing)) | (poles.real > swing.real)]
    return np.asarray(poles)


def worst_damped(poles: Floats) -> Oscillation:
    """The least damped of the poles, 1/s, that are no slow drift."""
    fast = poles[(np.abs(poles) > SLOWEST) & (poles.imag >= 0.0)]
    damping = -fast.real / np.abs(fast)
    worst = int(np.argmin(damping))
    return Oscillation(float(damping[worst]), float(fast[worst].imag / (2 * math.pi)))


def _regulator(stages: Sequence[tuple[Floats, Floats]], options: ControllerOptions, hover_speed: float) -> Floats:
    """Feedback gain (nu, n) of the horizon's first input. stages: A and B over each interval."""
    problem, weights = options.problem, options.problem.weights
    (A, B), intervals = stages[0], problem.intervals
    attitude = [weights.attitude / 4] * 3  # a quaternion's components are half of a rotation vector's
    hidden = [0.0] * (len(A) - REDUCED)
    Q = np.diag([*weights.position, *weights.velocity, *attitude, *weights.rate, *hidden])
    regular = problem.levenberg_marquardt / (INPUT_SCALE * hover_speed) ** 2
    R = weights.input / hover_speed**2
    cost: Floats = weights.terminal * Q
    gain: Floats = np.zeros(B.T.shape)
    for (A, B), interval in zip(reversed(stages), reversed(intervals), strict=True):
        share = interval / intervals[0]
        price = (share * R + regular) * np.eye(B.shape[1])
        gain = np.asarray(np.linalg.solve(price + B.T @ cost @ B, B.T @ cost @ A))
        cost = share * Q + A.T @ cost @ (A - B @ gain)
        cost = np.asarray((cost + cost.T) / 2)
    return gain


class _Places:
    """Where the parts of the sampled closed loop's state are.

    samples: slots of estimates under way; one tick's is read when it is `age` old.
    """

    def __init__(self, controller: LinearController, plant: HoverModel, timing: Timing) -> None:
        inputs, hidden = controller.gain.shape[0], controller.gain.shape[1] - REDUCED
        period = round(controller.options.period / STEP)
        self.inputs, self.hidden, self.plant = inputs, hidden, plant.state.size - 1
        self.samples = math.ceil(round(timing.age / STEP) / period)
        self.late = round(timing.age / STEP)
        sizes = {
            "plant": self.plant, "gyro": 6, "rate": 3, "acceleration": 3, "integral": 3, "yaw_torque": 1,
            "queue": 4 * QUEUE, "setpoint": 4, "pending": 4, "samples": REDUCED * self.samples,
            "inputs": inputs * MEMORY, "hidden": hidden * MEMORY,
        }  # fmt: skip
        ends = np.cumsum(list(sizes.values()))
        self.places = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}
        self.size = int(ends[-1])

    def rows(self, name: str, first: int = 0, count: int | None = None) -> Floats:
        """Rows (count, size) of the unit matrix that read a part of the state."""
        place = self.places[name]
        start = place.start + first
        return np.eye(self.size)[start : place.stop if count is None else start + count]


def _copied(states: _Places, source: str, target: str) -> Floats:
    matrix = np.eye(states.size)
    matrix[states.places[target]] = states.rows(source)
    return matrix


def _sampled(states: _Places) -> Floats:
    """An estimate leaves the vehicle; older ones move on by a slot."""
    matrix = np.eye(states.size)
    shifted = [states.rows("plant", 0, REDUCED)]
    shifted += [states.rows("samples", REDUCED * slot, REDUCED) for slot in range(states.samples - 1)]
    matrix[states.places["samples"]] = np.vstack(shifted)
    return matrix


def _inner_step(states: _Places, plant: HoverModel, vehicle: Vehicle, autopilot: RateController) -> Floats:
    """A millisecond of autopilot and vehicle, as `sitl_mock.vehicle.plant` steps them."""
    A, B = plant.over(STEP)
    speeds = vehicle.rotors.speed_max**2 / (2 * plant.rotor_speed)  # rad/s of a rotor for its state thrust
    speed = speeds[:, None] * mixer(vehicle)
    matrix = np.eye(states.size)

    def put(name: str, rows: Floats) -> None:
        matrix[states.places[name]] = rows

    now = states.rows
    moved = A @ now("plant") + B @ speed @ now("queue", 4 * (QUEUE - 1))
    ohm = math.tan(math.pi * autopilot.gyro_cutoff * STEP)
    norm = 1 + math.sqrt(2) * ohm + ohm**2
    first, second = now("gyro", 0, 3), now("gyro", 3)
    newest = moved[9:REDUCED] - (2 * (ohm**2 - 1) * first + (1 - math.sqrt(2) * ohm + ohm**2) * second) / norm
    rate = ohm**2 / norm * (newest + 2 * first + second)
    error = now("setpoint", 0, 3) - now("rate")
    p, i, d = (np.array(gain)[:, None] for gain in (autopilot.p, autopilot.i, autopilot.d))
    torque = p * error + now("integral") - d * now("acceleration")
    yaw = now("yaw_torque") + _share(autopilot.yaw_torque_cutoff) * (torque[2:] - now("yaw_torque"))
    change = (rate - now("rate")) / STEP - now("acceleration")
    put("plant", moved)
    put("gyro", np.vstack([newest, first]))
    put("rate", rate)
    put("acceleration", now("acceleration") + _share(autopilot.acceleration_cutoff) * change)
    put("integral", now("integral") + STEP * i * error)
    put("yaw_torque", yaw)
    put("queue", np.vstack([torque[:2], yaw, now("setpoint", 3), now("queue", 0, 4 * (QUEUE - 1))]))
    return matrix


def _share(cutoff: float) -> float:
    """Of a step, that a first-order low-pass takes on in a millisecond. cutoff: Hz."""
    return STEP / (STEP + 1 / (2 * math.pi * cutoff))


def _tick(states: _Places, controller: LinearController) -> Floats:
    """The controller's tick: the newest estimate, propagated to when the setpoint acts, and what is commanded there.

    Inputs and hidden states of the last ticks are remembered from when they acted, as `Controller.compensate` has them.
    """
    A, B = controller.predict
    period, delay = (round(seconds / STEP) for seconds in (controller.options.period, controller.options.delay))
    width, hidden = states.inputs, states.hidden
    acted = [delay - (tick + 1) * period for tick in range(MEMORY)]
    taken = -states.late
    tick = next((tick for tick in range(MEMORY) if acted[tick] <= taken), MEMORY - 1)
    estimate = states.rows("samples", REDUCED * (states.samples - 1)) if states.samples else None
    if estimate is None:
        estimate = states.rows("plant", 0, REDUCED)
    past = [states.rows("inputs", width * t, width) for t in range(MEMORY)]
    state = np.vstack([estimate, states.rows("hidden", hidden * tick, hidden)])
    for _ in range(taken - acted[tick]):
        state = A @ state + B @ past[tick]
    state[:REDUCED] = estimate
    for time in range(taken, delay):
        while tick > 0 and acted[tick - 1] <= time:
            tick -= 1
        state = A @ state + B @ past[tick]
    matrix = np.eye(states.size)
    matrix[states.places["pending"]] = controller.command @ state
    matrix[states.places["inputs"]] = np.vstack([-controller.gain @ state, *past[:-1]])
    older = states.rows("hidden", 0, hidden * (MEMORY - 1))
    matrix[states.places["hidden"]] = np.vstack([state[REDUCED:], older])
    return matrix
