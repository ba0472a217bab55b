"""Training of one cell: its plan, its network, its errors on the test flights."""

from __future__ import annotations

import dataclasses
import os
import socket
import time
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from dynamics.errors import RequestError
from dynamics.vehicle_file import parse_vehicle
from studies.evaluation.inference import time_network
from studies.sweep.cell import CellResult, with_factors
from studies.sweep.cell_work import CellWork
from training import checkpoint
from training.data.labelled_rows import LabelledRows
from training.data.logged_flights import LoggedFlight, read_logged_flights, split_flights
from training.data.tensors import make_scaling
from training.evaluation import rows_for
from training.ground_truth import campaign_of, true_label
from training.plan import Plan, make_plan
from training.prediction import flight_errors, predict
from training.trainer import train

CPU = torch.device("cpu")


def train_cell(work: CellWork) -> CellResult:
    """Train a cell, from its state file if there is one, write its model, and test it.

    Raises DataError and RequestError for a cell that cannot be trained.
    """
    began = time.process_time()
    cell, plan = work.cell, _plan(work)
    if cell.hide_motors:
        plan = _without_motors(plan)
    member = train(plan.task(0, cell.seed, device=CPU, state_file=work.state_file), lambda _: None)
    model = plan.assemble([member], [cell.seed], command=f"alula sweep, cell {cell.name}")
    if not cell.prior:  # the model of a wrong prior serves its errors alone, and its vehicle file may be invalid
        checkpoint.save(model, work.model_file)
    data = rows_for(model, _logged_flights(work.tests, plan.config.dt, work.mapping, True))
    campaign = campaign_of(work.tests)
    truth = None if campaign is None else true_label(data, campaign, dt=plan.config.dt)
    shown = _blind(data, plan.config.rotors) if cell.hide_motors else data
    body = predict(model, shown).body
    return CellResult(
        cell,
        work.fingerprint,
        flight_errors(data, body),
        () if truth is None else flight_errors(data, body, truth),
        member.validation,
        member.steps,
        round(member.seconds, 2),
        time_network(model, data),
        this_worker(),
        round(time.process_time() - began, 2),
    )


def this_worker() -> str:
    """Machine and process."""
    return f"{socket.gethostname()} {os.getpid()}"


def _plan(work: CellWork) -> Plan:
    """The plan that `alula train` would make, with a prior that may be wrong. Raises RequestError without a flight."""
    cell = work.cell
    logs = tuple(log for log in work.learned if fnmatchcase(log.name, cell.flights))
    if not logs:
        raise RequestError(f"no training flight is called {cell.flights!r}, which {cell.name} learns from.")
    config, recipe = work.settled()
    vehicle = with_factors(parse_vehicle(work.vehicle_text), cell.prior)
    split = split_flights(_logged_flights(logs, config.dt, work.mapping, False))
    return make_plan(config, recipe, vehicle, split, seed=cell.seed)


@lru_cache(maxsize=4)
def _logged_flights(
    logs: tuple[Path, ...], dt: float, mapping: Path | None, may_be_tests: bool
) -> tuple[LoggedFlight, ...]:
    """Flights, which the cells of a sweep share: reading sixty takes as long as a thousand steps of training."""
    return read_logged_flights(logs, dt=dt, mapping=mapping, may_be_tests=may_be_tests)


def _without_motors(plan: Plan) -> Plan:
    """The plan of a network whose motor inputs are zero. Raises RequestError with the physics-inspired loss."""
    if plan.collocation is not None:
        raise RequestError("a network without motors has no physics-inspired loss: give --physics-weight 0.")
    training, validation = (_blind(data, plan.config.rotors) for data in (plan.training, plan.validation))
    scaling = make_scaling(plan.config, plan.recipe, plan.vehicle, training)
    return dataclasses.replace(
        plan, training=training, validation=validation, scaling=scaling, fingerprint=f"{plan.fingerprint} blind"
    )


def _blind(data: LabelledRows, rotors: int) -> LabelledRows:
    inputs = np.array(data.inputs)
    inputs[:, -rotors:] = 0.0
    return dataclasses.replace(data, inputs=inputs)
