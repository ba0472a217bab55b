"""The catalogue: the physical effects that ship with Alula, one module each."""

from collections.abc import Mapping

from dynamics.effect import Effect
from dynamics.effects import (
    axial_inflow,
    battery_sag,
    blade_flapping,
    centre_of_mass,
    ground_effect,
    gust,
    gyro_bias,
    imu_bias,
    inertia,
    linear_drag,
    mass,
    motor_lag,
    parasitic_drag,
    rotational_damping,
    rotor_cant,
    rotor_drag,
    rotor_gyroscopic,
    rotor_speed_fault,
    slung_load,
    thrust_constant,
    time_delay,
    torque_constant,
    translational_lift,
    wall_effect,
    weak_rotor,
    wind,
)

CATALOGUE: Mapping[str, Effect] = {
    module.EFFECT.name: module.EFFECT
    for module in (
        rotor_drag,
        linear_drag,
        parasitic_drag,
        rotational_damping,
        wind,
        gust,
        ground_effect,
        wall_effect,
        translational_lift,
        axial_inflow,
        blade_flapping,
        rotor_gyroscopic,
        motor_lag,
        battery_sag,
        weak_rotor,
        rotor_cant,
        thrust_constant,
        torque_constant,
        inertia,
        mass,
        centre_of_mass,
        slung_load,
        imu_bias,
        gyro_bias,
        time_delay,
        rotor_speed_fault,
    )
}
