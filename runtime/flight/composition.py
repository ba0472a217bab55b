"""The composition of the flight logic: the same over a link, in simulation and in a replay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle
from runtime.control.bundle import Bundle
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.decision import FlyerSettings
from runtime.flight.flyer import Flyer
from runtime.flight.last_setpoint import USUAL_LOSS_TIME
from runtime.flight.mission import Mission, Plan
from runtime.flight.motion import Motion
from runtime.flight.thrust import ThrustMap
from runtime.link.start_conditions import VehicleFacts

WARM_UP_TICKS = 20
WARM_UP_AGE = 0.02  # s, of the estimates


class Controllers(NamedTuple):
    """The controllers of a flight. nominal: of the vehicle file's model, the fallback of a learned one's."""

    flying: Controller
    nominal: Controller | None = None


def build_controllers(vehicle: Vehicle, bundle: Bundle | None, options: ControllerOptions) -> Controllers:
    """Build the controllers. bundle: of a learned model, None for the vehicle file's model."""
    if bundle is None:
        return Controllers(Controller.build(vehicle, options))
    return Controllers(Controller.from_bundle(bundle, options), Controller.fallback_from_bundle(bundle, options))


def use_lookaheads(controllers: Controllers, options: ControllerOptions) -> None:
    """Let all controllers look ahead as far as these options say."""
    for controller in filter(None, controllers):
        controller.use_lookaheads(options)


def build_flyer(
    controllers: Controllers,
    reference: Motion,
    plan: Plan,
    settings: FlyerSettings,
    *,
    thrust_curve: float,
    loss_time: float = USUAL_LOSS_TIME,
) -> Flyer:
    """Build the flight logic for the vehicle as it hovers.

    thrust_curve: the autopilot's THR_MDL_FAC. loss_time: its COM_OF_LOSS_T, s.
    """
    trim = controllers.flying.trim
    return Flyer(
        trim,
        controllers.flying,
        Mission(trim, reference, plan),
        ThrustMap(trim.rotors.thrust_max, trim.rotors.thrust_curve, thrust_curve),
        settings,
        nominal=controllers.nominal,
        loss_time=loss_time,
    )


def vehicle_facts(trim: Vehicle) -> VehicleFacts:
    """Facts that the autopilot's parameters must agree with. trim: the vehicle as it hovers."""
    rotors = trim.rotors

    def hover_thrust(thrust_curve: float) -> float:
        return ThrustMap(rotors.thrust_max, rotors.thrust_curve, thrust_curve).setpoint(trim.weight)

    return VehicleFacts(rotors.count, hover_thrust)


def warm_up(controllers: Controllers, reference: Motion, plan: Plan, *, rate: float) -> None:
    """Run the controllers for some ticks: what a process does for the first time takes tens of milliseconds."""
    for controller in controllers:
        if controller is not None:
            _warm_up(controller, reference, plan, rate)


def _warm_up(controller: Controller, reference: Motion, plan: Plan, rate: float) -> None:
    state = reference.states(np.zeros(1))[0]
    mission = Mission(controller.trim, reference, plan)
    mission.ramp(state, 0.0)
    mission.climb(state, 0.0)
    controller.reset(state, 0.0)
    for tick in range(WARM_UP_TICKS):
        now = tick / rate
        states, inputs = mission.window(controller.node_times(now), state[ATTITUDE])
        controller.prepare(states, inputs[:-1])
        controller.feedback(controller.compensate(state, now - WARM_UP_AGE, now), now)
