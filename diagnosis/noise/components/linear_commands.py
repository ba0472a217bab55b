"""Linear commands: the model draws a line from row to row; commands between leave it as a bridge does."""

from diagnosis.noise.components import held_commands


def linear(m: float) -> float:
    """(1 - 1 / m^2) / 12: mean of m commands between two known ones, each the former and a step of variance 1 / m."""
    return (1 - 1 / m**2) / 12


COMPONENT = held_commands.component(
    "linear_commands",
    "Commands that the log left out, of rows between which a line is drawn",
    "mean of a sampled random walk between two known ends (Brownian bridge)",
    linear,
)
