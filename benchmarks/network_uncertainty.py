"""Which sign of uncertainty finds the rows where a network errs: members, leverage of its layers, a distilled head.

Needs `alula campaign --out build/campaign_learning`, and trains a grey box on its slow flights alone (two minutes).
AUROC for the worst tenth of the rows of the flown member's error against the truth, on the eight test flights; and what
the grey box errs there when its residual fades by that sign, from the sign's own 99th percentile on the validation
flights on. Writes results/network_uncertainty.md.

    python -m benchmarks.network_uncertainty
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.learning_goals import CAMPAIGN, judged
from benchmarks.network_in_flight import MODELS, checkpoint_of
from benchmarks.provenance import write_result
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE
from studies.tables import Table, TableCell, markdown
from training.calibration import WORST_SHARE, auroc
from training.checkpoint import TrainedModel, load
from training.data.features import outputs_from
from training.data.labelled_rows import LabelledRows, label_rows
from training.data.logged_flights import find_logs, read_logged_flights
from training.ground_truth import true_label
from training.prediction import EVALUATION_BATCH, FADE_QUANTILE, disagreement_of, gate_of, member_outputs

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


def main() -> None:
    """Write the page."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
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
    write_result("network_uncertainty", "Signs of a network's uncertainty", markdown(table))


if __name__ == "__main__":
    main()
