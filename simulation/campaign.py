"""The paper's data set flown on the mock's vehicle: 68 flights in lockstep, in as many processes as there are cores.

A campaign's folder holds `campaign.json` (the recipe), `train/` and `test/` (the vehicle's measurements), `truth/`
(ground truth), `summaries/`, and `manifest.json` once everything is flown. A flight gets its name only when it is
complete, so that the same command resumes an interrupted campaign.
"""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path

import msgspec
import numpy as np

from dynamics.command import command_line
from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.own_effects import catalogue_of
from dynamics.references.campaign import REAL_WORLD, CampaignFlight, chosen_flights, paper_campaign
from dynamics.trust import require_approved
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import effect_files_in, find_vehicle, parse_effect, parse_vehicle, vehicle_text
from dynamics.version import __version__
from flights.parallel import parallel_map
from runtime.control.controller import Controller
from simulation.campaign_flight import FlightSummary, FlightTask, fly_task
from sitl_mock.scenario import Scenario, parse_scenario
from sitl_mock.vehicle.plant import build_plant
from sitl_mock.vehicle.step_loop import StepLoop

RECIPE, MANIFEST, SUMMARIES = "campaign.json", "manifest.json", "summaries"
LIBRARIES = ("numpy", "casadi", "scipy", "pyarrow", "msgspec")
Progress = Callable[[FlightSummary], None]


class CampaignOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of a campaign.

    folder: of the results.
    effects: hidden from the controller, as on the command line; None for those of a real vehicle.
    effect_files: with effects of the user's own, beside those that the vehicle names.
    scenario: file with sensors, battery and effects.
    flights: names, patterns or splits; empty for all.
    jobs: processes, None for one a core.
    scheduler: address of a Dask scheduler.
    csv: write CSV instead of Parquet.
    """

    folder: Path
    vehicle: str = "arpl_250g"
    effects: tuple[str, ...] | None = None
    effect_files: tuple[Path, ...] = ()
    scenario: Path | None = None
    seed: int = 0
    flights: tuple[str, ...] = ()
    jobs: int | None = None
    scheduler: str | None = None
    csv: bool = False


class CampaignRecipe(msgspec.Struct, frozen=True):
    """Everything that decides a campaign's flights, except their selection."""

    vehicle: str
    vehicle_sha256: str
    effects: tuple[str, ...]
    scenario_sha256: str
    seed: int
    format: str
    versions: dict[str, str]


class CampaignManifest(msgspec.Struct, frozen=True):
    """A flown campaign. Durations in s, peaks over all flights in m/s, m/s^2, rad/s^2, rpm."""

    recipe: CampaignRecipe
    command: str
    flights: tuple[FlightSummary, ...]
    sha256: dict[str, str]
    duration: float
    peak_speed: float
    peak_acceleration: float
    peak_angular_acceleration: float
    peak_rotor_rpm: float


class Campaign:
    """A campaign with checked options. Raises RequestError for invalid ones."""

    def __init__(self, options: CampaignOptions, catalogue: Sequence[CampaignFlight] | None = None) -> None:
        """catalogue: the flights to choose from, by default the paper's."""
        self.options = options
        self._catalogue = tuple(paper_campaign() if catalogue is None else catalogue)
        self.flights = chosen_flights(self._catalogue, options.flights)
        text = vehicle_text(find_vehicle(options.vehicle), effect_files=options.effect_files)
        scenario_text = "" if options.scenario is None else _read(options.scenario, "scenario")
        require_approved(effect_files_in(text), carrier=find_vehicle(options.vehicle))
        self._vehicle = parse_vehicle(text)
        effects = catalogue_of(self._vehicle)
        self._scenario = _checked(parse_scenario(scenario_text, self._vehicle.rotors.count, catalogue=effects))
        self._uses = self._hidden_effects()
        self.recipe = CampaignRecipe(
            vehicle=self._vehicle.name,
            vehicle_sha256=hashlib.sha256(text.encode()).hexdigest(),
            effects=tuple(_described(use) for use in self._uses),
            scenario_sha256=hashlib.sha256(scenario_text.encode()).hexdigest() if scenario_text else "",
            seed=options.seed,
            format="csv" if options.csv else "parquet",
            versions={"alula": __version__} | {name: metadata.version(name) for name in LIBRARIES},
        )
        self._texts = (text, scenario_text)

    def run(self, progress: Progress) -> CampaignManifest:
        """Fly the missing flights. progress: called with every flight's summary, flown now or before.

        Raises RequestError when the folder holds another campaign or cannot be written, VehicleError when a flight
        cannot be flown with these effects at any speed.
        """
        self._claim_folder()
        missing = []
        for flight in self.flights:
            if (summary := self._finished(flight)) is not None:
                progress(summary)
            else:
                missing.append(self._task(flight))
        if missing:
            self._compile()
        for _, summary in parallel_map(fly_task, missing, jobs=self._jobs(), scheduler=self.options.scheduler):
            progress(summary)
        return self._write_manifest()

    def _hidden_effects(self) -> tuple[EffectUse, ...]:
        requested = self.options.effects
        of_scenario = self._scenario.hidden_effects()
        texts = requested if requested is not None else () if of_scenario else REAL_WORLD
        effects, count = catalogue_of(self._vehicle), self._vehicle.rotors.count
        return (*of_scenario, *(parse_effect(text, count, catalogue=effects) for text in texts))

    def _jobs(self) -> int:
        return self.options.jobs if self.options.jobs is not None else len(os.sched_getaffinity(0))

    def _claim_folder(self) -> None:
        folder = self.options.folder
        recipe = folder / RECIPE
        text = msgspec.json.format(msgspec.json.encode(self.recipe))
        try:
            for name in ("train", "test", "truth", SUMMARIES):
                (folder / name).mkdir(parents=True, exist_ok=True)
            if not recipe.exists():
                recipe.write_bytes(text)
                return
            there = decode_json(recipe.read_bytes(), CampaignRecipe)
        except OSError as error:
            raise RequestError(f"cannot write to {folder}: {error.strerror or error}. Give another --out.") from error
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise RequestError(f"{recipe} is no campaign's: {error}. Give another --out.") from error
        if there != self.recipe:
            fields = CampaignRecipe.__struct_fields__
            names = [name for name in fields if getattr(there, name) != getattr(self.recipe, name)]
            raise RequestError(
                f"{folder} holds another campaign: its {', '.join(names)} differ. Give another --out, or the same "
                f"request as in {recipe}."
            )

    def _finished(self, flight: CampaignFlight) -> FlightSummary | None:
        task = self._task(flight)
        if not (task.flight_file.exists() and task.summary_file.exists()):
            return None
        return decode_json(task.summary_file.read_bytes(), FlightSummary)

    def _task(self, flight: CampaignFlight) -> FlightTask:
        text, scenario = self._texts
        seeds = np.random.SeedSequence([self.options.seed, zlib.crc32(flight.name.encode())])
        return FlightTask(
            name=flight.name,
            reference=flight.reference,
            split=flight.split,
            folder=self.options.folder,
            vehicle_text=text,
            scenario_text=scenario,
            effects=self._uses,
            seed=int(seeds.generate_state(1)[0]),
            csv=self.options.csv,
        )

    def _compile(self) -> None:
        """Fill the cache of compiled code, so that processes do not wait for each other."""
        Controller.build(self._vehicle)
        StepLoop(build_plant(self._vehicle, self._uses))

    def _write_manifest(self) -> CampaignManifest:
        """Write the manifest of all of the campaign's flights in the folder, flown now or before."""
        tasks = [(self._task(flight), self._finished(flight)) for flight in self._catalogue]
        done = [(task, summary) for task, summary in tasks if summary is not None]
        files = [file for task, _ in done for file in (task.flight_file, task.truth_file)]
        summaries = tuple(summary for _, summary in done)
        manifest = CampaignManifest(
            recipe=self.recipe,
            command=command_line(),
            flights=summaries,
            sha256={str(file.relative_to(self.options.folder)): _sha256(file) for file in files},
            duration=sum(summary.duration for summary in summaries),
            peak_speed=max(summary.peak_speed for summary in summaries),
            peak_acceleration=max(summary.peak_acceleration for summary in summaries),
            peak_angular_acceleration=max(summary.peak_angular_acceleration for summary in summaries),
            peak_rotor_rpm=max(summary.peak_rotor_rpm for summary in summaries),
        )
        path = self.options.folder / MANIFEST
        part = path.with_suffix(".part")
        part.write_bytes(msgspec.json.format(msgspec.json.encode(manifest)) + b"\n")
        part.replace(path)
        return manifest


def _checked(scenario: Scenario) -> Scenario:
    if scenario.faults or scenario.parameters:
        raise RequestError(
            "the scenario has faults or PX4 parameters, which need a link: fly it with `alula mock` and `alula fly`, "
            "or take them out for a campaign."
        )
    return scenario


def _described(use: EffectUse) -> str:
    values = [*((f"rotor={use.rotor}",) if use.rotor is not None else ())]
    values += [f"{key}={value!r}" for key, value in use.parameters.items()]
    return f"{use.name}:{','.join(values)}" if values else use.name


def _read(path: Path, what: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(f"cannot read the {what} {path}: {error}. Give a TOML file.") from error


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
