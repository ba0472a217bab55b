"""Adding until nothing is left to add never makes a model worse, and every refusal has its numbers."""

import msgspec
import pytest

from diagnosis.addition import Addition, add_effect
from diagnosis.data.dataset import Dataset, make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse, Vehicle

SENSORS = ("imu_bias", "gyro_bias", "time_delay")
SOME = {n: CATALOGUE[n] for n in ("rotor_drag", "parasitic_drag", "mass", "inertia", "axial_inflow", *SENSORS)}
LIMIT = 1.01  # of an error after an addition over that before, where the effect does not act on it


@pytest.fixture(scope="module")
def plain(plain_flights, arpl_250g):
    return make_dataset(plain_flights, arpl_250g)


def wrong(vehicle: Vehicle, *, mass: float = 1.0, inertia: float = 1.0) -> Vehicle:
    """A vehicle file that states other values than the vehicle's by these factors."""
    body = msgspec.structs.replace(
        vehicle.body, mass=mass * vehicle.body.mass, inertia=tuple(inertia * i for i in vehicle.body.inertia)
    )
    return msgspec.structs.replace(vehicle, body=body)


def added_until_it_stops(dataset: Dataset, vehicle: Vehicle, catalogue) -> tuple[list[Addition], str]:
    """The additions, and why the next one was refused."""
    additions: list[Addition] = []
    while len(additions) < 5:
        try:
            additions.append(add_effect(None, dataset, vehicle, catalogue, date="2026-01-02"))
        except DataError as refusal:
            return additions, str(refusal)
        vehicle = additions[-1].vehicle
    raise AssertionError("it never stops")


def errors_never_rise(additions: list[Addition]) -> bool:
    channels = [(c.before, c.after) for added in additions for c in added.channels.values()]
    open_loop = [
        (getattr(was, name), getattr(now, name))
        for added in additions
        for was, now in zip(*added.open_loop, strict=True)
        for name in ("position", "velocity", "attitude", "rate")
    ]
    return all(now <= LIMIT * was for was, now in (*channels, *open_loop))


def test_three_wrong_values_are_corrected_jointly_and_then_nothing_is_added(plain, arpl_250g):
    vehicle = wrong(arpl_250g, mass=1.06, inertia=0.85).with_effects(EffectUse("rotor_drag", {"coefficient": 4e-6}))
    additions, refusal = added_until_it_stops(plain, vehicle, SOME)
    assert errors_never_rise(additions)
    assert "the model explains" in refusal
    values = {use.name: use.parameters for added in additions for use in added.vehicle.effects}
    assert values["mass"]["ratio"] == pytest.approx(1 / 1.06, rel=0.01)
    assert values["inertia"]["ratio_x"] == pytest.approx(1 / 0.85, rel=0.02)
    assert values["rotor_drag"]["coefficient"] < 4e-7
    line = additions[0].vehicle.history[-1].action
    assert all(key in line for key in additions[0].keys)
    assert all(c.after < 1.1 * c.floor for c in additions[-1].channels.values())


def test_additions_from_the_same_flights_are_compared_with_the_first(plain, arpl_250g):
    heavy, some = wrong(arpl_250g, mass=1.06), {n: CATALOGUE[n] for n in ("mass", *SENSORS)}
    added = add_effect(None, plain, heavy, some, date="2026-01-02")
    (entry,) = added.vehicle.history
    once = {kind: 0.95 * error for kind, error in entry.after.items()}  # it was better when these flights came first
    drifted = msgspec.structs.replace(heavy, history=(msgspec.structs.replace(entry, before=once),))
    with pytest.raises(DataError, match=r"mass was not added: .* before the first effect .*imu: [\d.]+ at first"):
        add_effect(None, plain, drifted, some, date="2026-01-02")
    others = msgspec.structs.replace(entry, before=once, flights=("other 0",))
    assert add_effect(None, plain, msgspec.structs.replace(heavy, history=(others,)), some, date="2026-01-02")


def test_what_no_effect_explains_never_leads_to_a_worse_model(plain, arpl_250g):
    others = {n: e for n, e in SOME.items() if n != "mass"}
    additions, _ = added_until_it_stops(plain, wrong(arpl_250g, mass=1.1), others)
    assert errors_never_rise(additions)


def test_what_is_too_small_to_matter_is_listed_and_not_named(plain, arpl_250g):
    diagnosis = diagnose_dataset(plain, wrong(arpl_250g, inertia=0.996), SOME).diagnosis
    assert diagnosis.verdict == "explained"
    assert diagnosis.effects == ()
    refused = next(r for r in diagnosis.refused if r.name == "inertia")
    assert refused.reason == "too_small"
    assert refused.parameters["ratio_x"] == pytest.approx(1 / 0.996, abs=0.008)
    assert not refused.is_hint


@pytest.mark.parametrize("name", ["axial_inflow", "inertia", "imu_bias"])
def test_an_effect_that_is_not_there_is_refused_with_its_reason(plain, arpl_250g, name):
    reason = r"these flights make it [\d.e-]+ times as likely as not, and 20 times are required"
    with pytest.raises(DataError, match=rf"{name} was not added: {reason}"):
        add_effect(name, plain, arpl_250g, SOME, date="2026-01-02")
