"""Inertia: the vehicle has other moments of inertia than in its file."""

from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Values
from dynamics.excitation import DRIVE, QUICK_TURNS, Excitation
from dynamics.vehicle import Vehicle


def usual(_: Vehicle) -> Prior:
    """A tenth more than in the vehicle file."""
    return Prior(1.1, 0.2)


def physics(body: Physics, p: Values, _: Environment, __: int | None) -> Physics:
    """Each principal moment times its ratio."""
    return replace(body, inertia=body.inertia * ca.vertcat(p["ratio_x"], p["ratio_y"], p["ratio_z"]))


EFFECT = Effect(
    name="inertia",
    summary="Other moments of inertia than the vehicle file's",
    source="PI-TCN eq. 1",
    parameters=tuple(
        Parameter(f"ratio_{axis}", "1", f"real moment about body {axis} over the file's", 0.2, 5.0, usual, neutral=1.0)
        for axis in "xyz"
    ),
    physics=physics,
    excitation=Excitation(
        (("rate",), (*DRIVE, "torque_command")),
        measure="tilting_acceleration",
        weak=2.0,
        enough=8.0,
        flight=QUICK_TURNS,
        manoeuvre="fast rolls, pitches and yaw steps",
    ),
)
