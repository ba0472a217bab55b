"""Cases of the verdict that `make test` tries: these sentinels. `make test-all` tries each, `make study` many more.

A sentinel stands for a kind of answer: nothing hidden, one effect, a wrong value in the file, a sensor, a foreign
force, a late signal, logs that are refused, and real PX4.
"""

from pathlib import Path

import pytest

HERE = Path(__file__).parent
SENTINELS = (
    "test_additions.py::test_an_effect_that_is_not_there_is_refused_with_its_reason",
    "test_feedback.py::test_a_log_without_a_pose_that_hides_nothing_is_explained",
    "test_foreign_forces.py::test_a_force_outside_the_catalogue_is_unknown_and_nothing_is_named[dry_drag]",
    "test_foreign_forces.py::test_a_gust_is_one",
    "test_late_signals.py::test_a_signal_that_is_logged_late_is_no_inflow[accelerometer]",
    "test_late_signals.py::test_an_effect_that_is_there_is_no_late_signal[axial_inflow-True]",
    "test_motor_lag.py::test_a_lag_in_the_vehicle_file_can_be_wrong",
    "test_motor_lag.py::test_a_right_lag_in_the_file_is_not_doubted",
    "test_reproduced_cases.py::test_logs_of_wrong_axes_units_or_speeds_are_refused_and_sound_ones_are_not",
    "test_scaled_sensors.py::test_sound_sensors_have_no_wrong_scale",
    "test_real_statements.py::test_every_pending_statement_exists",
    "test_real_statements.py::test_statement[PX4, the true file, one flight:",
    "test_real_statements.py::test_statement[PX4, twice the drag:",
    "test_real_statements.py::test_statement[PX4, slower motors than in the file:",
    "test_real_statements.py::test_statement[NanoBench, motors numbered the other way round:",
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark all others as slow. A sentinel that no test bears any more would guard nothing: the run is refused."""
    here = {item.nodeid.split("verdicts/")[-1]: item for item in items if HERE in item.path.parents}
    for name, item in here.items():
        if not name.startswith(SENTINELS):
            item.add_marker(pytest.mark.slow)
    if not any("::" in argument for argument in config.args):
        files = {item.path.name for item in here.values()}
        lost = [s for s in SENTINELS if s.split("::")[0] in files and not any(name.startswith(s) for name in here)]
        if lost:
            raise pytest.UsageError(f"{Path(__file__).name}: no test is named {', '.join(lost)}")
