"""A set of effects fitted to flights by the likelihood, for tests of its values and intervals."""

from collections.abc import Mapping, Sequence

from diagnosis.by_likelihood import fit_of, problems_of
from diagnosis.data.dataset import Dataset, make_dataset
from diagnosis.estimation.fitted import Fit
from diagnosis.likelihood.given_set import fit_set, nearest_members
from diagnosis.likelihood.identify import identify
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from flights import Flight

SENSORS = {name: CATALOGUE[name] for name in ("imu_bias", "gyro_bias", "time_delay")}


def fitted_to(flights: Sequence[Flight], vehicle: Vehicle, *uses: EffectUse) -> Fit:
    """Effects, begun near their values, fitted to flights beside faults of sensors as the only other candidates."""
    names = [use.name for use in (*uses, *vehicle.effects)]
    return fitted_on(make_dataset(flights, vehicle), vehicle, {**SENSORS, **{n: CATALOGUE[n] for n in names}}, *uses)


def fitted_on(dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], *uses: EffectUse) -> Fit:
    """Effects, begun near their values, fitted on a data set."""
    problems = problems_of(dataset, vehicle, catalogue)
    members = nearest_members(problems[0], uses)
    return fit_of(fit_set(problems, members).search, members)


def fitted_alone(flights: Sequence[Flight], vehicle: Vehicle, name: str) -> Fit:
    """An effect fitted to flights where it is likeliest of its grid, beside faults of sensors as other candidates."""
    catalogue = {**SENSORS, **{n: CATALOGUE[n] for n in (name, *(use.name for use in vehicle.effects))}}
    problems = problems_of(make_dataset(flights, vehicle), vehicle, catalogue)
    result = identify(problems, one_of=[i for i, c in enumerate(problems[0].what.all) if c.effect.name == name])
    return fit_of(result.search, result.best.members)
