"""Cases of `benchmarks.verdicts`: what is hidden, the logs, flown once and kept, and how strong the effect shows."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from dynamics.arrays import Floats
from dynamics.references.campaign import REAL_WORLD
from dynamics.vehicle_file import parse_effect
from fixtures.outside_cases import AIR, BY_COMMAND, BY_SPEED, Campaign, flown, milder, sized, write_campaign
from fixtures.outside_effects import CATALOGUED, FOREIGN, OF_SENSORS, wrench_of
from fixtures.outside_sensors import CAPTURE, PX4_ACCELEROMETER, PX4_GYRO, Recorder
from fixtures.outside_simulator import ROW_STEPS, STEP, TURBULENCE, G, Truth, merged
from vehicles import FOLDER

FLOWN = Path("build/verdicts")
NOTHING = ("speeds", "commands", "campaign", "estimator", "true_file")
OWN = ("linear_drag", "rotor_drag", "motor_lag", "rotational_damping", "parasitic_drag")  # wrong in the file
ESTIMATED = ("linear_drag", "mass", "motor_lag", "thrust_constant", "inertia", "rotational_damping", "rotor_drag")
SEVERAL = (  # at most one of each group at once: within a group no data can tell two apart
    ("linear_drag", "rotor_drag"), ("parasitic_drag",), ("rotational_damping",), ("translational_lift",),
    ("axial_inflow",), ("blade_flapping",), ("rotor_gyroscopic",), ("thrust_constant", "mass"),
    ("torque_constant", "inertia"), ("weak_rotor", "centre_of_mass"), ("rotor_cant",), ("ground_effect",),
)  # fmt: skip
KINDS = {
    "nothing": NOTHING, "single": (*CATALOGUED, *OF_SENSORS), "own": OWN, "estimator": ESTIMATED, "outside": FOREIGN,
    "many": ("nine", "random"), "add": ("single", "random", "outside", "estimator"),
}  # fmt: skip
FAST_FLIGHTS = ("Lemniscate*", "Ellipse_*", "Parabola")
NINE_FLIGHTS = ("Lemniscate*", "Ellipse_*", "Parabola", "WarpedEllipse*")
MAX_TRIES = 3


@dataclass(frozen=True)
class Case:
    """A kind, one of its names, and a seed."""

    kind: str
    name: str
    seed: int

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.kind}-{self.name}-{self.seed}"

    @property
    def folder(self) -> Path:
        """Of its logs, `vehicle.toml` and `case.json`."""
        return FLOWN / self.key

    @property
    def random(self) -> np.random.Generator:
        """Numbers that depend on the case alone."""
        return np.random.default_rng([*self.key.encode()])


def flies_our_campaign(case: Case) -> bool:
    """Whether `alula campaign` flies it, not the outside simulator."""
    return (case.kind, case.name) in (("nothing", "campaign"), ("many", "nine"))


def campaign_of(case: Case) -> Campaign:
    """Flights of the outside simulator for a case."""
    random = case.random
    number = int(random.integers(2**31))
    noise, rate = (
        float(np.exp(random.uniform(np.log(0.5), np.log(2.0)))),
        float(random.choice([50, 100, 100, 200, 400])),
    )
    made = Campaign({}, {}, Recorder(rate, noise=noise), False, bool(random.random() < 0.35), 9, number)
    frame = made.frame
    kind, name = case.kind, case.name
    if kind == "add":
        kind = {"random": "many"}.get(name, name)
        choices = {"single": CATALOGUED, "outside": FOREIGN, "estimator": ESTIMATED}.get(name, ("random",))
        name = str(random.choice(choices))
    commands = name in BY_COMMAND or (kind == "nothing" and name == "commands")
    if kind in ("single", "outside") and name not in (*BY_SPEED, *BY_COMMAND):
        commands = bool(random.random() < 0.15)
    recorder = replace(made.recorder, commands=commands)
    lag_declared = commands and name != "motor_lag"
    declared: dict[str, dict[str, float]] = {}
    if name == "true_file":
        chosen = ("rotor_drag", "parasitic_drag", "rotational_damping", "blade_flapping")
        declared = {n: sized(n, frame, random) for n in chosen}
    if name in AIR:
        declared = {"rotor_drag": sized("rotor_drag", frame, random)}
    if kind == "estimator" or name == "estimator":
        recorder, lag_declared = Recorder(250.0, commands=True, pose="estimator"), True
        declared = {
            "linear_drag": {"coefficient": frame.mass * float(random.uniform(0.5, 1.5))},
            "rotational_damping": {"coefficient": float(frame.inertia[0]) * float(random.uniform(0.5, 1.5))},
        }
    if kind == "nothing":
        return replace(made, declared=declared, recorder=recorder, lag_declared=lag_declared)
    if kind == "many":
        count = int(random.integers(5, 10))
        groups = [SEVERAL[i] for i in random.permutation(len(SEVERAL))[:count]]
        names = [str(random.choice(group)) for group in groups]
    else:
        names = [name]
    hidden = {n: sized(n, frame, random) for n in names}
    if kind == "own":
        commands = name == "motor_lag"
        lag_declared, recorder = commands, replace(recorder, commands=commands)
        if not commands:
            declared = {name: {key: value / 2 for key, value in hidden[name].items()}}
    if kind == "estimator" and name in declared:
        hidden[name] = {key: value * float(random.choice([0.5, 1.6, 2.0])) for key, value in declared[name].items()}
    return replace(made, hidden=hidden, declared=declared, recorder=recorder, lag_declared=lag_declared)


def prepare(cases: Sequence[Case]) -> None:
    """Fly what has not been flown: outside campaigns side by side, those that lose their path again and milder."""
    todo = [case for case in cases if not (case.folder / "case.json").exists()]
    for case in todo:
        shutil.rmtree(case.folder, ignore_errors=True)
        case.folder.mkdir(parents=True)
        if flies_our_campaign(case):
            _fly_ours(case)
    waiting = [(case, campaign_of(case)) for case in todo if not flies_our_campaign(case)]
    for attempt in range(MAX_TRIES):
        again = []
        results = flown([campaign for _, campaign in waiting]) if waiting else []
        for (case, campaign), truths in zip(waiting, results, strict=True):
            if truths is None:
                again.append((case, milder(campaign)))
                continue
            write_campaign(campaign, truths, case.folder)
            conditions = {
                "recorder": asdict(campaign.recorder),
                "fast": campaign.fast,
                "layout": campaign.layout,
                "milder": attempt,
            }
            _describe(case, campaign.hidden, campaign.declared, conditions, strengths(campaign, truths))
        waiting = again
    for case, _ in waiting:
        _describe(case, {}, {}, {"lost": True}, {})


def _describe(case: Case, hidden: Any, declared: Any, conditions: Any, strength: Any) -> None:
    text = {"hidden": hidden, "declared": declared, "conditions": conditions, "strength": strength}
    (case.folder / "case.json").write_text(json.dumps(text))


def _fly_ours(case: Case) -> None:
    """Ten fast flights of `alula campaign`, with the nine effects that it hides by default or without any."""
    from simulation.campaign import Campaign as OurCampaign
    from simulation.campaign import CampaignOptions

    nine = case.name == "nine"
    flights = NINE_FLIGHTS if nine else FAST_FLIGHTS
    folder = case.folder / "flown"
    options = CampaignOptions(folder, effects=None if nine else (), seed=case.seed, flights=flights, jobs=1)
    OurCampaign(options).run(lambda _: None)
    logs = sorted([*(folder / "train").glob("*.parquet"), *(folder / "test").glob("*.parquet")])
    for log in logs[:10]:
        shutil.copy(log, case.folder / log.name)
    shutil.rmtree(folder)
    shutil.copy(FOLDER / "arpl_250g.toml", case.folder / "vehicle.toml")
    uses = [parse_effect(text, 4) for text in REAL_WORLD] if nine else []
    _describe(case, {use.name: use.parameters for use in uses}, {}, {"campaign": True}, {})


def strengths(campaign: Campaign, truths: Sequence[Truth]) -> dict[str, float]:
    """RMS of what the file's model misses below 8 Hz over the noise there, by kind of channel."""
    sos = butter(4, 8.0, fs=1 / (ROW_STEPS * STEP), output="sos")
    force, turn, pull, swing, rates = [], [], [], [], []
    for truth in truths:
        missed = sosfiltfilt(sos, np.hstack(_missed(campaign, truth)), axis=0)[50:-50]
        force.append(missed[:, :3])
        turn.append(missed[:, 3:])
        rate = sosfiltfilt(sos, truth.rate, axis=0)
        rates.append(rate[50:-50])
        swing.append(np.gradient(rate, ROW_STEPS * STEP, axis=0)[50:-50])
        pull.append(np.gradient(sosfiltfilt(sos, truth.force, axis=0), ROW_STEPS * STEP, axis=0)[50:-50])
    floor = _floors(campaign)
    faults = campaign.hidden
    late = faults.get("time_delay", {}).get("delay", 0.0)
    turned = late + faults.get("attitude_delay", {}).get("delay", 0.0)
    bias = np.linalg.norm([faults.get("gyro_bias", {}).get(axis, 0.0) for axis in "xyz"])
    scale = abs(faults.get("gyro_scale", {}).get("ratio", 1.0) - 1)
    made = {
        "imu": np.sqrt(max(_rms(force) ** 2 - floor["turbulent_force"] ** 2, 0.0)),
        "angular": np.sqrt(max(_rms(turn) ** 2 - floor["turbulent_turn"] ** 2, 0.0)),
        "mocap": late * _rms(pull),
        "attitude_rate": float(bias) + turned * _rms(swing) + float(scale) * _rms(rates),
    }
    return {kind: float(value / floor[kind]) for kind, value in made.items()}


def _missed(campaign: Campaign, truth: Truth) -> tuple[Floats, Floats]:
    """Specific force and angular acceleration at the truth that the file's model, on what is logged, does not give."""
    frame, faults = campaign.frame, campaign.hidden
    speed = truth.command if campaign.recorder.commands else truth.speed.copy()
    if campaign.recorder.commands and campaign.lag_declared:
        keep = np.exp(-ROW_STEPS * STEP / frame.lag)
        speed = lfilter([1 - keep], [1.0, -keep], speed, axis=0, zi=keep * speed[:1])[0]
    if "rotor_speed_fault" in faults:
        speed[:, int(faults["rotor_speed_fault"]["rotor"])] *= faults["rotor_speed_fault"]["gain"]
    fleet = SimpleNamespace(
        hidden=merged([campaign.declared]), arms=frame.rotors[None], spin=frame.spin[None], motors=len(frame.spin),
        lift=frame.thrust_constant, twist=frame.torque_constant, hover=frame.hover_speed, air=None,
        flicker=np.zeros((1, 1, 1)),
    )  # fmt: skip
    fleet.value = lambda effect, name, neutral: fleet.hidden.get(effect, {}).get(name, np.full((1, 1), neutral))
    spin_up = np.gradient(speed, ROW_STEPS * STEP, axis=0)
    state = SimpleNamespace(
        velocity=truth.velocity, rotation=truth.rotation, rate=truth.rate, speed=speed, spin_up=spin_up,
        position=truth.position, time=0.0, memory={},
    )  # fmt: skip
    force, moment = wrench_of(fleet, state, 0)
    felt = truth.force + np.array([faults.get("imu_bias", {}).get(axis, 0.0) for axis in "xyz"])
    turned = np.array([faults.get("imu_misalignment", {}).get(axis, 0.0) for axis in "xyz"])
    felt = faults.get("imu_scale", {}).get("ratio", 1.0) * (felt - np.cross(turned, truth.force))
    twisted = (moment - np.cross(truth.rate, frame.inertia * truth.rate)) / frame.inertia
    return felt - force / frame.mass, np.gradient(truth.rate, ROW_STEPS * STEP, axis=0) - twisted


def _floors(campaign: Campaign) -> dict[str, float]:
    """Noise below 8 Hz by kind of channel, and the part of it that is the rotors' turbulence."""
    recorder, frame = campaign.recorder, campaign.frame
    share, slope = np.sqrt(16.0 / recorder.rate), 2 * np.pi * 8 / np.sqrt(3)  # of white noise; of its derivative
    white = {name: np.sqrt(3) * recorder.noise * value for name, value in CAPTURE.items()}
    if recorder.pose == "estimator":
        white |= {
            "accelerometer": np.sqrt(2) * np.linalg.norm(PX4_ACCELEROMETER),
            "gyro": np.sqrt(2) * np.linalg.norm(PX4_GYRO),
        }
    count, arm = len(frame.spin), float(np.linalg.norm(frame.rotors[0]))
    size = 0.85 * recorder.noise * TURBULENCE
    force = G * size / np.sqrt(count)
    turn = frame.mass * force * arm / float(frame.inertia[0])
    return {
        "imu": float(np.hypot(white["accelerometer"] * share, force)),
        "mocap": float(np.hypot(white["velocity"] * slope * share, force)),
        "angular": float(np.hypot(white["gyro"] * slope * share, turn)),
        "attitude_rate": float(white["tilt"] * slope * share),
        "turbulent_force": float(force), "turbulent_turn": float(turn),
    }  # fmt: skip


def _rms(rows: Sequence[Floats]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.vstack(rows) ** 2, axis=1))))
