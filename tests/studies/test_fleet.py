"""`alula diagnose --fleet`: every log once, whatever is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow.parquet as pq
import pytest
from dask import distributed

import alula
from alula.api.results import FleetResult
from dynamics.errors import RequestError, VehicleError
from dynamics.vehicle import EffectUse
from fixtures.dask_cluster import dask_cluster
from fixtures.fleet_flights import write_fleet
from studies.fleet import run as fleet_run
from studies.fleet.diagnosis import FleetTask, diagnose_log, killed_log
from studies.fleet.files import LINES, TABLE
from studies.fleet.flight import FleetFlight
from studies.fleet.logs import find_fleet
from studies.fleet.run import FleetOptions, default_out, run_fleet
from studies.fleet.store import FleetStore, read_flights
from tests.support.command_line import Run, command_line
from vehicles import FOLDER

VEHICLE = (FOLDER / "arpl_250g.toml").read_text()
DRAG = "rotor_drag"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two vehicles of which one hides a drag, with two flights each."""
    folder = tmp_path_factory.mktemp("flown") / "logs"
    drag = [EffectUse(DRAG, {"coefficient": 4e-5})]
    write_fleet(folder, {"alpha": [drag, drag], "beta": [[], []]})
    return folder


@pytest.fixture(scope="module")
def diagnosed(flown: Path) -> FleetResult:
    """The fleet, diagnosed by two processes."""
    return alula.diagnose_fleet(flown, workers=2)


@pytest.fixture
def copied(flown: Path, tmp_path: Path) -> Path:
    """The fleet in a folder of this test's own."""
    return Path(shutil.copytree(flown, tmp_path / "logs"))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Work that takes no time, in this process. Returns the logs that it was done on, as they come."""
    worked: list[str] = []

    def work(task: FleetTask) -> FleetFlight:
        worked.append(task.empty.log)
        return msgspec.structs.replace(
            task.empty, status="diagnosed", verdict="explained", sha256=task.path.read_text().strip()
        )

    def here(_: Any, items: Sequence[FleetTask], **__: Any) -> Iterator[tuple[int, FleetFlight]]:
        return ((place, work(item)) for place, item in enumerate(items))

    monkeypatch.setattr(fleet_run, "parallel_map", here)
    monkeypatch.setattr(fleet_run, "sha256", lambda path: path.read_text().strip())
    return worked


def texts(folder: Path, names: Sequence[str]) -> Path:
    """A folder with a vehicle and files, each of which holds its name."""
    folder.mkdir(exist_ok=True)
    (folder / "vehicle.toml").write_text(VEHICLE)
    for name in names:
        (folder / name).write_text(name)
    return folder


def lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / LINES).read_text().splitlines()]


def test_every_flight_has_a_line_with_its_verdict_and_intervals(flown: Path, diagnosed: FleetResult) -> None:
    assert diagnosed.folder == flown.with_name("logs.fleet")
    written = {line["log"]: line for line in lines(diagnosed.folder)}
    assert sorted(written) == [
        f"{name}/{day}.csv" for name in ("alpha", "beta") for day in ("2026-01-05", "2026-01-12")
    ]
    first = written["alpha/2026-01-05.csv"]
    assert first["verdict"] == "effect"
    assert first["vehicle"] == "alpha"
    assert first["vehicle_file"] == "alpha/vehicle.toml"
    assert (first["date"], first["date_from"]) == ("2026-01-05T00:00:00", "name")
    assert first["inspection"] in ("good", "limited")
    assert first["duration"] > 20
    coefficient = first["effects"][0]["parameters"]["coefficient"]
    assert coefficient["low"] < coefficient["value"] < coefficient["high"]
    assert coefficient["value"] == pytest.approx(4e-5, rel=0.05)
    assert first["channels"]["imu"]["over_floor"] > 3
    assert all(line["verdict"] != "effect" for name, line in written.items() if name.startswith("beta"))


def test_the_table_holds_the_same_as_the_lines(diagnosed: FleetResult) -> None:
    rows = pq.read_table(diagnosed.folder / TABLE).to_pylist()
    flights = diagnosed.report.flights
    assert [row["log"] for row in rows] == [flight.log for flight in flights]
    for row, flight in zip(rows, flights, strict=True):
        assert row["verdict"] == flight.verdict
        assert row["imu_before"] == flight.channels["imu"].before
        assert [effect["name"] for effect in row["effects"]] == [effect.name for effect in flight.effects]
    value = rows[0]["effects"][0]["parameters"][0]
    assert value["low"] == flights[0].effects[0].parameters[value["name"]].low


def test_one_log_alone_gives_what_diagnose_gives(flown: Path, diagnosed: FleetResult) -> None:
    log = flown / "alpha" / "2026-01-12.csv"
    alone = alula.diagnose(log, flown / "alpha" / "vehicle.toml").report
    flight = diagnosed.report.flights[1]
    assert (flight.log, flight.verdict) == ("alpha/2026-01-12.csv", alone.verdict)
    # to rounding: another process sums in another order
    value = alone.effects[0].parameters["coefficient"].value
    assert flight.effects[0].parameters["coefficient"].value == pytest.approx(value, rel=1e-9)
    assert flight.channels["imu"].before == pytest.approx(alone.channels["imu"].before, rel=1e-9)


def test_a_finished_fleet_is_not_done_again(flown: Path, diagnosed: FleetResult, quick: list[str]) -> None:
    before = (diagnosed.folder / LINES).read_bytes()
    assert alula.diagnose_fleet(flown).report == diagnosed.report
    assert quick == []
    assert (diagnosed.folder / LINES).read_bytes() == before


def test_a_stopped_run_goes_on_where_it_stood(tmp_path: Path, quick: list[str]) -> None:
    folder, out = texts(tmp_path / "logs", [f"{i}.csv" for i in range(6)]), tmp_path / "out"

    def stop(done: int, total: int, last: str) -> None:
        assert total == 6
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_fleet(FleetOptions(folder, out), stop)
    assert len(lines(out)) == 3
    with (out / LINES).open("a") as file:
        file.write('{"log":"torn')  # a power failure within a line
    flights = run_fleet(FleetOptions(folder, out))
    assert [flight.log for flight in flights] == [f"{i}.csv" for i in range(6)]
    assert quick == [f"{i}.csv" for i in range(6)]
    assert sorted(line["log"] for line in lines(out)) == [f"{i}.csv" for i in range(6)]


def test_a_changed_log_is_done_again_and_its_old_line_goes(tmp_path: Path, quick: list[str]) -> None:
    folder, out = texts(tmp_path / "logs", ["a.csv", "b.csv", "c.csv"]), tmp_path / "out"
    run_fleet(FleetOptions(folder, out))
    quick.clear()
    (folder / "a.csv").write_text("another flight")
    os.utime(folder / "b.csv", ns=(1, 1))  # copied: another date, the same content
    (folder / "d.csv").write_text("d.csv")
    run_fleet(FleetOptions(folder, out))
    assert quick == ["a.csv", "d.csv"]
    assert sorted(line["log"] for line in lines(out)) == ["a.csv", "b.csv", "c.csv", "d.csv"]
    quick.clear()
    (folder / "vehicle.toml").write_text(VEHICLE.replace("mass = 0.25", "mass = 0.26"))
    run_fleet(FleetOptions(folder, out))
    assert quick == ["a.csv", "b.csv", "c.csv", "d.csv"]


def test_a_log_that_is_gone_keeps_its_line_and_leaves_the_table(tmp_path: Path, quick: list[str]) -> None:
    folder, out = texts(tmp_path / "logs", ["a.csv", "b.csv"]), tmp_path / "out"
    run_fleet(FleetOptions(folder, out))
    (folder / "b.csv").rename(tmp_path / "b.csv")
    assert [flight.log for flight in run_fleet(FleetOptions(folder, out))] == ["a.csv"]
    (tmp_path / "b.csv").rename(folder / "b.csv")
    quick.clear()
    assert len(run_fleet(FleetOptions(folder, out))) == 2
    assert quick == []


def test_a_failure_is_tried_again_and_a_refusal_is_not(tmp_path: Path, quick: list[str]) -> None:
    folder, out = texts(tmp_path / "logs", ["a.csv", "b.csv"]), tmp_path / "out"
    run_fleet(FleetOptions(folder, out))
    with FleetStore(out).opened() as store:
        a, b = store.flights["a.csv"], store.flights["b.csv"]
        store.append(msgspec.structs.replace(a, status="failed", verdict=""))
        store.append(msgspec.structs.replace(b, status="refused", verdict=""))
    quick.clear()
    flights = run_fleet(FleetOptions(folder, out))
    assert quick == ["a.csv"]
    assert [flight.status for flight in flights] == ["diagnosed", "refused"]


def test_a_full_disk_ends_the_run_with_whole_lines(
    tmp_path: Path, quick: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = texts(tmp_path / "logs", ["a.csv", "b.csv"]), tmp_path / "out"
    write, written = os.write, list[int]()

    def half(descriptor: int, data: bytes) -> int:
        written.append(write(descriptor, data if not written else data[: len(data) // 2]))
        return written[-1]

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", half)
        with pytest.raises(RequestError, match=r"cannot write .*flights\.jsonl: the disk is full"):
            run_fleet(FleetOptions(folder, out))
    assert [line["log"] for line in lines(out)] == ["a.csv"]
    run_fleet(FleetOptions(folder, out))
    assert quick == ["a.csv", "b.csv", "b.csv"]


def test_results_that_cannot_be_written_are_refused_before_the_work(tmp_path: Path, quick: list[str]) -> None:
    folder = texts(tmp_path / "logs", ["a.csv"])
    with pytest.raises(RequestError, match="cannot make the folder"):
        run_fleet(FleetOptions(folder, folder / "a.csv" / "out"))
    out = tmp_path / "out"
    (out / LINES).mkdir(parents=True)
    with pytest.raises(RequestError, match="cannot read"):
        run_fleet(FleetOptions(folder, out))
    assert quick == []


def test_a_folder_has_one_run_at_a_time_and_one_fleet(tmp_path: Path, quick: list[str]) -> None:
    folder, out = texts(tmp_path / "logs", ["a.csv"]), tmp_path / "out"
    with FleetStore(out).opened(), pytest.raises(RequestError, match="another run writes"):
        run_fleet(FleetOptions(folder, out))
    run_fleet(FleetOptions(folder, out))
    other = texts(tmp_path / "other", ["b.csv"])
    with pytest.raises(RequestError, match="the results of another fleet"):
        run_fleet(FleetOptions(other, out))
    (out / LINES).write_text("no lines of a fleet\n")
    with pytest.raises(RequestError, match="holds no flight of a fleet"):
        run_fleet(FleetOptions(folder, out))
    with pytest.raises(RequestError, match="holds no flights"):
        read_flights(tmp_path)


def test_results_inside_of_the_folder_are_no_logs(tmp_path: Path, quick: list[str]) -> None:
    folder = texts(tmp_path / "logs", ["a.csv"])
    for _ in range(2):
        assert len(run_fleet(FleetOptions(folder, folder / "results"))) == 1
    assert quick == ["a.csv"]
    assert default_out(Path("logs")) == Path("logs.fleet")
    assert default_out(Path()).name == f"{Path().resolve().name}.fleet"


def test_the_vehicle_of_a_log_is_the_nearest_above_it(tmp_path: Path) -> None:
    folder = texts(tmp_path / "logs", ["top.csv"])
    own = folder / "own"
    (own / "deep").mkdir(parents=True)
    (own / "quad.toml").write_text(VEHICLE.replace("arpl_250g", "quad"))
    (own / "mapping.toml").write_text("[columns]\n")
    (own / "deep" / "a.csv").write_text("a")
    crowded = folder / "crowded"
    crowded.mkdir()
    (crowded / "b.csv").write_text("b")
    for name in ("one.toml", "two.toml"):
        (crowded / name).write_text(VEHICLE)
    wrong = folder / "wrong"
    wrong.mkdir()
    (wrong / "c.csv").write_text("c")
    (wrong / "vehicle.toml").write_text(VEHICLE.replace("mass", "mas"))
    logs = {log.name: log for log in find_fleet(folder, None)}
    assert {name: log.vehicle and log.vehicle.name for name, log in logs.items()} == {
        "top.csv": "arpl_250g",
        "own/deep/a.csv": "quad",
        "crowded/b.csv": None,
        "wrong/c.csv": None,
    }
    assert "2 vehicle files (one.toml, two.toml). Name the one to use vehicle.toml" in logs["crowded/b.csv"].error
    assert "mas" in logs["wrong/c.csv"].error
    (folder / "vehicle.toml").unlink()
    top = next(log for log in find_fleet(folder, None) if log.name == "top.csv")
    assert "Put one there" in top.error
    assert {log.vehicle.name for log in find_fleet(folder, "arpl_250g") if log.vehicle} == {"arpl_250g"}


def test_logs_that_cannot_be_used_have_their_reason_and_the_others_continue(
    copied: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def here(work: Callable[[Any], Any], items: Sequence[Any], **_: Any) -> Iterator[tuple[int, Any]]:
        return ((place, work(item)) for place, item in enumerate(items))

    monkeypatch.setattr(fleet_run, "parallel_map", here)
    shutil.rmtree(copied / "beta")
    (copied / "alpha" / "2026-01-12.csv").unlink()
    (copied / "alpha" / "broken.csv").write_text("hello")
    (copied / "alpha" / "empty.csv").write_text("")
    (copied / "stray.csv").write_text("hello")
    code, out, _ = run("diagnose", "--fleet", copied, "--html", copied.parent / "page.html")
    assert code == 0
    flights = {flight.log: flight for flight in read_flights(copied.with_name("logs.fleet"))}
    assert flights["alpha/2026-01-05.csv"].status == "diagnosed"
    assert flights["alpha/broken.csv"].error.startswith("alpha/broken.csv has no known log format")
    assert flights["alpha/broken.csv"].sha256
    assert "is empty" in flights["alpha/empty.csv"].error
    assert "no vehicle.toml at or above" in flights["stray.csv"].error
    assert "3 logs without a diagnosis" in out
    assert "next: alula diagnose" in out
    assert "hello" in (copied.parent / "page.html").read_text()


def test_a_request_that_cannot_be_met_names_the_remedy(run: Run, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    stray = tmp_path / "stray"
    stray.mkdir()
    (stray / "a.csv").write_text("hello")
    for words, code, message in (
        (("--fleet", tmp_path / "empty"), 2, "no log there"),
        (("--fleet", tmp_path / "none"), 2, "is no folder"),
        (("--fleet", stray), 3, "none of 1 logs could be diagnosed, the first since: no vehicle.toml"),
        (("--fleet", stray, "--vehicle", "none.toml"), 2, "there is no vehicle file"),
        (("--fleet", stray, "--hold-out", "h*"), 2, "--hold-out with --fleet"),
        (("--fleet", stray, "--scheduler", "tcp://127.0.0.1:9", "--vehicle", "arpl_250g"), 2, "no Dask scheduler"),
        (("--fleet", stray, "--mapping", "none.toml", "--vehicle", "arpl_250g"), 2, "cannot read the mapping"),
        ((stray / "a.csv", "--vehicle", "arpl_250g", "--out", "x"), 2, "--out without --fleet"),
        ((stray / "a.csv",), 2, "no --vehicle was given"),
        (("--vehicle", "arpl_250g"), 2, "a diagnosis needs logs"),
    ):
        ended, _, wrong = run("diagnose", *words)
        assert (ended, message in wrong) == (code, True), wrong


@pytest.mark.realtime(repeats_only=True)
def test_a_dask_worker_that_is_killed_half_way_loses_nothing_and_repeats_nothing(
    copied: Path, diagnosed: FleetResult, tmp_path: Path
) -> None:
    refused = (
        "alpha/2026-01-05.csv",
        "beta/2026-01-12.csv",
    )  # at once: whoever refuses the first is killed at the next
    for name in refused:
        (copied / name).write_text("hello")
    out, killed = tmp_path / "out", list[int]()
    with dask_cluster(tmp_path) as (address, workers):

        def kill(done: int, total: int, last: str) -> None:
            if done == 1:
                worker = int(lines(out)[0]["worker"].split()[-1])
                killed.append(worker)
                os.kill(next(process.pid for process in workers if process.pid == worker), signal.SIGKILL)

        result = run_fleet(FleetOptions(copied, out, scheduler=address), kill)
    assert killed
    assert len(lines(out)) == len(result) == 4
    assert {flight.log: flight.status for flight in result if flight.status != "diagnosed"} == dict.fromkeys(
        refused, "refused"
    )
    for flight, other in zip(result, diagnosed.report.flights, strict=True):
        assert flight.log == other.log
        if flight.log not in refused:
            assert (flight.verdict, flight.effects) == (other.verdict, other.effects)


def test_a_scheduler_that_goes_away_keeps_what_was_done(copied: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (copied / "alpha" / "2026-01-05.csv").write_text("hello")  # is done at once, while the next takes its time
    with dask_cluster(tmp_path, workers=1) as (address, _):
        with distributed.Client(address, set_as_default=False) as client:
            scheduler = client.run_on_scheduler(os.getpid)

        def kill(done: int, total: int, last: str) -> None:
            if done == 1:
                os.kill(scheduler, signal.SIGKILL)

        with pytest.raises(VehicleError, match="the Dask scheduler went away"):
            run_fleet(FleetOptions(copied, out, scheduler=address), kill)
    assert 1 <= len(lines(out)) < 4


def test_a_log_that_kills_its_workers_fails_alone(tmp_path: Path) -> None:
    task = FleetTask(tmp_path / "a.csv", FleetFlight("a.csv", "refused"), VEHICLE)
    failed = killed_log(task)
    assert failed.status == "failed"
    assert "died twice" in failed.error
    missing = diagnose_log(task)
    assert missing.status == "failed"
    assert "cannot read a.csv" in missing.error
