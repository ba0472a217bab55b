"""The check before a flight that controller and rate loop together do not oscillate; pure."""

from __future__ import annotations

import msgspec
import numpy as np

from dynamics.autopilot_settings import AutopilotSettings
from dynamics.rate_loop import autopilot_gains, rate_controller, rate_loop
from dynamics.trim import FAR_FROM_GROUND
from dynamics.vehicle import Vehicle
from runtime.control.closed_loop import (
    HoverModel,
    Oscillation,
    Timing,
    closed_loop_poles,
    linear_controller,
    worst_damped,
)
from runtime.control.controller import Controller, ControllerOptions
from runtime.link.problem import Problem

MIN_DAMPING = 0.08  # ratio below which a flight begins with a warning; it is refused where the oscillation grows
RATE_WEIGHTS = (0.2, 0.5, 1.0, 2.0, 5.0)  # of roll and pitch, tried for an advice
SLOWER_GAINS = (0.7, 0.5, 0.35, 0.25)  # of the autopilot's own, the same


def solver_hover(controller: Controller) -> HoverModel:
    """The linear model of a controller's own predictions about its hover."""
    solver, model = controller.solver, controller.model
    state = model.initial_state(np.array([0.0, 0.0, FAR_FROM_GROUND, *[0.0] * 3, 1.0, *[0.0] * 6]))
    for place in solver.rotor_speed_places:
        state[place] = solver.trim.rotor_speed
    return HoverModel(
        lambda x, u, seconds: solver.propagate(x, u, seconds).copy(),
        state,
        solver.trim.rotor_speed,
        solver.rotor_speed_places,
    )


def oscillation_problem(controller: Controller, vehicle: Vehicle, gains: AutopilotSettings | None) -> Problem | None:
    """Why controller and autopilot would oscillate on the vehicle of the file; None where they are damped.

    controller: of the vehicle file's model. gains: of the autopilot; None for those of the file.
    """
    if controller.is_learned:
        return None  # its columns are not those of a hover
    gains = gains or autopilot_gains(vehicle)
    hover = solver_hover(controller)
    oscillation = _oscillation(controller, hover, vehicle, gains, controller.options)
    if oscillation.damping >= MIN_DAMPING:
        return None
    loop = rate_loop(vehicle, gains=gains)
    what = "would oscillate, more and more," if not oscillation.is_stable else "would oscillate"
    text = (
        f"Controller and autopilot {what} at {oscillation.frequency:.1f} Hz (damping {oscillation.damping:.2f}, wanted "
        f"{MIN_DAMPING:g}): rates are held with a gain of {loop.tilt_speed:.1f} 1/s behind motors that lag "
        f"by {1e3 * loop.motor_lag:.0f} ms. {_advice(controller, hover, vehicle, gains)}"
    )
    return Problem("warning" if oscillation.is_stable else "error", text)


def _advice(controller: Controller, hover: HoverModel, vehicle: Vehicle, gains: AutopilotSettings) -> str:
    """Advice that damps the loop, as far as it is one of the two that a user can turn."""
    for factor in SLOWER_GAINS:
        roll, pitch, yaw = gains.rate_gain
        slower = msgspec.structs.replace(gains, rate_gain=(factor * roll, factor * pitch, yaw))
        options = controller.options.for_autopilot(vehicle, slower)
        if _oscillation(controller, hover, vehicle, slower, options).damping >= MIN_DAMPING:
            return f"Lower MC_ROLLRATE_P and MC_PITCHRATE_P to {factor:g} of what they are (by MC_ROLLRATE_K, say)."
    for weight in RATE_WEIGHTS:
        weights = msgspec.structs.replace(controller.options.problem.weights, rate=(weight, weight, weight))
        problem = msgspec.structs.replace(controller.options.problem, weights=weights)
        options = msgspec.structs.replace(controller.options, problem=problem)
        if _oscillation(controller, hover, vehicle, gains, options).damping >= MIN_DAMPING:
            return f"Give --set controller.rate_weight=[{weight:g}, {weight:g}, {weight:g}], or tune the rate loop."
    return "Tune the autopilot's rate loop for these motors first, and check motor_lag and inertia of the vehicle file."


def _oscillation(
    controller: Controller, hover: HoverModel, vehicle: Vehicle, gains: AutopilotSettings, options: ControllerOptions
) -> Oscillation:
    linear = linear_controller(hover, options, controller.trim)
    inner = rate_controller(vehicle, gains)
    return worst_damped(closed_loop_poles(linear, hover, vehicle, inner, Timing(latency=options.delay)))
