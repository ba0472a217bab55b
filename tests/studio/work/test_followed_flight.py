"""The studio's diagnosis of a flight whose model followed: what it says beside that, and the parameters over time."""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import write_vehicle
from fixtures.followed_flight import fly_following
from studio.app.diagnose_page import _verdict
from studio.work.diagnosing import diagnose
from studio.work.memory import CaseMemory
from studio.work.results import FILES, FOLLOWED, Diagnosed
from studio.work.task import Task


def test_a_followed_flight_is_shown_beside_its_diagnosis(arpl_250g: Vehicle, tmp_path: Path) -> None:
    log, vehicle, result = tmp_path / "flight.mcap", tmp_path / "quad.toml", tmp_path / "result"
    fly_following(arpl_250g, log, hidden=[EffectUse("rotor_drag", {"coefficient": 2.2e-5})], follow=["rotor_drag"])
    write_vehicle(arpl_250g, vehicle)
    result.mkdir()
    task = Task("diagnose", str(result), "", (str(log),), str(vehicle), str(vehicle), (), "", "", "", "data", "vehicle")
    diagnose(CaseMemory(), task, result, lambda *_: None)
    diagnosed = msgspec.json.decode((result / FILES[Diagnosed]).read_bytes(), type=Diagnosed)
    (effect,) = diagnosed.diagnosis.in_flight
    assert (effect.name, effect.outcome, effect.named) == ("rotor_drag", "agrees", True)
    assert "95 % intervals" in diagnosed.pictures[f"{FOLLOWED}0"].description
    assert "rotor_drag agrees: coefficient = " in str(_verdict(diagnosed, "case"))
