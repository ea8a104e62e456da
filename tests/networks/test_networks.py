"""Networks have the paper's sizes, or ours, and answer for maps of any size where they claim to."""

import numpy as np
import torch
from torch.nn import functional as F  # noqa: N812

from skygain.networks.operator.features import CHANNELS
from skygain.networks.operator.network import OperatorConfig, PropagationOperator
from skygain.networks.scales import PADDING_DB
from skygain.networks.torch_runtime import load_network
from skygain.networks.unets.direct import DirectNet
from skygain.networks.unets.inputs import direct_inputs, paper_inputs
from skygain.networks.unets.paper import PaperUNet, PaperUNets, UpsampledConv2d
from skygain.networks.weights import write_weights

SMALL = OperatorConfig(stem=4, widths=(8, 8, 8), blocks=(1, 1, 2), heads=2)


def test_the_paper_network_has_the_sizes_of_its_table():
    net = PaperUNet(2, "relu")
    sizes = []
    hooks = [
        layer.register_forward_hook(lambda m, i, o: sizes.append(tuple(o.shape[1:])))
        for layer in net.encoder
    ]
    hooks += [
        layer.register_forward_hook(lambda m, i, o: sizes.append(tuple(o.shape[1:])))
        for layer in (net.dense, *net.decoder)
    ]
    out = net(torch.zeros(1, 2, 96, 96))
    # Before pooling; layers 2, 4, 6 and 8 then halve their map.
    assert sizes == [
        *(
            (16, 96, 96),
            (16, 96, 96),
            (32, 48, 48),
            (32, 48, 48),
            (64, 24, 24),
            (64, 24, 24),
            (128, 12, 12),
            (128, 12, 12),
        ),
        (4608,),
        *((128, 12, 12), (64, 24, 24), (32, 48, 48), (16, 96, 96)),
    ]
    assert out.shape == (1, 96, 96)
    convolutions = [m for m in net.modules() if isinstance(m, torch.nn.Conv2d)]
    assert all(m.kernel_size == (4, 4) and m.stride == (1, 1) for m in convolutions)
    # skips 8, 7, 5, 3 and 1: what each decoder layer takes in is the layer before it and the
    # encoder layer of its own size
    assert [m.in_channels for m in net.decoder] == [128 + 128, 128 + 128, 64 + 64, 32 + 32]
    assert net.last.in_channels == 16 + 16
    assert net.dense.weight.shape == (4608, 4608)


def test_the_blind_twin_does_not_see_the_city(rng):
    gain, measured = np.full((1, 96, 96), -100.0, np.float32), np.zeros((1, 96, 96), bool)
    measured[0, 5, 5] = True
    inputs = [
        paper_inputs(np.full((1, 96, 96), height, np.float32), gain, measured, blind=True)
        for height in (0.0, 1.0)
    ]
    assert inputs[0].shape == (1, 1, 96, 96)
    assert np.array_equal(*inputs)
    mean, log_variance = PaperUNets(blind=True)(torch.from_numpy(inputs[0]))
    assert mean.shape == log_variance.shape == (1, 96, 96)


def test_unmeasured_cells_hold_the_padding_value_and_no_truth():
    measured = np.zeros((1, 96, 96), dtype=bool)
    measured[0, 5, 5] = True
    flat = np.zeros((1, 96, 96), np.float32)
    one, two = (paper_inputs(flat, flat + g, measured, blind=False) for g in (-90.0, -70.0))
    differs = (one != two).any(axis=1)[0]
    assert differs.sum() == 1
    assert differs[5, 5]
    assert np.isclose(one[0, 1, 0, 0] * 30 - 120, PADDING_DB)


def test_our_networks_take_maps_of_any_size():
    for shape in ((24, 20), (33, 17), (8, 8)):
        mean, log_variance = PropagationOperator(SMALL).eval()(
            torch.zeros(2, len(CHANNELS), *shape)
        )
        assert mean.shape == log_variance.shape == (2, *shape)
        maps = np.zeros((2, *shape), np.float32)
        inputs = direct_inputs(maps, maps - 100, maps == 0, np.array([10.0, 20.0]))
        direct = DirectNet(SMALL).eval()(torch.from_numpy(inputs))
        assert direct[0].shape == (2, *shape)


def test_the_direct_network_sees_gains_at_measured_cells_only(rng):
    measured = rng.random((1, 24, 24)) < 0.1
    gain = rng.normal(-100, 20, (1, 24, 24)).astype(np.float32)
    other = np.where(measured, gain, gain + 30.0)
    heights, altitude = np.zeros((1, 24, 24), np.float32), np.array([10.0])
    assert np.array_equal(
        direct_inputs(heights, gain, measured, altitude),
        direct_inputs(heights, other, measured, altitude),
    )


def test_shipped_sizes():
    parameters = sum(p.numel() for p in PropagationOperator().parameters())
    assert 2 * parameters < 8e6  # bytes as float16


def test_upsampling_within_the_filter_is_upsampling_before_it():
    torch.manual_seed(0)
    conv, x = UpsampledConv2d(5, 7), torch.randn(2, 5, 6, 8)
    expected = F.conv2d(
        F.pad(F.interpolate(x, scale_factor=2.0), (1, 2, 1, 2)), conv.weight, conv.bias
    )
    assert torch.allclose(conv(x), expected, atol=1e-5)


def test_a_frozen_network_answers_as_the_trained_one_does(rng):
    torch.manual_seed(0)
    network = PaperUNets().eval()
    truth = rng.normal(-120, 20, (2, 96, 96)).astype(np.float32)
    measured = rng.random((2, 96, 96)) < 0.1
    inputs = torch.from_numpy(paper_inputs(0 * truth, truth, measured, blind=False))
    with torch.no_grad():
        mean, log_variance = network(inputs)
        frozen_mean, frozen_log_variance = network.frozen(torch.bfloat16)(inputs)
    assert frozen_mean.dtype == torch.float32
    # bfloat16 has eight bits of 30 dB a unit; what is rounded in many layers averages out
    assert (mean - frozen_mean).square().mean().sqrt() < 0.15
    assert (log_variance - frozen_log_variance).square().mean().sqrt() < 0.02


def test_a_blind_pair_can_begin_from_one_that_sees(tmp_path, rng):
    torch.manual_seed(0)
    seeing, blind = PaperUNets(), PaperUNets(blind=True)
    write_weights(tmp_path / "seeing.safetensors", seeing.state_dict(), {"name": "seeing"})
    load_network(blind, tmp_path / "seeing.safetensors", adapt=True)
    gain = rng.uniform(-140, -60, (2, 96, 96)).astype(np.float32)
    measured = rng.random((2, 96, 96)) < 0.1
    seen, unseen = (
        torch.from_numpy(paper_inputs(0 * gain, gain, measured, blind)) for blind in (False, True)
    )
    with torch.inference_mode():
        for one, two in zip(seeing(seen), blind(unseen), strict=True):
            assert torch.allclose(one, two, atol=1e-3)
