"""Simulated flights from Python, and what SIGINT does while a vehicle flies."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

import numpy as np
import pytest

import alula
from alula.api.signals import landing_on_signals
from simulation.mock_process import free_port


def test_a_simulated_flight_has_the_same_bits_for_the_same_seed_and_hidden_effects_change_it() -> None:
    vehicle = alula.load_vehicle("arpl_250g")
    first, again = (alula.simulate("line:laps=1,ramp=1", vehicle=vehicle, seed=3) for _ in range(2))
    dragged = alula.simulate("line:laps=1,ramp=1", vehicle="arpl_250g", seed=3, hidden=["wind:x=3"])
    positions = [np.asarray(alula.Flight.from_log(flown.log)["position"]) for flown in (first, again)]
    np.testing.assert_array_equal(*positions)
    assert dragged.position_rmse > 1.2 * first.position_rmse


@pytest.mark.parametrize("function", [alula.simulate, alula.fly])
def test_a_flight_needs_one_vehicle_or_one_bundle_and_a_reference_that_it_can_fly(
    function: Callable[..., object],
) -> None:
    vehicle = alula.load_vehicle("px4_sih")
    with pytest.raises(alula.RequestError, match="either --vehicle"):
        function("hover")
    with pytest.raises(alula.RequestError, match="its own vehicle file"):
        function("hover", vehicle=vehicle, bundle="bundle")
    with pytest.raises(alula.RequestError, match="cannot fly"):
        function("lemniscate:speed=3", vehicle=vehicle)


def test_nobody_on_the_link_is_a_vehicle_error() -> None:
    link = f"udpin:127.0.0.1:{free_port()}"
    with pytest.raises(alula.VehicleError, match="No MAVLink arrived"):
        alula.fly("hover", vehicle=alula.load_vehicle("px4_sih"), link=link, timeout=0.3)


def test_signals_call_the_daemon_and_are_restored_afterwards() -> None:
    calls: list[str] = []
    before = signal.getsignal(signal.SIGTERM)
    with landing_on_signals(calls.append):
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
    assert calls == ["SIGTERM", "SIGINT"]
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize("name", ["SIGHUP", "SIGQUIT", "SIGTSTP", "SIGUSR1", "SIGALRM", "SIGXCPU"])
def test_no_signal_that_can_be_handled_ends_or_stops_the_process(name: str) -> None:
    calls: list[str] = []
    before = signal.signal(getattr(signal, name), signal.SIG_DFL)  # the runner's, or ignored behind nohup
    try:
        with landing_on_signals(calls.append):
            os.kill(os.getpid(), getattr(signal, name))
            os.kill(os.getpid(), getattr(signal, name))
            assert calls == [name]  # repeated, it is still one request to land
        assert signal.getsignal(getattr(signal, name)) is signal.SIG_DFL
    finally:
        signal.signal(getattr(signal, name), before)


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    calls: list[str] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with landing_on_signals(calls.append):
            os.kill(os.getpid(), signal.SIGHUP)
        assert calls == []
    finally:
        signal.signal(signal.SIGHUP, before)


def test_outside_of_the_main_thread_signals_stay_as_they_are() -> None:
    errors: list[Exception] = []

    def body() -> None:
        try:
            with landing_on_signals(lambda name: None):
                pass
        except ValueError as error:
            errors.append(error)

    thread = threading.Thread(target=body)
    thread.start()
    thread.join()
    assert not errors
