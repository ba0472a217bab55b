"""The inputs of `alula_tick`: vehicle, limits, messages and link, each from the one place that has them in Python."""

from __future__ import annotations

import ctypes
from math import inf
from typing import Any

from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import Vehicle
from runtime.control.controller import HISTORY, Controller
from runtime.flight import consistent_velocity
from runtime.flight.health import HealthLimits
from runtime.flight.last_setpoint import TRANSIT
from runtime.flight.thrust import ThrustMap
from runtime.flight.tick_plan import TickPlan
from runtime.link import odometry, peer
from runtime.link.clock import VehicleClock
from runtime.link.dialect import mavlink
from runtime.link.estimate import EstimateLimits, EstimateMonitor
from runtime.link.signing import SETPOINTS_LINK, Signing

UNHEARD = -1


def fits(controller: Controller, library: Any) -> bool:
    """Whether a controller is one that the tick in C can fly: not of a network, whose history Python keeps."""
    structs = library.structs
    states, rotors = controller.model.state_count, controller.model.input_count
    places = len(controller.solver.rotor_speed_places)
    return (
        not controller.is_learned
        and states * ctypes.sizeof(ctypes.c_double) <= structs["alula_result"].measured.size
        and rotors * ctypes.sizeof(ctypes.c_double) <= structs["alula_result"].rotor_speed.size
        and places * ctypes.sizeof(ctypes.c_int32) <= structs["alula_vehicle"].lag_start.size
    )


def write_messages(messages: Any) -> None:
    """The messages of the dialect, by rising id."""
    kinds = sorted(mavlink.mavlink_map.items())
    messages.count = len(kinds)
    for place, (number, kind) in enumerate(kinds):
        messages.id[place], messages.extra[place] = number, kind.crc_extra
        messages.size[place] = kind.unpacker.size


def write_limits(limits: Any, estimates: EstimateLimits, health: HealthLimits) -> None:
    """Limits that an estimate has to keep, and how the wire's numbers become a state."""
    for name in (
        "position_noise", "velocity_noise", "attitude_noise", "max_acceleration", "max_rate", "attitude_length",
        "max_distance", "max_speed", "forgotten_after",
    ):  # fmt: skip
        setattr(limits, name, getattr(estimates, name))
    limits.max_stamp_age, limits.max_stamp_ahead = peer.MAX_STAMP_AGE, peer.MAX_STAMP_AHEAD
    limits.stale, limits.oldest = health.stale, health.oldest
    limits.mean_time, limits.max_gap = consistent_velocity.TIME, consistent_velocity.MAX_GAP
    limits.max_mismatch = consistent_velocity.MAX_MISMATCH
    limits.max_correction = consistent_velocity.MAX_CORRECTION
    for place, (first, factor, second, other) in enumerate(odometry.ROWS):
        limits.first[place], limits.factor[place] = first, factor
        limits.second[place], limits.other[place] = second, other


def write_vehicle(target: Any, vehicle: Vehicle, controller: Controller, thrust_map: ThrustMap) -> None:
    """The vehicle, its controller and the autopilot's thrust curve. vehicle: as it hovers."""
    options, model = controller.options, controller.model
    lead, lookahead, leads_lag = controller.leads
    target.rate_limit[:], target.thrust_limit = vehicle.limits.rate, vehicle.thrust_limits[1]
    target.thrust_max = thrust_map.thrust_max
    target.vehicle_curve, target.autopilot_curve = thrust_map.vehicle_curve, thrust_map.autopilot_curve
    target.thrust_constants[: model.input_count] = controller.thrust_constants.tolist()
    target.node, target.max_step, target.delay = options.problem.node, controller.max_step, options.delay
    target.lead[:], target.lookahead[:], target.leads_lag = lead.tolist(), lookahead.tolist(), leads_lag
    places = controller.solver.rotor_speed_places
    target.lag_count = len(places)
    target.lag_start[: len(places)] = [place.start for place in places]
    target.hidden_count = model.state_count - RIGID_BODY_STATES


def write_solver(target: Any, controller: Controller) -> None:
    """The functions and the memory of a controller's solver."""
    addresses = controller.solver.addresses
    target.handle, target.propagate, target.feedback = addresses.handle, addresses.propagate, addresses.feedback
    target.check = addresses.check
    target.states, target.inputs = addresses.states, addresses.inputs
    target.state_count, target.rotor_count = controller.model.state_count, controller.model.input_count


def write_plan(target: Any, plan: TickPlan, *, not_before: float = -inf) -> None:
    """One tick. not_before: s, arrival of the first estimate that is due."""
    commands = plan.controller.commands
    target.command_times, target.command_inputs = commands.times.ctypes.data, commands.inputs.ctypes.data
    target.hidden_states, target.commands, target.history = commands.hidden.ctypes.data, commands.total, HISTORY
    target.not_before, target.has_before = not_before, plan.before is not None
    if plan.before is not None:
        target.before_time, target.before_state[:] = plan.before.time, plan.before.state.tolist()
    target.correction[:] = plan.correction.tolist()
    target.tilt_rate, target.hands_over = plan.tilt_rate, plan.hand_over is not None
    if (hand_over := plan.hand_over) is not None:
        target.hand_over_started, target.hand_over_duration = hand_over.started, hand_over.duration
        target.hand_over_thrust = hand_over.collective_thrust
    target.effectiveness = plan.effectiveness
    target.last_setpoint = None if plan.last_setpoint is None else ctypes.addressof(plan.last_setpoint)
    target.transit, target.thrust_now = TRANSIT, plan.last_thrust


def write_link(
    target: Any,
    *,
    vehicle: tuple[int, int],
    own: tuple[int, int],
    clock: VehicleClock,
    estimates: EstimateMonitor,
) -> None:
    """The link's ends, by system and component, the vehicle's clock and the newest estimate."""
    (target.system, target.component), (target.own_system, target.own_component) = vehicle, own
    target.clock_updated, target.clock_offset, target.clock_drift, target.clock_valid_until = clock.conversion
    latest = estimates.latest
    target.has_latest = latest is not None and latest.source == "ODOMETRY" and latest.is_synchronised
    if latest is not None and target.has_latest:
        target.latest_time, target.latest_received = latest.time, latest.received
        target.latest_stamp, target.latest_reset = estimates.stamp, latest.reset_counter
        target.latest_state[:] = latest.state.tolist()


def write_signing(target: Any, signing: Signing, vehicle: tuple[int, int], last_timestamp: int) -> None:
    """The key, the clock and the streams of a signed link. last_timestamp: of a setpoint."""
    target.is_signed = signing.clock is not None
    if signing.clock is None:
        return
    target.ticks_base, target.ticks_origin = signing.clock.origin
    target.last_timestamp, target.link_id = last_timestamp, SETPOINTS_LINK
    target.key[:] = tuple(signing.secret)
    heard = signing.heard_from(vehicle)
    target.heard[:] = [heard.get(link_id, UNHEARD) for link_id in range(len(target.heard))]
