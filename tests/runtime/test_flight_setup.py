"""A flight is put together from the user's options, and the recording keeps what was flown."""

from pathlib import Path

import pytest

from dynamics.errors import RequestError
from dynamics.vehicle_file import parse_vehicle
from runtime.control.adaptation_settings import Mode
from runtime.flight_setup import FOLLOWED, VEHICLE_TEXT, FlightSetup, prepare_flight

LINK = "udpin:127.0.0.1:14999"


def test_settings_are_flown_and_recorded() -> None:
    setup = FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g", settings=("controller.horizon=0.8",))
    flight = prepare_flight(setup)
    assert flight.vehicle.controller.horizon == 0.8
    assert parse_vehicle(flight.request.attachments[VEHICLE_TEXT]) == flight.vehicle


def test_without_settings_the_file_is_recorded_as_it_is() -> None:
    flight = prepare_flight(FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g"))
    assert flight.request.attachments[VEHICLE_TEXT].startswith("# The 250 g quadrotor")


def test_the_rate_is_the_vehicles_unless_the_user_gives_one() -> None:
    setup = FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g", settings=("controller.rate=200",))
    assert prepare_flight(setup).request.rate == 200.0
    assert prepare_flight(setup).request.settings.bounds.shifted_ticks == 20  # the same 0.1 s as at 100 Hz
    assert prepare_flight(FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g")).request.rate == 100.0
    with pytest.raises(RequestError, match="longer than a node"):
        prepare_flight(
            FlightSetup(
                link=LINK, reference="circle", vehicle="arpl_250g", rate=20.0, settings=("controller.nodes=40",)
            )
        )


def test_health_limits_follow_the_vehicles_rates() -> None:
    health = {
        name: prepare_flight(FlightSetup(link=LINK, reference="hover", vehicle=name)).request.settings.health
        for name in ("arpl_250g", "px4_sih")
    }
    assert (health["arpl_250g"].unfollowed, health["arpl_250g"].swing, health["arpl_250g"].chatter) == (3.0, 2.0, 1.5)
    assert health["px4_sih"].unfollowed == 1.5
    assert health["px4_sih"].rate_delay > 2 * health["arpl_250g"].rate_delay


@pytest.mark.parametrize(
    ("adapt", "follow", "reason"),
    [
        ("off", ("wind",), "needs --adapt"),
        ("on", ("gust",), "gust cannot be followed"),
        ("shadow", ("nonsense",), "not in the catalogue"),
    ],
)
def test_what_cannot_follow_is_refused_before_the_flight(adapt: Mode, follow: tuple[str, ...], reason: str) -> None:
    setup = FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g", adapt=adapt, follow=follow)
    with pytest.raises(RequestError, match=reason):
        prepare_flight(setup)


def test_wind_and_drag_follow_unless_the_user_names_others() -> None:
    usual = prepare_flight(FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g", adapt="shadow"))
    assert usual.request.adaptation.follow == FOLLOWED
    own = FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g", adapt="on", follow=())
    assert prepare_flight(own).request.adaptation.follow == ()
    assert prepare_flight(own).request.adaptation.mode == "on"
    off = prepare_flight(FlightSetup(link=LINK, reference="circle", vehicle="arpl_250g"))
    assert off.request.adaptation.mode == "off"


@pytest.mark.parametrize(
    ("record", "limit", "reason"), [(None, 50_000_000, "give --record DIR"), (Path("DIR"), 1_000_000, "at least 5 MB")]
)
def test_a_limit_of_a_recording_that_bounds_nothing_is_refused(record: Path | None, limit: int, reason: str) -> None:
    setup = FlightSetup(link=LINK, reference="hover", vehicle="arpl_250g", record=record, record_limit=limit)
    with pytest.raises(RequestError, match=reason):
        prepare_flight(setup)
