"""The catalogue: every physical effect that Alula knows by name, one module each."""

from collections.abc import Mapping

from dynamics.effect import Effect
from dynamics.effects import (
    axial_inflow,
    battery_sag,
    blade_flapping,
    centre_of_mass,
    ground_effect,
    gust,
    mass,
    motor_lag,
    parasitic_drag,
    rotor_drag,
    thrust_constant,
    translational_lift,
    weak_rotor,
    wind,
)

CATALOGUE: Mapping[str, Effect] = {
    module.EFFECT.name: module.EFFECT
    for module in (
        rotor_drag,
        parasitic_drag,
        blade_flapping,
        motor_lag,
        wind,
        gust,
        ground_effect,
        axial_inflow,
        translational_lift,
        mass,
        centre_of_mass,
        thrust_constant,
        weak_rotor,
        battery_sag,
    )
}
