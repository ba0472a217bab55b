"""Several components as one model: values by name, one state space, one spectrum, one prior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.noise.component import AXES, CHANNELS, OF_ROTORS, Component, FlightConditions, Hyperparameter, Values
from diagnosis.noise.linear_model import LinearModel, compose, renamed
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Composition:
    """Components that are in a set of logs at once; a value's name is `component.parameter`.

    Raises ValueError when a component occurs twice or lacks one that it needs.
    """

    components: tuple[Component, ...]

    def __post_init__(self) -> None:
        names = [component.name for component in self.components]
        for component in self.components:
            if names.count(component.name) > 1:
                raise ValueError(f"{component.name} occurs twice among {', '.join(names)}; leave one out.")
            if lacking := set(component.needs) - set(names):
                raise ValueError(
                    f"{component.name} shares noises of {', '.join(sorted(lacking))}; compose it with these."
                )

    @property
    def parameters(self) -> Mapping[str, Hyperparameter]:
        """All hyperparameters by name."""
        return {f"{component.name}.{p.name}": p for component in self.components for p in component.parameters}

    def medians(self, vehicle: Vehicle) -> dict[str, float]:
        """The priors' medians, within the bounds."""
        return {n: min(max(p.prior(vehicle).median, p.lower), p.upper) for n, p in self.parameters.items()}

    def log_prior(self, values: Values, vehicle: Vehicle) -> float:
        """Logarithm of the prior density of the values' logarithms."""
        return sum(p.prior(vehicle).log_density(values[name]) for name, p in self.parameters.items())

    def model(self, values: Values, conditions: FlightConditions) -> LinearModel:
        """The state space of all components; its states and noises are named `component.name`.

        Raises ValueError for an output that is none of the channels.
        """
        model = compose(self.parts(values, conditions))
        rotors = range(conditions.vehicle.rotors.count)
        places = {name: rotors if name in OF_ROTORS else AXES for name in CHANNELS}
        channels = {*CHANNELS, *(output for name, each in places.items() for output in outputs_of(name, each))}
        if unknown := [output for output in model.outputs if output not in channels]:
            raise ValueError(f"outputs {', '.join(unknown)} are no channels; see diagnosis.noise.component.CHANNELS.")
        return model

    def parts(
        self, values: Values, conditions: FlightConditions, at_others: Sequence[LinearModel] = (), moved: str = ""
    ) -> list[LinearModel]:
        """The state space of each component. at_others: those at values of which one has
        moved since: they are taken where that is none of theirs."""
        if not at_others:
            return [renamed(c.model(_values_of(c, values), conditions), c.name) for c in self.components]
        return [
            renamed(c.model(_values_of(c, values), conditions), c.name) if _depends(c, moved) else part
            for c, part in zip(self.components, at_others, strict=True)
        ]

    def spectrum(self, values: Values, conditions: FlightConditions, frequency: Floats) -> dict[str, Floats]:
        """Two-sided power density of each output in hover, unit^2/Hz: the sum of the components'."""
        total: dict[str, Floats] = {}
        for component in self.components:
            for output, density in component.spectrum(_values_of(component, values), conditions, frequency).items():
                total[output] = total.get(output, np.zeros(len(frequency))) + density
        return total


def outputs_of(channel: str, places: Sequence[object] | range) -> list[str]:
    """Names of a channel's outputs: `force_x`, `rotor_speed_0`."""
    return [f"{channel}_{place}" for place in places]


def _depends(component: Component, moved: str) -> bool:
    """Whether a component's state space can depend on a value: on its own, and on those of what it needs."""
    return moved.partition(".")[0] in (component.name, *component.needs)


def _values_of(component: Component, values: Values) -> dict[str, float]:
    own = {p.name: values[f"{component.name}.{p.name}"] for p in component.parameters}
    return {**values, **own}
