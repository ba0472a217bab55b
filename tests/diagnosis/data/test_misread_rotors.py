"""Units of rotor speeds and misread rotors follow from the vehicle's weight and moments, and not from other rotors."""

import numpy as np
import pytest

from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import make_dataset
from diagnosis.data.inspected import inspected
from diagnosis.data.misread_rotors import misread_rotors, reading_shares
from diagnosis.data.segment import segments
from dynamics.errors import DataError
from dynamics.speed_units import unit_of
from tests.diagnosis.conftest import with_columns

RPM = 60 / (2 * np.pi)


def judge(flights, vehicle):
    require_answerable(make_dataset(flights, vehicle).everything, vehicle)


def all_segments(flights, vehicle):
    return [segment for flight in flights for segment in segments(flight, vehicle)]


def scaled(factors):
    return {f"rotor_speed_{i}": (lambda old, factor=factor: old * factor) for i, factor in enumerate(factors)}


@pytest.mark.parametrize(
    ("factor", "says"),
    [(7.0, "7 pole pairs; divide by 7"), (6.0, "6 pole pairs; divide by 6"), (12.0, "12 pole pairs"),
     (7.0 * RPM, "7 pole pairs, in rpm"), (RPM, "in rpm"), (1 / RPM, "twice"), (1 / (2 * np.pi), "rev/s"),
     (0.1, "a factor of 10, which is no unit"), (10.0, "a factor of 10, which is no unit"),
     (100.0, "a factor of 100, which is no unit"), (1 / 7, "divided by 7 pole pairs twice")],
)  # fmt: skip
def test_the_unit_is_named_and_what_fits_none_is_a_factor(changed, arpl_250g, factor, says):
    with pytest.raises(DataError, match=rf"speeds are [0-9.e+]+ times what the thrust needs: .*{says}") as refused:
        judge(changed(**scaled([factor] * 4)), arpl_250g)
    if "factor" in says:
        assert "rpm" not in str(refused.value)


def test_a_factor_between_all_units_is_a_factor():
    assert unit_of(0.045) == "a factor of 0.045, which is no unit of speeds"


def test_the_unit_is_told_of_a_flight_that_is_too_short_for_all_else(plain_flights, changed, arpl_250g):
    flights = [flight.rows(0, 900) for flight in changed(**scaled([7.0] * 4))[:2]]
    with pytest.raises(DataError, match="divide by 7"):
        require_answerable(all_segments(flights, arpl_250g), arpl_250g)


@pytest.mark.parametrize("wrong", [(1, 3), (0, 1), (0, 2, 3)])
def test_several_misread_rotors_are_named_and_only_these(changed, arpl_250g, wrong):
    factors = [1.0] * 4
    for rotor, factor in zip(wrong, (0.55, 0.18, 0.4), strict=False):
        factors[rotor] = factor
    flights = changed(**scaled(factors))[:3]
    shares = reading_shares(all_segments(flights, arpl_250g), arpl_250g)
    assert shares is not None
    np.testing.assert_allclose(shares, factors, rtol=0.05)
    assert misread_rotors(shares) == list(wrong)
    used, findings = inspected(flights, arpl_250g)  # these have commands, which are then used instead
    assert not any(flight.has("rotor_speed") for flight in used)
    (fault,) = (finding for finding in findings if finding.name == "rotor_speed_fault")
    commands = {name: None for name in flights[0].columns if "command" in name}
    with pytest.raises(DataError, match="times the speed that weight and moments need") as refused:
        inspected([with_columns(flight, commands) for flight in flights], arpl_250g)
    for text in (fault.text, str(refused.value)):
        assert [rotor for rotor in range(4) if f"rotor {rotor} (" in text] == list(wrong)
