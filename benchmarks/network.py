"""A learned model that knows what it does not know: in flight, and by which sign."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.learning.goals import CAMPAIGN, EFFECTS, judged, trained
from benchmarks.measurement import ROOT, Page, finished, measured, options_of
from dynamics.arrays import Floats
from dynamics.errors import VehicleError
from dynamics.references import named_reference
from dynamics.references.campaign import REAL_WORLD
from dynamics.state import ATTITUDE, RIGID_BODY_STATES
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import parse_effect, read_vehicle
from export.bundle import ExportOptions, export_bundle
from export.trained import read_model
from runtime.control.adaptation_settings import AdaptationSettings, NetworkSettings
from runtime.control.bundle import Bundle, read_bundle
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from simulation.lockstep import fly_reference
from studies.sweep.catalogue import SLOW
from studies.tables import Table, TableCell, markdown
from training.calibration import WORST_SHARE, auroc
from training.checkpoint import TrainedModel, load
from training.data.features import outputs_from
from training.data.labelled_rows import LabelledRows, label_rows
from training.data.logged_flights import find_logs, read_logged_flights
from training.ground_truth import true_label
from training.prediction import EVALUATION_BATCH, FADE_QUANTILE, disagreement_of, gate_of, member_outputs
from vehicles import FOLDER

VEHICLE = "arpl_250g"
BUNDLES = ROOT / "build" / "network_in_flight"
SECONDS = 12.0  # of a flight
FIRST_SEED = 7000
MORE_IN_GUSTS = 2  # times as many seeds: with half of them the mock's autopilot does not settle at the start
HIDDEN: Mapping[str, Mapping[str, dict[str, float]]] = {
    "as trained": {},
    "drags x 1.5": {"rotor_drag": {"coefficient": 3.3e-5}, "parasitic_drag": {"coefficient": 0.015}},
    "wind 6 m/s": {"wind": {"x": 6.0, "y": 0.0, "z": 0.0}},
    "mass + 15 %": {"mass": {"ratio": 1.15}},
    "gusts of 1 m/s": {"gust": {"intensity": 1.0, "correlation_time": 1.0}},
}
MODELS = {"grey box": "arpl_250g.grey_box", "PI-TCN": "arpl_250g.pi_tcn", "grey box, trained slow": "slow"}
MODES = ("adapt off", "network shadow", "network on")  # shadow flies bit for bit as off
FADING, FADED_WITH = ("grey box", "grey box, trained slow"), ("as trained", "drags x 1.5", "gusts of 1 m/s")
FOLLOWING = (
    *(("grey box", hidden, "Lemniscate") for hidden in HIDDEN),
    *(("grey box", hidden, "WarpedEllipse_1") for hidden in ("as trained", "drags x 1.5", "gusts of 1 m/s")),
    ("grey box, trained slow", "as trained", "Lemniscate"),
    ("PI-TCN", "as trained", "Lemniscate"),
    ("PI-TCN", "drags x 1.5", "Lemniscate"),
)
COLUMNS = (
    "adapt off",
    "disturbance",
    "and last layer",
    "over the disturbance alone",
    "over adapt off",
    "forecast error",
    "trust",
)


@dataclass(frozen=True)
class Case:
    """A flight. fades: whether the residual may."""

    model: str
    hidden: str
    reference: str
    mode: str
    fades: bool
    seed: int

    @property
    def key(self) -> str:
        """Unique name."""
        return ", ".join(map(str, asdict(self).values()))


def cases(seeds: int) -> list[Case]:
    """Fading: off and on, without anything that follows; following: with what is hidden, by mode."""
    listed = []
    for seed in range(FIRST_SEED, FIRST_SEED + MORE_IN_GUSTS * seeds):
        for model in FADING:
            for hidden in FADED_WITH:
                listed += [Case(model, hidden, "Lemniscate", "adapt off", fades, seed) for fades in (False, True)]
        listed += [Case(*flight, mode, fades=True, seed=seed) for flight in FOLLOWING for mode in MODES]
    flown_in = {case.key: case for case in listed if case.seed < FIRST_SEED + seeds or case.hidden.startswith("gusts")}
    return list(flown_in.values())


@lru_cache
def bundle_of(model: str, fades: bool) -> Bundle:
    """The bundle of a model, exported once. fades: whether its residual may."""
    folder = BUNDLES / f"{MODELS[model]}{'' if fades else '.always'}"
    if not folder.exists():
        exported = read_model(checkpoint_of(model))
        if not fades and exported.ensemble is not None:
            exported = dataclasses.replace(exported, ensemble=dataclasses.replace(exported.ensemble, fades=False))
        export_bundle(exported, folder, ExportOptions(Problem(), native_processor(), windows=50))
    return read_bundle(folder)


def checkpoint_of(model: str) -> Path:
    """A bundled model, or the one that is trained on slow flights."""
    if MODELS[model] != "slow":
        return FOLDER / f"{MODELS[model]}.pt"
    name, effects = "slow_grey_box_short", [word for effect in EFFECTS for word in ("--effect", effect)]
    slow = sorted((CAMPAIGN / "train").glob(SLOW))
    trained(name, slow, "--model", "grey_box", "--steps", "4000", *effects, jobs=1)
    return ROOT / "build" / "learning_goals" / f"{name}.pt"


def uses(hidden: str, rotors: int) -> list[EffectUse]:
    """Hidden effects of the vehicle: the campaign's, with other values and more."""
    changed, campaign = HIDDEN[hidden], [parse_effect(text, rotors) for text in REAL_WORLD]
    there = [EffectUse(use.name, {**use.parameters, **changed.get(use.name, {})}, use.rotor) for use in campaign]
    names = {use.name for use in campaign}
    return [*there, *(EffectUse(name, values) for name, values in changed.items() if name not in names)]


def flown(case: Case, network: NetworkSettings | None = None) -> dict[str, Any]:
    """Errors of a flight, m, what the network knew, and what followed."""
    body, bundle = read_vehicle(FOLDER / f"{VEHICLE}.toml"), bundle_of(case.model, case.fades)
    follows, _, mode = case.mode.partition(" ")
    settings = AdaptationSettings(
        mode="on" if follows == "network" else "off",
        network=msgspec.structs.replace(network or NetworkSettings(), mode=mode),
    )
    options = ControllerOptions.for_vehicle(bundle.vehicle, adaptation=settings)
    controller, shares = Controller.from_bundle(bundle, options), list[float]()
    prepare = controller.prepare

    def recorded(states: Floats, inputs: Floats) -> None:
        prepare(states, inputs)
        shares.append(controller.network_share)

    controller.prepare = recorded  # type: ignore[method-assign]
    try:
        flight = fly_reference(
            body,
            named_reference(case.reference, controller.trim, duration=SECONDS),
            effects=uses(case.hidden, body.rotors.count),
            seed=case.seed,
            controller=controller,
            nominal=Controller.fallback_from_bundle(bundle, options),
        )
    except VehicleError as error:  # the mock's autopilot did not settle at the start, in gusts: nothing was flown
        return {**asdict(case), "key": case.key, "not_begun": str(error)}
    layer = None if controller.adaptation is None else controller.adaptation.network
    return {
        **asdict(case),
        "key": case.key,
        "rmse": flight.position_rmse,
        "aborted": flight.aborted,
        "fallback_seconds": flight.fallback_seconds,
        "events": dict(flight.events),
        "share": float(np.mean(shares)),
        "errors": [] if layer is None else np.sqrt(layer.squares).tolist(),
        "trust": None if layer is None else layer.trust,
        "change": [] if layer is None else np.linalg.norm(layer.change, axis=1).tolist(),
    }


def fading_table(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Tracking with the residual always flown, and faded."""
    lines = ["| model | vehicle | residual always | faded | ratio | share flown |", "| --- " * 6 + "|"]
    for model in FADING:
        for hidden in FADED_WITH:
            flight = (model, hidden, "Lemniscate", "adapt off")
            some = [r for r in results if (r["model"], r["hidden"], r["reference"], r["mode"]) == flight]
            always, faded = ({r["seed"]: r for r in some if r["fades"] == fades} for fades in (False, True))
            errors = [[r["rmse"] for r in rows.values()] for rows in (always, faded)]
            ratios = [faded[seed]["rmse"] / always[seed]["rmse"] for seed in faded if seed in always]
            share = float(np.median([r["share"] for r in faded.values()])) if faded else float("nan")
            cells = [model, hidden, *map(_cm, errors), _ratio(ratios)]
            lines.append(f"| {' | '.join(cells)} | {share:.2f} |")
    return lines


def following_table(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Tracking and forecasts by what is hidden, without anything that follows, with the disturbance, with both."""
    heads = ("model", "vehicle", "reference", *COLUMNS)
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for flight in FOLLOWING:
        some = [r for r in results if (r["model"], r["hidden"], r["reference"]) == flight and r["fades"]]
        off, shadow, on = ({r["seed"]: r for r in some if r["mode"] == mode} for mode in MODES)
        errors = [_cm([r["rmse"] for r in rows.values()]) for rows in (off, shadow, on)]
        ratios = [
            _ratio([on[seed]["rmse"] / rows[seed]["rmse"] for seed in on if seed in rows]) for rows in (shadow, off)
        ]
        forecast = _ratio([r["errors"][0] / r["errors"][1] for r in shadow.values()])
        trust = float(np.median([r["trust"] for r in on.values()])) if on else float("nan")
        lines.append(f"| {' | '.join([*flight, *errors, *ratios, forecast])} | {trust:.1f} |")
    return lines


def _fallbacks(results: Sequence[Mapping[str, Any]]) -> str:
    """How long the vehicle file's model flew instead, by model."""
    parts = []
    for model in MODELS:
        shares = [r["fallback_seconds"] / SECONDS for r in results if r["model"] == model]
        parts.append(f"{model} {float(np.mean(shares)):.0%}")
    return f"Share of the time in which the vehicle file's model flew instead: {', '.join(parts)}."


def _cm(errors: Sequence[float]) -> str:
    return f"{100 * float(np.median(errors)):.2f} ({100 * max(errors):.2f})" if errors else ""


def _ratio(ratios: Sequence[float]) -> str:
    return f"{float(np.median(ratios)):.2f} ({max(ratios):.2f})" if ratios else ""


def cost_table() -> list[str]:
    """Microseconds of a tick by part, on the grey box's own kernel."""
    bundle = bundle_of("grey box", fades=True)
    settings = AdaptationSettings(mode="on", network=NetworkSettings(mode="on"))
    controller = Controller.from_bundle(bundle, ControllerOptions.for_vehicle(bundle.vehicle, adaptation=settings))
    solver, adaptation = controller.solver, controller.adaptation
    assert adaptation is not None
    assert adaptation.network is not None
    layer = adaptation.network
    state = solver.model.initial_state(np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6]))
    speed = solver.trim.rotor_speed
    solver.history[:] = np.concatenate([state[:RIGID_BODY_STATES], speed])
    solver.reset(state)
    solver.state_reference[:], solver.input_reference[:] = state, speed
    psi, turned = layer.features.of(solver.last_input), np.eye(3)

    def nine() -> None:
        for _ in range(9):
            layer.add(np.zeros(3), psi, turned, 0.01, 0.3)

    def tenth() -> None:
        layer.add(np.zeros(3), psi, turned, 0.1, 0.3)

    def fly() -> None:
        solver.output_change[:3] = layer.change @ layer.features.projection
        layer.within(layer.features.of(solver.last_input))

    parts = {
        "assessment by all four members (fading)": (lambda: solver.assess(state, speed), 1),
        "last layer: an estimate into a row": (nine, 9),
        "last layer: every tenth estimate, the update": (tenth, 1),
        "last layer: features, bounds, the change into the kernel": (fly, 1),
        "preparation of the problem, for comparison": (lambda: solver.prepare(state), 1),
        "feedback, which none of this touches": (lambda: solver.feedback(state), 1),
    }
    lines = ["| part | us, median |", "| --- | --- |"]
    for name, (work, times) in parts.items():
        seconds = []
        for _ in range(500):
            start = time.perf_counter()
            work()
            seconds.append(time.perf_counter() - start)
        lines.append(f"| {name} | {1e6 * float(np.median(seconds)) / times:.1f} |")
    return lines


def page(results: Sequence[Mapping[str, Any]], left_out: int) -> str:
    """All tables. left_out: number of seeds with which gusts kept flights from beginning."""
    seeds = sorted({r["seed"] for r in results})
    ended = [f"{r['key']}: {r['aborted']}" for r in results if r["aborted"]]
    body = [
        f"Position error, cm RMS over {SECONDS:g} s in lockstep: median (worst) of seeds from {seeds[0]} on, ten but "
        "in gusts. The vehicle hides all that the campaign's does, and what the column `vehicle` names. Ratios are by "
        "seed, median (worst).",
        "",
        "**The residual fades**, Lemniscate, nothing follows:",
        "",
        *fading_table(results),
        "",
        "**The last layer follows.** Forecast error: of a block of 0.1 s with the change over that without, at the end "
        "of the flight in shadow.",
        "",
        *following_table(results),
        "",
        f"Ended early: {'; '.join(ended) or 'none'}. {_fallbacks(results)}",
        "",
        f"In gusts of 1 m/s the mock's autopilot does not settle at the start with every seed: {left_out} are left "
        f"out, and {len({r['seed'] for r in results if r['hidden'].startswith('gusts')})} flown.",
        "",
        "**Cost**, beside other work on this machine:",
        "",
        *cost_table(),
    ]
    return "\n".join(body)


def in_flight(words: Sequence[str]) -> Page:
    """A learned model in flight, in lockstep: its residual fades where it does not know, its last layer follows.

    Needs `alula campaign --out build/campaign_learning`, and trains a grey box on its slow flights alone (two minutes).
    Flown is the campaign's vehicle with all that it hides, and with more that no model was trained on. Finished flights
    are kept, so that a run that was stopped resumes. Writes results/network_in_flight.md.

        python -m benchmarks network in_flight --seeds 10
    """
    parser = options_of(in_flight.__doc__, resumes="network_in_flight", jobs=1, seeds=10)
    parser.set_defaults(kept=BUNDLES / "flights.jsonl")
    parser.add_argument("--only-finished", action="store_true", help="fly nothing, write what is there")
    options = parser.parse_args(words)
    done = finished(options.kept)
    todo = [case for case in cases(options.seeds) if case.key not in done and not options.only_finished]
    for case in {(case.model, case.fades): case for case in todo}.values():
        bundle_of(case.model, case.fades)
    measured(flown, todo, options, spoken, key_of=lambda case: case.key)
    done = finished(options.kept)
    results = [done[case.key] for case in cases(options.seeds) if "rmse" in done.get(case.key, {})]
    left_out = len({result["seed"] for result in done.values() if "not_begun" in result})
    title = "A learned model that knows what it does not know"
    return Page("network_in_flight", title, page(results, left_out))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']}: {100 * result.get('rmse', float('nan')):.2f} cm"


HEAD_STEPS, HEAD_BATCH, HEAD_WIDTH = 3000, 512, 16
RIDGE = 1e-4  # of the mean variance of a layer's outputs
Sign = Callable[["Activations"], Floats]
Activations = list[Floats]  # standardised newest inputs, code, hidden layers of the flown member; (m, width) each


def activations(model: TrainedModel, data: LabelledRows) -> Activations:
    """Activations of the first member's layers at a data set's windows."""
    network, scaling = model.networks[0], model.scaling
    decoder = network.decoder
    assert isinstance(decoder, nn.Sequential)
    inputs_of: list[list[Tensor]] = [[] for _ in range(1 + len(decoder) // 2)]
    handles = [decoder[0].register_forward_pre_hook(lambda _, values: inputs_of[0].append(values[0]))]
    for place, layer in enumerate((part for part in decoder if isinstance(part, nn.ReLU)), start=1):
        handles.append(layer.register_forward_hook(lambda _, __, output, place=place: inputs_of[place].append(output)))
    offsets = np.arange(1 - model.config.history, 1)
    for start in range(0, len(data.ends), EVALUATION_BATCH):
        model.outputs(data.inputs[data.ends[start : start + EVALUATION_BATCH, None] + offsets], member=0)
    for handle in handles:
        handle.remove()
    newest = (data.inputs[data.ends] - scaling.input_mean) / scaling.input_std
    return [newest, *(torch.cat(parts).double().numpy() for parts in inputs_of)]


def leverage(training: Activations, layers: Sequence[int]) -> Sign:
    """Root of phi' M^-1 phi of some layers' outputs and 1, M their second moment in training."""

    def phi(values: Activations) -> Floats:
        return np.hstack([*(values[layer] for layer in layers), np.ones((len(values[0]), 1))])

    rows = phi(training)
    moment = rows.T @ rows / len(rows)
    factor = np.linalg.cholesky(moment + RIDGE * np.trace(moment) / len(moment) * np.eye(len(moment)))
    return lambda values: np.linalg.norm(np.linalg.solve(factor, phi(values).T), axis=0)


def distilled(training: Activations, disagreement: Floats) -> Sign:
    """A head on all layers that learned the logarithm of the members' disagreement in training."""
    torch.manual_seed(0)
    inputs, target = np.hstack(training[1:]), np.log(disagreement + 1e-9)
    mean, std = inputs.mean(axis=0), inputs.std(axis=0) + 1e-6
    rows = torch.as_tensor((inputs - mean) / std).float()
    values = torch.as_tensor((target - target.mean()) / target.std()).float()
    head = nn.Sequential(nn.Linear(rows.shape[1], HEAD_WIDTH), nn.ReLU(), nn.Linear(HEAD_WIDTH, 1))
    optimiser = torch.optim.Adam(head.parameters(), 3e-3)
    for _ in range(HEAD_STEPS):
        batch = torch.randint(0, len(rows), (HEAD_BATCH,))
        loss = torch.mean((head(rows[batch])[:, 0] - values[batch]) ** 2)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()

    def sign(values: Activations) -> Floats:
        with torch.no_grad():
            score = head(torch.as_tensor((np.hstack(values[1:]) - mean) / std).float())[:, 0]
        return np.asarray(np.exp(score.double().numpy() * target.std() + target.mean()))

    return sign


def labelled(model: TrainedModel, names: Mapping[str, str]) -> LabelledRows:
    """The campaign's training flights of these names."""
    paths = [path for path in find_logs([CAMPAIGN]) if path.name in names]
    return label_rows(model.config, model.vehicle, read_logged_flights(paths, dt=model.config.dt))


def rows_of(name: str) -> list[tuple[TableCell, ...]]:
    """A row for each sign of a model."""
    model = load(Path(checkpoint_of(name)))
    training, validation, test = (
        labelled(model, model.card.flights),
        labelled(model, model.card.validation),
        judged(model),
    )
    truth = true_label(test, CAMPAIGN, dt=model.config.dt)[test.ends]
    base = None if test.base is None else test.base[test.ends]
    target = outputs_from(model.config, model.vehicle, truth, base, test.state[test.ends, ATTITUDE])
    finite = np.isfinite(target).all(axis=1)
    std = model.scaling.output_std

    def disagreement(data: LabelledRows) -> Floats:
        return disagreement_of(member_outputs(model, data), std)

    outputs = member_outputs(model, test)[:, finite]
    error = np.sqrt(np.mean(((outputs[0] - target[finite]) / std) ** 2, axis=1))
    worst = error > np.quantile(error, 1 - WORST_SHARE)
    learned = activations(model, training)
    signs = {
        "leverage, newest inputs": leverage(learned, (0,)),
        "leverage, last hidden layer": leverage(learned, (len(learned) - 1,)),
        "leverage, all layers": leverage(learned, range(1, len(learned))),
        "distilled head": distilled(learned, disagreement(training)),
    }
    tested, usual_ones = activations(model, test), activations(model, validation)
    members = disagreement_of(outputs, std)
    scores = {f"{len(outputs)} members' disagreement": (members, disagreement(validation))}
    scores |= {label: (sign(tested)[finite], sign(usual_ones)) for label, sign in signs.items()}
    much = members > np.quantile(members, 1 - WORST_SHARE)
    table: list[tuple[TableCell, ...]] = []
    for label, (score, usual) in scores.items():
        gate = gate_of(score, float(np.quantile(usual, FADE_QUANTILE)))
        left = np.sqrt(np.mean(((gate[:, None] * outputs[0] - target[finite]) / std) ** 2))
        faded = (float(np.mean(gate < 1)), float(left)) if model.config.base == "grey_box" else (None, None)
        table.append((name, label, auroc(score, worst), auroc(score, much), *faded, float(np.sqrt(np.mean(error**2)))))
    return table


def uncertainty(words: Sequence[str]) -> Page:
    """Which sign of uncertainty finds the rows where a network errs: members, leverage of its layers, a distilled head.

    Needs `alula campaign --out build/campaign_learning`, and trains a grey box on its slow flights alone (two minutes).
    AUROC for the worst tenth of the rows of the flown member's error against the truth, on the eight test flights; and
    what the grey box errs there when its residual fades by that sign, from the sign's own 99th percentile on the
    validation flights on. Writes results/network_uncertainty.md.

        python -m benchmarks network uncertainty
    """
    options_of(uncertainty.__doc__).parse_args(words)
    headings = (
        "model",
        "sign",
        "AUROC, worst tenth",
        "AUROC, tenth of greatest disagreement",
        "faded",
        "error, faded",
        "error, not faded",
    )
    rows = [row for name in MODELS for row in rows_of(name)]
    note = "Errors of the first member, RMS in standard deviations of the outputs."
    table = Table("signs", "Signs", headings, tuple(rows), note)
    return Page("network_uncertainty", "Signs of a network's uncertainty", markdown(table))
