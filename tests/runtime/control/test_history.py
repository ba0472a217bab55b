"""The history holds measurements and commands, and predictions only where nothing was measured."""

import numpy as np

from runtime.control.history import CAPACITY, ColumnHistory

REST = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])


def moving(time: float) -> np.ndarray:
    state = REST.copy()
    state[0], state[3] = 2.0 * time, 2.0
    return state


def test_columns_lie_on_the_grid_whatever_the_estimates_do() -> None:
    history, out = ColumnHistory(5, 0.01, 4), np.zeros((5, 17))
    for tick in range(40):
        time = 0.007 * tick
        history.add_measurement(time, moving(time))
        history.add_command(time, np.full(4, float(tick)))
    history.write_columns(0.25, out)
    np.testing.assert_allclose(out[:, 0], 2 * np.array([0.20, 0.21, 0.22, 0.23, 0.24]), atol=1e-12)
    np.testing.assert_array_equal(out[:, 13], np.floor(np.array([0.20, 0.21, 0.22, 0.23, 0.24]) / 0.007 + 1e-9))


def test_a_measurement_replaces_what_was_predicted_for_it() -> None:
    history, out = ColumnHistory(2, 0.01, 4), np.zeros((2, 17))
    history.add_measurement(0.0, moving(0.0))
    for time in (0.01, 0.02, 0.03):
        history.add_prediction(time, moving(time) + 1)
    history.add_measurement(0.01, moving(0.01))
    history.add_prediction(0.02, moving(0.02) + 5)
    history.write_columns(0.02, out)
    np.testing.assert_allclose(out[:, 0], [0.0, 0.02], atol=1e-12)
    prediction = history.prediction_at(0.015)
    assert prediction is not None
    np.testing.assert_allclose(prediction[0], 0.03 + 2.5)


def test_it_is_filled_once_columns_and_commands_reach_back() -> None:
    history = ColumnHistory(3, 0.01, 4)
    history.add_command(0.0, np.ones(4))
    for tick in range(6):
        assert history.reaches(0.01 * tick) == (tick >= 4)
        history.add_measurement(0.01 * tick + 0.01, REST)
    history.add_measurement(0.5, REST)
    assert not history.reaches(0.5)
    assert not ColumnHistory(3, 0.01, 4).reaches(0.0)


def test_a_short_gap_is_bridged_by_predictions_and_a_long_one_is_not() -> None:
    history, out = ColumnHistory(4, 0.01, 4), np.zeros((4, 17))
    history.add_command(-1.0, np.ones(4))
    for tick in range(10):
        history.add_measurement(0.01 * tick, REST)
    for time_ahead in (0.10, 0.11, 0.12, 0.13):
        history.add_prediction(time_ahead, REST + 0.5)
    history.add_measurement(0.13, REST)
    assert history.reaches(0.13)
    history.write_columns(0.14, out)
    np.testing.assert_allclose(out[:, 0], [0.5, 0.5, 0.5, 0.0])


def test_the_attitudes_sign_does_not_jump() -> None:
    history = ColumnHistory(3, 0.01, 4)
    for tick in range(20):
        turned = REST.copy()
        turned[6:10] *= -1 if tick % 3 else 1
        assert history.add_measurement(0.01 * tick, turned)[6] == 1.0


def test_it_runs_for_hours_in_the_room_that_it_has() -> None:
    history, out = ColumnHistory(19, 0.01, 4), np.zeros((19, 17))
    for tick in range(5 * CAPACITY):
        time = 0.01 * tick
        history.add_measurement(time, moving(time))
        history.add_command(time, np.full(4, float(tick)))
        for time_ahead in (0.01, 0.02, 0.03):
            history.add_prediction(time + time_ahead, moving(time + time_ahead))
        if tick > 30:
            assert history.reaches(time)
            history.write_columns(time + 0.03, out)
            np.testing.assert_allclose(out[:, 0], 2 * (time + 0.03 - 0.01 * np.arange(19, 0, -1)), atol=1e-9)
            assert out[-1, 13] == tick
