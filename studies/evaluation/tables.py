"""Tables of an evaluation, with the paper's own figures where it has them."""

from __future__ import annotations

from collections.abc import Sequence

from studies import paper
from studies.evaluation.inference import Inference
from studies.tables import Table, TableCell
from training.card import FlightError
from training.evaluation import BASE, NOMINAL, PLANT, VEHICLE_FILE, Evaluation, EvaluationReport
from training.prediction import pooled


def evaluation_tables(evaluated: EvaluationReport, timings: Sequence[Inference]) -> tuple[Table, ...]:
    """Every table that has rows."""
    further = (
        _timing_table(timings, evaluated),
        _open_loop_table(evaluated),
        _pulse_table(evaluated),
        _calibration_table(evaluated),
    )
    return (*_table_one(evaluated), *_parts_tables(evaluated), *(table for table in further if table.rows))


def _table_one(evaluated: EvaluationReport) -> list[Table]:
    """RMSE by flight against labels and, where there is one, ground truth; and the ratio to NOM with the paper's."""
    against = [("label", "labels")] + ([("true", "the truth")] if evaluated.models[0].true else [])
    return [_flights_table(evaluated, kind, words) for kind, words in against] + [_ratio_table(evaluated)]


def _flights_table(evaluated: EvaluationReport, against: str, words: str) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for peak in evaluated.peaks:
        errors = [_of_flight(getattr(model, against), peak.flight) for model in evaluated.models]
        rows.append(
            (_short(peak.flight), peak.linear, peak.angular, *(None if e is None else e.combined for e in errors))
        )
    rows.append(("all", None, None, *(pooled(getattr(model, against)).combined for model in evaluated.models)))
    headings = ("flight", "peak m/s²", "peak rad/s²", *(model.name for model in evaluated.models))
    note = "Linear (m/s²) and angular (rad/s²) components count alike, as in the paper."
    return Table(f"rmse_{against}", f"RMSE against {words}", headings, tuple(rows), note)


def _ratio_table(evaluated: EvaluationReport) -> Table:
    models = _learned(evaluated)
    published = {kind for row in paper.PREDICTION.values() for kind in row}
    headings = ["flight"]
    for model in models:
        headings += [f"{model.name} / NOM"] + ([f"paper's {model.kind} / NOM"] if model.kind in published else [])
    rows = []
    for peak in evaluated.peaks:
        cells: list[TableCell] = [_short(peak.flight)]
        for model in models:
            error = _of_flight(model.label, peak.flight)
            ratio = None if error is None else error.combined / error.nominal
            cells.append(ratio)
            if model.kind in published:
                cells.append(paper.prediction_ratio(peak.flight, model.kind))
        rows.append(tuple(cells))
    note = "Against labels. NOM on the same rows and the same labels; the paper's vehicle and flights are other ones."
    return Table("ratio_to_nominal", "RMSE over NOM's, beside the paper's Table I", tuple(headings), tuple(rows), note)


def _parts_tables(evaluated: EvaluationReport) -> list[Table]:
    """All flights as one, linear and angular apart: against labels, and against ground truth where there is one."""
    label = tuple(
        (model.name, model.motors, "filtered" if model.filtered_inputs else "logged", *_parts(model.label))
        for model in evaluated.models
    )
    kinds = ("m/s²", "rad/s²", "both", "/ NOM")
    note = "All flights as one. Filtered: at 5 Hz, both ways, as the paper's; no flight has such inputs."
    title = "Linear and angular accelerations apart, against labels"
    tables = [Table("parts_label", title, ("model", "motors", "inputs", *kinds), label, note)]
    if evaluated.models[0].true:
        note = "All flights as one. Alone: lowest and highest RMSE of a single member, each of its own seed."
        true = tuple(
            (
                model.name,
                *_parts(model.true),
                len(model.members) or None,
                min(model.members, default=None),
                max(model.members, default=None),
            )
            for model in evaluated.models
        )
        headings = ("model", *kinds, "members", "best alone", "worst alone")
        tables.append(Table("parts_true", title.replace("labels", "the truth"), headings, true, note))
    return tables


def _parts(errors: Sequence[FlightError]) -> tuple[float, float, float, float]:
    together = pooled(errors)
    return together.linear, together.angular, together.combined, together.combined / together.nominal


def _timing_table(timings: Sequence[Inference], evaluated: EvaluationReport) -> Table:
    kinds = {model.name: model.kind for model in evaluated.models}
    rows = tuple(
        (t.model, t.engine, 1000 * t.median, 1000 * t.slowest, paper.INFERENCE.get(kinds.get(t.model, "")))
        for t in timings
    )
    note = "One prediction of one network, one thread, on this machine; what else runs on it enters the slowest tenth."
    headings = ("model", "engine", "median ms", "slowest tenth ms", "paper ms")
    return Table("inference", "Time of one prediction", headings, rows, note)


def _open_loop_table(evaluated: EvaluationReport) -> Table:
    plant = {e.horizon: e for model in evaluated.models if model.name == PLANT for e in model.open_loop}
    rows = tuple(
        (
            model.name,
            e.horizon,
            e.position,
            e.velocity,
            e.attitude,
            e.rate,
            e.position / plant[e.horizon].position if e.horizon in plant else None,
        )
        for model in evaluated.models
        for e in model.open_loop
    )
    headings = ("model", "after s", "position m", "velocity m/s", "attitude rad", "rates rad/s", "position / plant's")
    note = "RMS distance of the model run by itself from logged states with logged motors. The plant errs by the noise "
    note += "of the state that it starts from and by moving air."
    return Table("open_loop", "Open-loop prediction", headings, rows, note)


def _pulse_table(evaluated: EvaluationReport) -> Table:
    rows = tuple(
        (
            model.name,
            pulse.name,
            None if pulse.rate is None else 100 * pulse.rate,
            100 * pulse.velocity,
            100 * pulse.thrust,
        )
        for model in evaluated.models
        if model.name != PLANT
        for pulse in model.pulses
    )
    headings = ("model", "pulse on", "body rates %", "velocity %", "velocity along z %")
    note = "Error of the response over the true response, 100 ms after +200 rpm for 10 ms, along the flights."
    return Table("pulses", "Pulse responses against the true plant", headings, rows, note)


def _calibration_table(evaluated: EvaluationReport) -> Table:
    rows = tuple(
        (model.name, len(model.members), c.auroc, 100 * c.coverage, 100 * c.faded)
        for model in evaluated.models
        if (c := model.calibration) is not None
    )
    headings = ("model", "members", "AUROC", "covered %", "faded %")
    note = "AUROC: disagreement as a sign of the worst tenth of the rows. Covered: within error bars meant for 90 %. "
    note += "Faded: rows whose residual is not added in full."
    return Table("calibration", "Calibration of the ensemble", headings, rows, note)


def _of_flight(errors: Sequence[FlightError], flight: str) -> FlightError | None:
    return next((error for error in errors if error.flight == flight), None)


def _short(flight: str) -> str:
    return flight.split(".")[0]


def summary_lines(evaluated: EvaluationReport) -> list[str]:
    """A sentence for each learned model, and the notes."""
    return [*map(_sentence, _learned(evaluated)), *(f"note: {note}" for note in evaluated.notes)]


def ratios_to_nominal(evaluated: EvaluationReport) -> list[float]:
    """RMSE of each trained model over that of the nominal model."""
    errors = [pooled(model.best_known) for model in _learned(evaluated) if model.kind != VEHICLE_FILE]
    return [error.combined / error.nominal for error in errors]


def _learned(evaluated: EvaluationReport) -> list[Evaluation]:
    return [model for model in evaluated.models if model.name not in (NOMINAL, PLANT) and model.kind != BASE]


def _sentence(model: Evaluation) -> str:
    errors = pooled(model.best_known)
    words = "the truth" if model.true else "labels"
    text = f"{model.name}: {errors.combined:.3g} RMSE against {words}, {errors.combined / errors.nominal:.3g} of NOM's"
    if model.label and errors.base is not None and model.kind not in ("nominal", VEHICLE_FILE):
        text += f", {errors.combined / errors.base:.3g} of its base's"
    return f"{text}."
