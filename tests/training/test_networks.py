"""The networks: only the receptive cone is evaluated, causally, and column by column gives the same."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from dynamics.errors import RequestError
from training.config import ModelConfig, convolutions_for
from training.networks import build_network
from training.networks.tcn import CausalConvolution, TemporalConvolution
from training.streaming import Stream

TCN = ModelConfig("pi_tcn", "tcn")
SHAPES = [
    TCN,
    ModelConfig("pi_tcn", "tcn", inputs="world", outputs="world", batch_norm=True, dropout=0.1),
    ModelConfig("pi_tcn", "tcn", history=10, dilations=(1, 1, 1, 1), rotors=6),
    ModelConfig("pi_tcn", "tcn", history=4, kernel=2, dilations=(1, 2)),
    ModelConfig("pi_tcn", "tcn", history=30, dilations=(3, 2, 6)),
    ModelConfig("pi_mlp", "mlp", history=1),
    ModelConfig("window_mlp", "mlp", history=20),
]


def built(config: ModelConfig) -> nn.Module:
    torch.manual_seed(3)
    network = build_network(config).double()
    for module in network.modules():  # batch norm that does something
        if isinstance(module, nn.BatchNorm1d):
            module.running_mean.uniform_(-1, 1)
            module.running_var.uniform_(0.5, 2)
    return network.eval()


def columns_of(config: ModelConfig, rows: int) -> Tensor:
    return torch.randn(rows, len(config.input_names), dtype=torch.float64)


@pytest.mark.parametrize("config", SHAPES)
def test_streamed_and_windowed_give_the_same(config: ModelConfig) -> None:
    network, columns = built(config), columns_of(config, 45)
    stream = Stream(network, config)
    with torch.no_grad():
        for row in range(45):
            outputs = stream.push(columns[row : row + 1])
            if row + 1 < config.receptive_field:
                assert outputs is None
                assert not stream.is_ready
            elif row + 1 >= config.history:
                windowed = network(columns[None, row + 1 - config.history : row + 1])
                assert stream.is_ready
                assert outputs is not None
                torch.testing.assert_close(outputs, windowed, rtol=0, atol=1e-13)


def padded_convolutions(network: TemporalConvolution, dilations: tuple[int, ...], window: Tensor) -> Tensor:
    """The plain temporal convolution over every position with zero padding on the left, then the last position."""
    signal = window.transpose(1, 2)
    for layer, dilation in zip(network.layers, dilations, strict=True):
        assert isinstance(layer, CausalConvolution)
        weight = layer.linear.weight.view(len(layer.linear.weight), layer.kernel, -1).transpose(1, 2)
        padded = functional.pad(signal, ((layer.kernel - 1) * dilation, 0))
        signal = functional.conv1d(padded, weight, layer.linear.bias, dilation=dilation)
        signal = torch.relu(signal)
        signal = signal if layer.norm is None else layer.norm(signal)
    outputs: Tensor = network.decoder(signal[:, :, -1])
    return outputs


@pytest.mark.parametrize("config", [shape for shape in SHAPES if shape.network == "tcn"])
def test_the_cone_gives_what_convolutions_over_the_whole_window_give(config: ModelConfig) -> None:
    network = built(config)
    assert isinstance(network, TemporalConvolution)
    windows = torch.randn(5, config.history, len(config.input_names), dtype=torch.float64)
    with torch.no_grad():
        torch.testing.assert_close(
            network(windows), padded_convolutions(network, config.dilations, windows), rtol=0, atol=1e-12
        )


def test_the_cone_of_the_papers_network_has_9_7_3_and_1_positions() -> None:
    network = built(TCN)
    assert isinstance(network, TemporalConvolution)
    columns, positions = torch.randn(2, TCN.receptive_field, 13, dtype=torch.float64), []
    for layer in network.layers:
        columns = layer(columns)
        positions.append(columns.shape[1])
    assert positions == [9, 7, 3, 1]


def test_gradients_are_those_of_finite_differences() -> None:
    for config in (TCN, ModelConfig("window_mlp", "mlp", history=4)):
        network = built(config)
        windows = torch.randn(2, config.history, 13, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(network, (windows,), eps=1e-6, atol=1e-6)


def test_gradients_by_weight_are_those_of_finite_differences() -> None:
    network = built(TCN)
    windows = torch.randn(3, TCN.history, 13, dtype=torch.float64)
    weights = list(network.parameters())
    network(windows).square().sum().backward()
    generator = torch.Generator().manual_seed(0)
    for weight in weights:
        place = int(torch.randint(weight.numel(), (1,), generator=generator))
        flat, step = weight.data.view(-1), 1e-6
        values = []
        for sign in (1.0, -1.0):
            flat[place] += sign * step
            values.append(network(windows).square().sum().item())
            flat[place] -= sign * step
        assert weight.grad is not None
        assert weight.grad.view(-1)[place].item() == pytest.approx((values[0] - values[1]) / (2 * step), abs=1e-5)


def test_a_receptive_field_beyond_the_history_is_refused() -> None:
    with pytest.raises(RequestError, match=r"look back 31 columns, the history has 20"):
        ModelConfig("pi_tcn", "tcn", dilations=(1, 2, 4, 8))


@pytest.mark.parametrize("history", [1, 2, 3, 4, 8, 9, 10, 18, 19, 20, 40])
def test_every_history_has_convolutions_that_fit_into_it(history: int) -> None:
    kernel, dilations = convolutions_for(history)
    config = ModelConfig("pi_tcn", "tcn", history=history, kernel=kernel, dilations=dilations)
    assert config.receptive_field <= history
    assert config.receptive_field >= min(history, 5)


def test_the_papers_network_has_as_many_weights_as_section_4_says() -> None:
    config = ModelConfig("pi_tcn", "tcn", inputs="world", outputs="world")
    convolutions = (3 * 14 * 16 + 16) + 3 * (3 * 16 * 16 + 16)
    decoder = (16 * 64 + 64) + (64 * 32 + 32) + (32 * 32 + 32) + (32 * 6 + 6)
    assert sum(weight.numel() for weight in built(config).parameters()) == convolutions + decoder
