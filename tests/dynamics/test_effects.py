"""Every effect against its formula written out by hand in NumPy, and what each must do to a vehicle."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import quaternion
from dynamics.effects import CATALOGUE
from dynamics.integrators import step_function
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import EffectUse, Vehicle

SEEDS = range(4)


@dataclass(frozen=True)
class Moment:
    """One instant of a flight, in plain arrays."""

    vehicle: Vehicle
    state: np.ndarray
    speed: np.ndarray
    environment: np.ndarray

    @property
    def to_world(self):
        return quaternion.rotation_matrix(self.state[6:10])

    @property
    def arms(self):
        return np.array(self.vehicle.rotors.position)

    @property
    def thrusts(self):
        return self.vehicle.rotors.thrust_constant * self.speed**2

    def air(self, wind=(0.0, 0.0, 0.0)):
        """Velocity through the air in body axes at the centre of mass, and at each rotor."""
        centre = self.to_world.T @ (self.state[3:6] - np.array(wind))
        return centre, centre + np.cross(self.state[10:13], self.arms)


def moment(vehicle, seed):
    """A random instant close to the ground."""
    random = np.random.default_rng(seed)
    state = np.concatenate(
        [
            [*random.normal(size=2), random.uniform(0.15, 0.5)],
            random.normal(scale=3.0, size=3),
            quaternion.exponential(random.normal(scale=0.3, size=3)),
            random.normal(scale=2.0, size=3),
        ]
    )
    environment = np.array([random.uniform(-0.1, 0.0), random.uniform(0.8, 1.0)])
    return Moment(vehicle, state, random.uniform(600.0, 1600.0, 4), environment)


def observed(now, *uses, hidden=None):
    """Force and moment in body axes that a model with these effects gives, N and N m."""
    model = build_model(now.vehicle, effects=uses)
    state = np.concatenate([now.state, model.hidden_initial if hidden is None else hidden])
    specific, angular, _ = model.observe(state, now.speed, model.parameter_values, now.environment)
    inertia = np.array(now.vehicle.body.inertia)
    rate = now.state[10:13]
    torque = inertia * np.array(angular).ravel() + np.cross(rate, inertia * rate)
    return now.vehicle.body.mass * np.array(specific).ravel(), torque


def added(now, *uses, hidden=None):
    """Force and moment that effects add to the nominal model."""
    with_effects, without = observed(now, *uses, hidden=hidden), observed(now)
    return with_effects[0] - without[0], with_effects[1] - without[1]


def summed(now, forces):
    """Resultant of one force per rotor."""
    return forces.sum(axis=0), np.cross(now.arms, forces).sum(axis=0)


def upwards(values):
    """Forces along body z."""
    return np.column_stack([0 * values, 0 * values, values])


def rotor_drag(now, p):
    _, at_rotor = now.air()
    return summed(now, -p["coefficient"] * now.speed[:, None] * at_rotor * [1, 1, 0])


def parasitic_drag(now, p):
    air, _ = now.air()
    return -p["coefficient"] * np.linalg.norm(air) * air, np.zeros(3)


def blade_flapping(now, p):
    _, at_rotor = now.air()
    across = np.cross([0, 0, 1], at_rotor) * [1, 1, 0]
    return np.zeros(3), p["coefficient"] * (now.speed[:, None] * across).sum(axis=0)


def axial_inflow(now, p):
    _, at_rotor = now.air()
    return summed(now, upwards(-p["coefficient"] * now.speed * at_rotor[:, 2]))


def translational_lift(now, p):
    _, at_rotor = now.air()
    return summed(now, upwards(p["coefficient"] * (at_rotor[:, 0] ** 2 + at_rotor[:, 1] ** 2)))


def ground_effect(now, p):
    height = now.state[2] + (now.to_world @ now.arms.T)[2] - now.environment[0]
    ratio = p["radius"] / (4 * np.maximum(height, p["radius"] / 2))
    return summed(now, upwards(p["gain"] * now.thrusts * (1 / (1 - ratio**2) - 1)))


def wind(now, p):
    push = now.to_world.T @ [p["x"], p["y"], p["z"]]
    return p["coefficient"] * now.speed.sum() * push * [1, 1, 0], np.zeros(3)


def mass(now, p):
    force = observed(now)[0]
    return force / p["ratio"] - force, np.zeros(3)  # with the file's mass


def thrust_constant(now, p):
    return summed(now, upwards((p["ratio"] - 1) * now.thrusts))


def weak_rotor(now, p, rotor=1):
    force, torque = summed(now, upwards(-p["loss"] * now.thrusts * (np.arange(4) == rotor)))
    reaction = now.vehicle.rotors.torque_constant * now.vehicle.rotors.spin[rotor] * now.speed[rotor] ** 2
    return force, torque - [0, 0, p["torque_loss"] * reaction]


def thrust_exponent(now, p):
    hover = now.vehicle.hover_speed
    thrust = now.vehicle.rotors.thrust_constant * hover**2 * (now.speed / hover) ** p["exponent"]
    force, torque = summed(now, upwards(thrust - now.thrusts))
    turned = hover**2 * (now.speed / hover) ** p["torque_exponent"] - now.speed**2
    reaction = now.vehicle.rotors.torque_constant * (np.array(now.vehicle.rotors.spin) @ turned)
    return force, torque + np.array([0, 0, reaction])


def centre_of_mass(now, p):
    return np.zeros(3), -np.cross([p["x"], p["y"], p["z"]], observed(now)[0])


def battery_sag(now, p):
    rotors, slower = now.vehicle.rotors, (now.environment[1] / p["reference"]) ** p["gain"]
    force, torque = summed(now, upwards((slower**2 - 1) * now.thrusts))
    yaw = rotors.torque_constant * (slower**2 - 1) * np.dot(rotors.spin, now.speed**2)
    return force, torque + np.array([0.0, 0.0, yaw])


def linear_drag(now, p):
    return -p["coefficient"] * now.air()[0], np.zeros(3)


def rotational_damping(now, p):
    return np.zeros(3), -p["coefficient"] * now.state[10:13]


def wall_effect(now, p):
    normal = np.array([np.cos(p["heading"]), np.sin(p["heading"]), 0.0])
    gap = max(p["distance"] - normal @ now.state[:3], 0.0)
    push = p["gain"] * now.thrusts.sum() * np.exp(-gap / p["scale"])
    return now.to_world.T @ (push * normal), np.zeros(3)


def rotor_gyroscopic(now, p):
    momentum = np.array([0, 0, -p["inertia"] * (np.array(now.vehicle.rotors.spin) @ now.speed)])
    return np.zeros(3), -np.cross(now.state[10:13], momentum)


def rotor_cant(now, p, rotor=1):
    arm = now.arms[rotor]
    outwards = arm / np.linalg.norm(arm)
    around = np.cross([0, 0, 1], outwards)
    force = now.thrusts[rotor] * (p["tangential"] * around + p["radial"] * outwards)
    return force, np.cross(arm, force)


def torque_constant(now, p):
    yaw = now.vehicle.rotors.torque_constant * (np.array(now.vehicle.rotors.spin) @ now.speed**2)
    return np.zeros(3), np.array([0, 0, (p["ratio"] - 1) * yaw])


def inertia(now, p):
    file = np.array(now.vehicle.body.inertia)
    real, rate = file * [p["ratio_x"], p["ratio_y"], p["ratio_z"]], now.state[10:13]
    torque = observed(now)[1]
    angular = (torque - np.cross(rate, real * rate)) / real
    return np.zeros(3), file * angular + np.cross(rate, file * rate) - torque  # with the file's inertia


def slung_load(now, p):
    mass = now.vehicle.body.mass
    driving = now.to_world @ [0, 0, now.thrusts.sum() / mass]
    tension = p["mass"] * driving[2] / (1 + p["mass"] / mass)  # the line hangs still
    return now.to_world.T @ [0, 0, -tension], np.zeros(3)


EXPECTED = {
    "rotor_drag": (rotor_drag, {"coefficient": 2.2e-5}),
    "parasitic_drag": (parasitic_drag, {"coefficient": 0.012}),
    "blade_flapping": (blade_flapping, {"coefficient": -1.5e-7}),
    "axial_inflow": (axial_inflow, {"coefficient": 3e-5}),
    "translational_lift": (translational_lift, {"coefficient": 1e-3}),
    "ground_effect": (ground_effect, {"gain": 1.3, "radius": 0.06}),
    "wind": (wind, {"x": 2.0, "y": -1.0, "z": 0.5, "coefficient": 2e-5}),
    "mass": (mass, {"ratio": 1.2}),
    "thrust_constant": (thrust_constant, {"ratio": 0.9}),
    "thrust_exponent": (thrust_exponent, {"exponent": 1.75, "torque_exponent": 1.8}),
    "weak_rotor": (weak_rotor, {"loss": 0.15, "torque_loss": 0.1}),
    "centre_of_mass": (centre_of_mass, {"x": 0.01, "y": -0.004, "z": 0.002}),
    "battery_sag": (battery_sag, {"gain": 0.7, "reference": 0.95}),
    "linear_drag": (linear_drag, {"coefficient": 0.06}),
    "rotational_damping": (rotational_damping, {"coefficient": 4e-4}),
    "wall_effect": (wall_effect, {"gain": -0.1, "heading": 0.7, "distance": 2.0, "scale": 0.5}),
    "rotor_gyroscopic": (rotor_gyroscopic, {"inertia": 2e-6}),
    "rotor_cant": (rotor_cant, {"tangential": 0.04, "radial": -0.02}),
    "torque_constant": (torque_constant, {"ratio": 1.3}),
    "inertia": (inertia, {"ratio_x": 1.1, "ratio_y": 0.9, "ratio_z": 1.2}),
    "slung_load": (slung_load, {"mass": 0.03, "length": 0.4}),
}


SENSOR_FAULTS = {
    "imu_bias": {"x": 0.1, "y": -0.2, "z": 0.3},
    "imu_lever_arm": {"x": 0.02, "y": -0.01, "z": 0.03},
    "imu_misalignment": {"x": 0.05, "y": -0.02, "z": 0.1, "gyro_turns": 1.0},
    "imu_scale": {"ratio": 1.1},
    "gyro_scale": {"ratio": 0.9},
    "gyro_bias": {"x": 0.01, "y": -0.02, "z": 0.03},
    "time_delay": {"delay": 0.03},
    "attitude_delay": {"delay": 0.015},
    "rotor_delay": {"delay": 0.01},
    "pose_lever_arm": {"x": 0.02, "y": -0.01, "z": 0.03},
    "rotor_speed_fault": {"gain": 0.5},
}
FORCE, RATE, SPEED, ANGULAR = [1.0, 2, 3], [4.0, 5, 6], [700.0, 800, 900, 1000], [70.0, -80, 90]


def at(arm):
    """Acceleration of a point of the body beyond its centre of mass's."""
    return np.cross(ANGULAR, arm) + np.cross(RATE, np.cross(RATE, arm))


def turned(vector, p):
    """A body vector in axes turned by a rotation vector."""
    return quaternion.rotate_inverse(quaternion.exponential(np.array([p["x"], p["y"], p["z"]])), np.array(vector))


READINGS = {  # force, rate, rotor speed, age of the pose, of the attitude beyond it, arm of the pose
    "imu_bias": lambda p: {"force": FORCE + axes(p)},
    "imu_lever_arm": lambda p: {"force": FORCE + at(axes(p))},
    "imu_misalignment": lambda p: {"force": turned(FORCE, p), "rate": turned(RATE, p)},
    "imu_scale": lambda p: {"force": p["ratio"] * np.array(FORCE)},
    "gyro_scale": lambda p: {"rate": p["ratio"] * np.array(RATE)},
    "gyro_bias": lambda p: {"rate": RATE + axes(p)},
    "time_delay": lambda p: {"pose_age": p["delay"]},
    "attitude_delay": lambda p: {"attitude_age": p["delay"]},
    "rotor_delay": lambda p: {"rotor_age": p["delay"]},
    "pose_lever_arm": lambda p: {"pose_arm": axes(p)},
    "rotor_speed_fault": lambda p: {"speed": SPEED * np.array([1, p["gain"], 1, 1])},
}


def axes(p):
    """Parameters x, y, z."""
    return np.array([p["x"], p["y"], p["z"]])


def use(name, values):
    """An effect as a vehicle file has it."""
    return EffectUse(name, values, 1 if CATALOGUE[name].per_rotor else None)


def test_every_effect_has_its_formula_checked_here():
    assert set(CATALOGUE) == {*EXPECTED, *SENSOR_FAULTS, "motor_lag", "gust"}, (
        "add the new effect's formula to EXPECTED"
    )


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", EXPECTED)
def test_an_effect_adds_what_its_formula_says(arpl_250g, name, seed):
    formula, values = EXPECTED[name]
    now = moment(arpl_250g, seed)
    force, torque = added(now, use(name, values))
    expected_force, expected_torque = formula(now, values)
    assert np.linalg.norm(expected_force) + np.linalg.norm(expected_torque) > 1e-6
    assert_allclose(force, expected_force, atol=1e-12)
    assert_allclose(torque, expected_torque, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name != "motor_lag"])
def test_at_its_neutral_value_an_effect_adds_nothing(arpl_250g, name):
    neutral = {parameter.name: parameter.neutral for parameter in CATALOGUE[name].parameters}
    force, torque = added(moment(arpl_250g, 0), use(name, neutral))
    assert_allclose(force, 0.0, atol=1e-12)
    assert_allclose(torque, 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", ["rotor_drag", "parasitic_drag", "axial_inflow"])
def test_drag_only_ever_takes_energy_out(arpl_250g, name, seed):
    now = moment(arpl_250g, seed)
    force, torque = added(now, use(name, EXPECTED[name][1]))
    power = force @ now.air()[0] + torque @ now.state[10:13]
    assert power < 0


@pytest.mark.parametrize("drag", ["rotor_drag", "parasitic_drag"])
def test_wind_acts_through_the_drag_that_the_model_has(arpl_250g, drag):
    now = moment(arpl_250g, 0)
    blowing = {"x": 2.0, "y": -1.0, "z": 0.5}
    values = EXPECTED[drag][1]
    force, torque = added(now, use(drag, values), use("wind", {**blowing, "coefficient": 1e-3}))
    relative = now.state.copy()
    relative[3:6] -= list(blowing.values())
    expected = EXPECTED[drag][0](Moment(now.vehicle, relative, now.speed, now.environment), values)
    assert_allclose(force, expected[0], atol=1e-12)
    assert_allclose(torque, expected[1], atol=1e-12)


def test_a_vehicle_drifting_with_the_wind_feels_no_drag(arpl_250g):
    now = moment(arpl_250g, 0)
    now.state[10:13] = 0.0
    carried = use("wind", dict(zip("xyz", now.state[3:6], strict=True)))
    force, torque = added(now, use("rotor_drag", {"coefficient": 1e-4}), use("parasitic_drag", {}), carried)
    assert_allclose(force, 0.0, atol=1e-12)
    assert_allclose(torque, 0.0, atol=1e-12)


def test_ground_effect_is_cheeseman_and_bennetts_and_decays_with_height(arpl_250g):
    radius = 0.06

    def gain(height):
        state = np.array([0, 0, height, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0])
        level = Moment(arpl_250g, state, np.full(4, 1000.0), ENVIRONMENT_DEFAULT)
        force, _ = added(level, use("ground_effect", {"gain": 1.0, "radius": radius}))
        return force[2] / level.thrusts.sum()

    assert gain(radius) == pytest.approx(1 / (1 - 1 / 16) - 1)
    heights = np.linspace(radius / 2, 1.0, 30)
    assert np.all(np.diff([gain(height) for height in heights]) < 0)
    assert gain(20 * radius) < 2e-4
    assert gain(0.0) == pytest.approx(gain(radius / 2))


@pytest.mark.parametrize(("rotor", "roll", "pitch"), [(0, -1, 1), (1, -1, -1), (2, 1, -1), (3, 1, 1)])
def test_the_body_drops_towards_its_weak_rotor(arpl_250g, rotor, roll, pitch):
    hover = np.full(4, arpl_250g.hover_speed)
    state = np.array([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0])
    level = Moment(arpl_250g, state, hover, ENVIRONMENT_DEFAULT)
    force, torque = added(level, EffectUse("weak_rotor", {"loss": 0.1}, rotor))
    assert force[2] == pytest.approx(-0.1 * arpl_250g.weight / 4)
    assert np.sign(torque[0]) == roll
    assert np.sign(torque[1]) == pitch
    assert torque[2] == pytest.approx(0.0, abs=1e-12)


def test_two_weak_rotors_are_two_effects(arpl_250g):
    now = moment(arpl_250g, 0)
    first, second = (EffectUse("weak_rotor", {"loss": loss}, rotor) for loss, rotor in ((0.1, 0), (0.2, 3)))
    both, alone = added(now, first, second), (added(now, first), added(now, second))
    assert_allclose(both[0], alone[0][0] + alone[1][0], atol=1e-12)
    assert_allclose(both[1], alone[0][1] + alone[1][1], atol=1e-12)


def test_motor_lag_reaches_63_per_cent_after_its_time_constant(arpl_250g):
    model = build_model(arpl_250g, effects=[EffectUse("motor_lag", {"time_constant": 0.05})])
    step = step_function(model)
    state = model.initial_state(np.array([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0]))
    start, target = arpl_250g.hover_speed, 1500.0
    assert_allclose(state[13:], start)
    for _ in range(50):
        state = np.array(step(state, np.full(4, target), model.parameter_values, ENVIRONMENT_DEFAULT, 0, 1e-3)).ravel()
    assert_allclose((state[13:] - start) / (target - start), 1 - np.exp(-1), rtol=1e-6)


def test_lagging_rotors_push_with_their_real_speed(arpl_250g):
    now = moment(arpl_250g, 0)
    real = now.speed[::-1]
    lagging = observed(now, EffectUse("motor_lag", {"time_constant": 0.05}), hidden=real)
    at_once = observed(Moment(now.vehicle, now.state, real, now.environment))
    assert_allclose(lagging[0], at_once[0])
    assert_allclose(lagging[1], at_once[1])


def test_a_gust_pushes_like_the_wind_of_its_moment(arpl_250g):
    now = moment(arpl_250g, 0)
    blowing = np.array([2.0, -1.0, 0.5])
    gust = added(now, EffectUse("gust", {"coefficient": 2e-5}), hidden=blowing)
    steady = added(now, use("wind", {**dict(zip("xyz", blowing, strict=True)), "coefficient": 2e-5}))
    assert_allclose(gust[0], steady[0], atol=1e-12)


def test_gusts_have_their_standard_deviation_and_correlation_time(arpl_250g):
    intensity, correlation_time, dt, count = 2.0, 0.1, 0.01, 200
    model = build_model(
        arpl_250g, effects=[EffectUse("gust", {"intensity": intensity, "correlation_time": correlation_time})]
    )
    step = step_function(model).map(count)
    random = np.random.default_rng(7)
    state = np.tile(model.initial_state(np.array([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0]))[:, None], (1, count))
    speed, lag, history = np.full((4, count), arpl_250g.hover_speed), round(correlation_time / dt), []
    for _ in range(400):
        noise = random.normal(size=(3, count)) / np.sqrt(dt)
        after = step(state, speed, model.parameter_values, ENVIRONMENT_DEFAULT, noise, dt)
        state = np.array(after)
        state[:13] = np.array([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0])[:, None]  # hold the vehicle still
        history.append(state[13:])
    settled = np.array(history)[10 * lag :]  # (time, axis, gust)
    assert_allclose(settled.std(axis=(0, 2)), [intensity, intensity, intensity / 2], rtol=0.05)
    assert_allclose(settled.mean(axis=(0, 2)), 0.0, atol=0.15)
    correlation = (settled[lag:] * settled[:-lag]).mean(axis=(0, 2)) / settled.var(axis=(0, 2))
    assert_allclose(correlation, np.exp(-1), atol=0.06)


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_a_sensors_fault_changes_its_reading_and_no_motion(arpl_250g, name):
    now, values = moment(arpl_250g, 0), SENSOR_FAULTS[name]
    force, torque = added(now, use(name, values))
    assert_allclose(np.concatenate([force, torque]), 0.0, atol=1e-15)
    assert not CATALOGUE[name].moves_vehicle
    still = dict.fromkeys(("pose_age", "attitude_age", "rotor_age"), 0.0)
    expected = {"force": FORCE, "rate": RATE, "speed": SPEED, "pose_arm": [0, 0, 0]} | still | READINGS[name](values)
    for quantity, value in reading(arpl_250g, use(name, values)).items():
        assert_allclose(value.squeeze(), expected[quantity], rtol=2e-3 if name == "imu_misalignment" else 1e-12)


def test_sensors_stay_where_they_were_when_the_centre_of_mass_moves(arpl_250g):
    moved = {"x": 0.01, "y": -0.004, "z": 0.002}
    read = reading(arpl_250g, use("centre_of_mass", moved))
    assert_allclose(read["force"], FORCE + at(-axes(moved)))
    assert_allclose(read["pose_arm"], -axes(moved))
    ideal = reading(arpl_250g, use("centre_of_mass", moved | {"sensors_stay": 0.0}))
    assert_allclose(ideal["force"], FORCE)
    assert CATALOGUE["centre_of_mass"].moves_vehicle


def reading(vehicle, *uses):
    """The sensors' readings of FORCE, RATE and SPEED, and the pose's ages and arm."""
    model = build_model(vehicle, effects=uses)
    read = model.measure(FORCE, RATE, SPEED, model.parameter_values, ANGULAR)
    names = ("force", "rate", "speed", "pose_age", "attitude_age", "pose_arm", "gyro_axes", "rotor_age")
    values = {name: np.array(value).ravel() for name, value in zip(names, read, strict=True)}
    return values | {"rate": quaternion.rotate_inverse(values.pop("gyro_axes"), values["rate"])}


def test_rotors_that_speed_up_twist_the_body_against_their_turning(arpl_250g):
    model = build_model(arpl_250g, effects=[EffectUse("rotor_gyroscopic", {"inertia": 2e-6})])
    level = np.array([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0])
    arguments = (level, np.full(4, 1000.0), np.array([100.0, 0, 0, 0]), model.parameter_values, ENVIRONMENT_DEFAULT)
    angular = np.array(model.respond(*arguments)[1]).ravel()
    assert angular[2] == pytest.approx(arpl_250g.rotors.spin[0] * 2e-6 * 100.0 / arpl_250g.body.inertia[2])
    assert_allclose(angular[:2], 0.0, atol=1e-12)


def test_a_slung_load_swings_with_the_period_of_its_line(arpl_250g):
    length, small = 0.4, 0.02
    model = build_model(arpl_250g, effects=[EffectUse("slung_load", {"mass": 1e-6, "length": length})])
    step = step_function(model)
    level = np.array([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0])
    state = np.concatenate([level, [np.sin(small), 0, -np.cos(small), 0, 0, 0]])
    speed, dt, along = np.full(4, arpl_250g.hover_speed), 0.002, []
    for _ in range(round(2 * np.pi * np.sqrt(length / 9.81) / dt)):
        state = np.array(step(state, speed, model.parameter_values, ENVIRONMENT_DEFAULT, 0, dt)).ravel()
        state[:13] = level
        along.append(state[13])
    assert along[-1] == pytest.approx(small * np.exp(-0.05 * len(along) * dt), rel=2e-3)
    assert min(along) == pytest.approx(-small, rel=0.05)
