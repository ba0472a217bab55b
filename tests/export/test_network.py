"""A network that no backend could evaluate is refused when it is made."""

import dataclasses

import numpy as np
import pytest

from dynamics.errors import RequestError
from export.network import Convolution, Dense, Network
from tests.support.networks import random_network


def changed(**overrides: object) -> Network:
    return dataclasses.replace(random_network(), **overrides)  # type: ignore[arg-type]


def test_a_receptive_field_longer_than_the_history_is_refused() -> None:
    assert random_network().receptive_field == 19
    with pytest.raises(RequestError, match=r"looks back 19 columns, its windows have 18.*smaller dilations"):
        changed(history=18)


def test_layers_that_do_not_fit_each_other_are_refused() -> None:
    with pytest.raises(RequestError, match="convolution 0 takes 5 entries, its input has 13"):
        changed(convolutions=(Convolution(np.zeros((16, 5, 3)), np.zeros(16), 1),))
    with pytest.raises(RequestError, match="gives 5 outputs, required are 6"):
        changed(perceptron=(Dense(np.zeros((5, 16)), np.zeros(5)),))
    with pytest.raises(RequestError, match="scaling is for 12 inputs"):
        changed(input_mean=np.zeros(12), input_std=np.ones(12))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused_by_name(bad: float) -> None:
    network = random_network()
    network.convolutions[1].weight[0, 0, 0] = bad
    with pytest.raises(RequestError, match="not finite in convolution 1"):
        dataclasses.replace(network)


def test_an_input_that_never_changed_and_a_layer_too_wide_are_refused() -> None:
    with pytest.raises(RequestError, match="never changed in training"):
        changed(input_std=np.zeros(13))
    with pytest.raises(RequestError, match="at most 240"):
        random_network(hidden=(256,))
