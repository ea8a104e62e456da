"""Matrices in 4 and 8 bits."""

import pytest
import torch

from skygain.networks.checkpoints import save_checkpoint
from skygain.networks.quantised import GROUP, dequantised, quantised
from skygain.networks.weights import load_network


@pytest.mark.parametrize("bits", [4, 8])
def test_no_weight_moves_by_more_than_half_a_step(bits):
    weight = torch.randn(6, 3 * GROUP, generator=torch.Generator().manual_seed(0)) * torch.tensor(
        [[1e-3], [1.0], [9.0]] * 2
    )
    tensors = quantised("dense.weight", weight, bits)
    assert tensors[f"dense.weight.q{bits}"].numel() == weight.numel() * bits // 8
    back = dequantised({**tensors, "bias": torch.ones(2)})
    assert set(back) == {"dense.weight", "bias"}
    groups = weight.reshape(6, -1, GROUP)
    step = (groups.amax(-1) - groups.amin(-1)) / (2**bits - 1)
    moved = (back["dense.weight"] - weight).abs().reshape(groups.shape).amax(-1)
    assert (moved <= 0.52 * step + 1e-3 * groups.abs().amax(-1)).all()


def test_a_constant_matrix_survives():
    weight = torch.full((2, GROUP), 0.25)
    assert torch.equal(dequantised(quantised("w", weight, 4))["w"], weight)


@pytest.mark.parametrize(("shape", "bits"), [((2, GROUP + 1), 4), ((GROUP,), 8), ((2, GROUP), 3)])
def test_what_cannot_be_cut_into_groups_is_refused(shape, bits):
    with pytest.raises(ValueError, match=r"expected a matrix|bits must"):
        quantised("w", torch.zeros(shape), bits)


def test_a_network_loads_from_a_quantised_file(tmp_path):
    torch.manual_seed(0)
    network = torch.nn.Linear(2 * GROUP, 5)
    tensors = {
        **quantised("weight", network.weight.detach(), 8),
        "bias": network.bias.detach().half(),
    }
    save_checkpoint(tmp_path / "w.safetensors", tensors, {"name": "test"})
    other = torch.nn.Linear(2 * GROUP, 5)
    assert load_network(other, tmp_path / "w.safetensors")["name"] == "test"
    assert torch.allclose(other.weight, network.weight, atol=1e-3)
