"""An effect from a user's own file flies like one of ours: on the simulated vehicle and in the controller's model."""

from pathlib import Path

from dynamics.integrators import required_steps
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from runtime.control.controller import Controller
from simulation.lockstep import fly_reference
from tests.support.own_effects import given_catalogue

TAU = 0.003  # s, a twentieth of a shooting node
LAG = '''
"""Rotors that follow their command, under other names than the catalogue's."""

from dynamics.effect import Effect, Hidden, Parameter, Prior

EFFECT = Effect(
    name="brisk_rotors",
    summary="Rotors follow their command",
    source="first-order lag",
    parameters=(Parameter("tau", "s", "time to 63 % of a step", 1e-3, 0.1, lambda _: Prior(0.01, 0.01)),),
    hidden=(Hidden("omega", "rad/s", lambda vehicle: vehicle.hover_speed, per_rotor=True),),
    rotor_speed=lambda _, hidden: hidden["omega"],
    derivative=lambda c, p, hidden, _: {"omega": (c.command - hidden["omega"]) / p["tau"]},
    time_constants=("tau",),
)
'''


def test_a_users_lag_is_integrated_in_steps_that_it_can_bear(arpl_250g: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "brisk_rotors.py"
    path.write_text(LAG)
    catalogue = given_catalogue([path], arpl_250g)
    vehicle = arpl_250g.with_effects(EffectUse("brisk_rotors", {"tau": TAU}))
    controller = Controller.build(vehicle, catalogue=catalogue)
    node = controller.solver.problem.node
    assert node / required_steps(controller.model, node) <= TAU
    flown = fly_reference(
        vehicle, named_reference("line:size=1", vehicle), controller=controller, catalogue=catalogue, seed=1
    )
    assert not flown.aborted
    assert flown.position_rmse < 0.05


def test_a_users_lag_moves_the_simulated_vehicle(arpl_250g: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "brisk_rotors.py"
    path.write_text(LAG)
    catalogue = given_catalogue([path], arpl_250g)
    ours, theirs = EffectUse("motor_lag", {"time_constant": 0.03}), EffectUse("brisk_rotors", {"tau": 0.03})
    flown = [
        fly_reference(arpl_250g, named_reference("line:size=1", arpl_250g), effects=[use], catalogue=catalogue, seed=1)
        for use in (ours, theirs)
    ]
    assert flown[0].position_rmse == flown[1].position_rmse
