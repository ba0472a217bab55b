"""The studies of a sweep, the paper's and further ones, as lists of trainings."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from studies.sweep.cell import Cell, StudyOptions, repeated

FACTORS = (0.6, 0.8, 1.0, 1.2, 1.4)
HISTORIES = (20, 10, 4, 1, 0)
WEIGHTS = (0.0, 0.001, 0.01, 0.1, 1.0)
GRID, SEARCH = "grid", "search"  # studies of the user's own
DEFAULT_RANGE = "physics_weight=1e-4:1"  # lambda
STARRED = "starred"  # the study that needs flights of a simulation without effects as well
SLOW = "*_60.*"  # pattern of the training flights at six tenths of their speed


@dataclass(frozen=True)
class Study:
    """A study: its cells and the quantities in which they differ.

    along: names of those quantities, keys of `Cell.at`.
    cells: of the study, by its options.
    """

    name: str
    summary: str
    along: tuple[str, ...]
    cells: Callable[[StudyOptions], tuple[Cell, ...]]


def _kinds(options: StudyOptions) -> tuple[Cell, ...]:
    """Every model of Table I that is trained on the flights, and window_mlp."""
    kinds = ("res_tcn", "mse_tcn", "pi_mlp", "pi_tcn", "window_mlp")
    return tuple(cell for kind in kinds for cell in repeated(options, kind, {"model": kind}, kind))


def _ablation(options: StudyOptions) -> tuple[Cell, ...]:
    """History and physics-inspired loss, each with and without (Table III)."""
    cells: list[Cell] = []
    for history, loss in itertools.product(("yes", "no"), ("yes", "no")):
        at = {"history": history, "physics loss": loss}
        overrides: dict[str, Any] = {} if loss == "yes" else {"recipe": {"physics_weight": 0.0}}
        model = "pi_tcn" if history == "yes" else "pi_mlp"
        cells += repeated(options, f"history_{history}_loss_{loss}", at, model, **overrides)
    return tuple(cells)


def _history(options: StudyOptions) -> tuple[Cell, ...]:
    """PI-TCN with fewer and fewer columns; without past ones it is its decoder alone (supplement)."""
    cells: list[Cell] = []
    for history in HISTORIES:
        at = {"history": float(history)}
        if history:
            cells += repeated(options, f"history_{history}", at, "pi_tcn", config={"history": history})
        else:
            cells += repeated(options, "history_0", at, "pi_mlp")
    return tuple(cells)


def _priors(*names: str) -> Callable[[StudyOptions], tuple[Cell, ...]]:
    """RES-TCN and PI-TCN trained with each wrong prior (Figure 4); NOM needs no training."""

    def cells(options: StudyOptions) -> tuple[Cell, ...]:
        trained: list[Cell] = []
        for first, second in itertools.product(FACTORS, FACTORS):
            prior = dict(zip(names, (first, second), strict=True))
            words = "_".join(f"{name}_{factor:g}" for name, factor in prior.items())
            for model in ("res_tcn", "pi_tcn"):
                trained += repeated(options, f"{model}_{words}", {"model": model, **prior}, model, prior=prior)
        return tuple(trained)

    return cells


def _weight(options: StudyOptions) -> tuple[Cell, ...]:
    """lambda, with collocation points on plausible histories and in the whole space."""
    return tuple(
        cell
        for points in ("plausible", "space")
        for weight in WEIGHTS
        if weight > 0 or points == "plausible"
        for cell in repeated(
            options,
            f"lambda_{weight:g}_{points}",
            {"lambda": weight, "points": points},
            "pi_tcn",
            recipe={"physics_weight": weight, "physics_points": points},
        )
    )


def _motors(options: StudyOptions) -> tuple[Cell, ...]:
    """The control: a network without the motors, on logged inputs and on the paper's filtered ones."""
    cells: list[Cell] = []
    filtered = {"filtered_inputs": True, "label": "instantaneous", "motors": "measured"}
    for (inputs, config), hidden in itertools.product((("logged", {}), ("filtered", filtered)), (False, True)):
        motors = "hidden" if hidden else "seen"
        at = {"inputs": inputs, "motors": motors}
        cells += repeated(options, f"{inputs}_motors_{motors}", at, "mse_tcn", config=config, hide_motors=hidden)
    return tuple(cells)


def _regimes(options: StudyOptions) -> tuple[Cell, ...]:
    """Trained on slow flights alone, or on all; tested on the fast flights."""
    return tuple(
        cell
        for words, flights in (("slow", SLOW), ("all", "*"))
        for model in ("mse_tcn", "res_tcn", "pi_tcn")
        for cell in repeated(options, f"{model}_{words}", {"model": model, "trained on": words}, model, flights=flights)
    )


def _starred(options: StudyOptions) -> tuple[Cell, ...]:
    """PI-TCN and PI-MLP of Table I, and with a star those trained in a simulation without effects alone."""
    return tuple(
        cell
        for model in ("pi_mlp", "pi_tcn")
        for name, simulated in ((f"{model}*", True), (model, False))
        for cell in repeated(
            options, f"{model}_{'simulation' if simulated else 'flights'}", {"model": name}, model, simulated=simulated
        )
    )


STUDIES: Mapping[str, Study] = {
    study.name: study
    for study in (
        Study("kinds", "every model of Table I on the same flights", ("model",), _kinds),
        Study("ablation", "history and physics loss, with and without", ("history", "physics loss"), _ablation),
        Study("history", "20, 10, 4, 1 and 0 columns", ("history",), _history),
        Study("inertia", "priors with wrong Jxx and Jzz", ("model", "Jxx", "Jzz"), _priors("Jxx", "Jzz")),
        Study("rotors", "priors with wrong k_f and k_tau", ("model", "k_f", "k_tau"), _priors("k_f", "k_tau")),
        Study("lambda", "weights of the physics-inspired loss", ("lambda", "points"), _weight),
        Study("motors", "networks without motor inputs", ("inputs", "motors"), _motors),
        Study("regimes", "trained slow, flown fast", ("model", "trained on"), _regimes),
        Study(STARRED, "trained in a simulation without effects", ("model",), _starred),
    )
}  # fmt: skip


def grid_cells(
    options: StudyOptions, model: str, config: Mapping[str, Sequence[Any]], recipe: Mapping[str, Sequence[Any]]
) -> tuple[Cell, ...]:
    """Every combination of values of a model's and a recipe's fields."""
    names = [*config, *recipe]
    cells: list[Cell] = []
    for values in itertools.product(*config.values(), *recipe.values()):
        chosen = dict(zip(names, values, strict=True))
        name = "_".join(f"{key}_{value}" for key, value in chosen.items()).replace("/", "-")
        changed = {key: value for key, value in chosen.items() if key in config}
        rest = {key: value for key, value in chosen.items() if key in recipe}
        at = {key: ("yes" if value else "no") if isinstance(value, bool) else value for key, value in chosen.items()}
        cells += repeated(options, f"{model}_{name}", at, model, config=changed, recipe=rest)
    return tuple(cells)
