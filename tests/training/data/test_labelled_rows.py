"""Flights as tables: body-frame inputs do not depend on yaw, windows lie in one flight, wrong vehicles are refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import msgspec
import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from flights import Flight
from flights.filters import PAPER_CUTOFF, lowpass
from training.config import ModelConfig
from training.data.labelled_rows import label_rows, with_logged_motors
from training.data.logged_flights import LoggedFlight
from training.models import named_kind
from training.prediction import flight_errors

BODY = named_kind("mse_tcn").config


def changed(recording: LoggedFlight, columns: Callable[[Flight], dict[str, Floats | None]]) -> LoggedFlight:
    """The recording with columns replaced; None leaves one out."""

    def of(flight: Flight) -> Flight:
        replaced = {**flight.columns, **columns(flight)}
        present = {name: values for name, values in replaced.items() if values is not None}
        return Flight(flight.time, present, flight.provenance)

    return dataclasses.replace(recording, segments=tuple(of(segment) for segment in recording.segments))


def yawed(flight: Flight) -> dict[str, Floats | None]:
    turn = np.array([np.cos(0.6), 0.0, 0.0, np.sin(0.6)])
    values: dict[str, Floats | None] = {}
    for name in ("position", "velocity"):
        turned = quaternion.rotate(turn, flight[name])
        values |= {f"{name}_{axis}": turned[:, place] for place, axis in enumerate("xyz")}
    attitude = quaternion.multiply(turn, flight["attitude"])
    return values | {f"attitude_{axis}": attitude[:, place] for place, axis in enumerate("wxyz")}


@pytest.mark.parametrize("base", ["none", "nominal"])
def test_body_frame_columns_and_targets_do_not_depend_on_yaw(
    arpl_250g: Vehicle, recordings: Sequence[LoggedFlight], base: str
) -> None:
    config = msgspec.structs.replace(BODY, base=base, outputs="wrench" if base == "nominal" else "body")
    plain = label_rows(config, arpl_250g, recordings[:1])
    turned = label_rows(config, arpl_250g, [changed(recordings[0], yawed)])
    np.testing.assert_allclose(turned.inputs, plain.inputs, atol=1e-9)
    np.testing.assert_allclose(turned.targets[plain.ends], plain.targets[plain.ends], atol=1e-6)


def test_windows_hold_the_rows_before_their_end_and_of_one_flight(
    arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]
) -> None:
    data = label_rows(BODY, arpl_250g, recordings)
    first = data.ends - (BODY.history - 1)
    np.testing.assert_array_equal(data.flight_of[first], data.flight_of[data.ends])
    np.testing.assert_allclose(data.time[data.ends] - data.time[first], 0.19, atol=1e-6)
    assert len(data.ends) > 0.9 * len(data.time)


def test_a_gap_costs_its_windows_and_no_more(arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]) -> None:
    def torn(flight: Flight) -> dict[str, Floats | None]:
        values = flight["rotor_command_1"].copy()
        values[300:310] = np.nan
        return {"rotor_command_1": values}

    complete = label_rows(BODY, arpl_250g, recordings[:1])
    data = label_rows(BODY, arpl_250g, [changed(recordings[0], torn)])
    assert set(complete.ends) - set(data.ends) == set(range(300, 310 + BODY.history - 1))
    assert np.isfinite(data.targets[data.ends]).all()


def test_labels_full_of_gaps_are_refused(arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]) -> None:
    def holed(flight: Flight) -> dict[str, Floats | None]:
        values = flight["rate_x"].copy()
        values[::15] = np.nan
        return {"rate_x": values}

    with pytest.raises(DataError, match=r"flight_0.parquet: 0 windows of 20 rows without a gap"):
        label_rows(BODY, arpl_250g, [changed(recordings[0], holed)])


def test_without_motor_data_there_is_nothing_to_learn(arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]) -> None:
    def motorless(flight: Flight) -> dict[str, Floats | None]:
        return {name: None for name in flight.columns if name.startswith("rotor_")}

    with pytest.raises(DataError, match="Wanted rotor speeds, motor commands"):
        with_logged_motors(BODY, [changed(recordings[0], motorless)], arpl_250g)


def test_measured_rotor_speeds_stand_in_for_commands_when_all_flights_lack_them(
    arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]
) -> None:
    def uncommanded(flight: Flight) -> dict[str, Floats | None]:
        return {name: None for name in flight.columns if name.startswith("rotor_command")}

    slow = changed(recordings[0], uncommanded)
    assert with_logged_motors(BODY, recordings, arpl_250g).motors == "command"
    assert with_logged_motors(BODY, [slow], arpl_250g).motors == "measured"
    with pytest.raises(DataError, match="--motors measured"):
        with_logged_motors(BODY, [slow, *recordings[1:]], arpl_250g)


def test_a_vehicle_file_that_does_not_fit_is_refused(arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]) -> None:
    heavy = msgspec.structs.replace(arpl_250g, body=msgspec.structs.replace(arpl_250g.body, mass=0.05))
    with pytest.raises(DataError, match=r"does not fit flight_0.parquet, which shows 0.2\d times the specific force"):
        label_rows(BODY, heavy, recordings)
    order = arpl_250g.rotors.position[1:] + arpl_250g.rotors.position[:1]
    turned = msgspec.structs.replace(
        arpl_250g, rotors=msgspec.structs.replace(arpl_250g.rotors, position=order, spin=(-1, 1, -1, 1))
    )
    with pytest.raises(DataError, match="acceleration correlates with what was flown by"):
        label_rows(BODY, turned, recordings)


def test_a_vehicle_file_whose_rotors_spin_the_other_way_is_refused(
    arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]
) -> None:
    backwards = msgspec.structs.replace(
        arpl_250g, rotors=msgspec.structs.replace(arpl_250g.rotors, spin=tuple(-s for s in arpl_250g.rotors.spin))
    )
    with pytest.raises(DataError, match="yaw acceleration correlates with what was flown by -0"):
        label_rows(BODY, backwards, recordings)


def test_a_flight_of_another_vehicle_among_those_of_the_right_one_is_named(
    arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]
) -> None:
    def swapped(flight: Flight) -> dict[str, Floats | None]:
        names = [f"rotor_command_{place}" for place in range(4)]
        return dict(zip(names, (flight[name] for name in [*names[1:], names[0]]), strict=True))

    among = [*recordings[:2], changed(recordings[2], swapped), recordings[3]]
    with pytest.raises(DataError, match=r"does not fit flight_2.parquet: its roll acceleration"):
        label_rows(BODY, arpl_250g, among)


def test_another_number_of_rotors_is_refused(recordings: Sequence[LoggedFlight]) -> None:
    from dynamics.vehicle import Body, Rotors

    angle = np.arange(6) * np.pi / 3
    position = tuple((float(np.cos(a)), float(np.sin(a)), 0.0) for a in angle)
    six = Vehicle("six", Body(1.0, (0.02, 0.02, 0.03)), Rotors(position, (1, -1) * 3, 1e-6, 1e-8, 2000.0))
    with pytest.raises(DataError, match="has 4 rotors, the vehicle file 6"):
        with_logged_motors(BODY, recordings, six)


def test_a_residual_of_zero_leaves_the_base_exactly(arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]) -> None:
    data = label_rows(named_kind("res_tcn").config, arpl_250g, recordings)
    assert data.base is not None
    np.testing.assert_array_equal(data.base, data.nominal)
    for error in flight_errors(data, data.base[data.ends]):
        assert error.combined == error.base == error.nominal


def test_the_papers_inputs_are_filtered_and_its_labels_accelerations(
    arpl_250g: Vehicle, recordings: Sequence[LoggedFlight]
) -> None:
    paper = ModelConfig(
        "pi_tcn", "tcn", inputs="world", outputs="world", motors="measured", label="instantaneous", filtered_inputs=True
    )
    data, causal = label_rows(paper, arpl_250g, recordings), label_rows(BODY, arpl_250g, recordings)
    rows = np.intersect1d(data.ends, causal.ends)
    assert data.inputs.shape[1] == 14
    (segment,) = recordings[0].segments
    smooth = lowpass(segment["rotor_speed"], segment.rate, PAPER_CUTOFF)
    np.testing.assert_allclose(data.rotor_speed[: len(segment)], smooth, atol=1e-7)
    assert np.corrcoef(data.label[rows, 3], causal.label[rows, 3])[0, 1] > 0.8
    np.testing.assert_allclose(np.linalg.norm(data.inputs[rows, 3:7], axis=1), 1.0, atol=1e-9)
