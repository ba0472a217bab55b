"""The integrator of a model's accelerations: the one that fits its label, and why another one does not."""

from __future__ import annotations

from dynamics.errors import RequestError
from runtime.control.bundle import Integrator
from training.config import ModelConfig


def choose_integrator(config: ModelConfig, requested: Integrator | None) -> Integrator:
    """The integrator of a model's kernel; None for the most accurate one (docs/export.md, "Time steps").

    Raises RequestError for one that does not fit the model's label.
    """
    if config.network == "none":
        if requested in (None, "rk4"):
            return "rk4"
        raise RequestError(f"{config.kind} is a physical model, which is integrated by rk4; leave --integrator out.")
    if config.label == "mean_increment":
        if requested in (None, "hold"):
            return "hold"
        raise RequestError(
            f"this {config.kind} predicts mean accelerations over the next {1e3 * config.dt:g} ms, which are held, not "
            f"integrated by {requested}. Leave --integrator out, or train it with --label instantaneous."
        )
    if requested == "rk4" and config.history > 1:
        raise RequestError(
            f"rk4 evaluates a model between the {config.history} columns of this {config.kind}'s history, where "
            "nothing was measured or trained. Leave --integrator out for adams_bashforth, or take a network without "
            "history (alula train --model pi_mlp --label instantaneous)."
        )
    return requested or "adams_bashforth"


def cautions(config: ModelConfig, integrator: Integrator) -> tuple[str, ...]:
    """Notes for whoever flies the model, one sentence each."""
    sentences = []
    if config.filtered_inputs:
        sentences.append(
            "It was trained on inputs filtered with their future, which no flight has: it is for the workbench, and "
            "`alula fly` refuses it."
        )
    if config.network != "none" and config.motors == "measured":
        sentences.append(
            "It was trained on measured rotor speeds; in flight it gets commanded ones, without the rotors' lag."
        )
    if config.network != "none" and config.label == "instantaneous" and integrator == "hold":
        sentences.append(
            "Its accelerations are those of an instant, yet are held over a step: adams_bashforth predicts better."
        )
    return tuple(sentences)
