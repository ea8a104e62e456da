"""Matrices in 4 and 8 bits."""

import numpy as np
import pytest

from skygain.networks.quantised import CENTRE, GROUP, dequantised, multipliable, quantised
from skygain.networks.weights import read_weights, write_weights


@pytest.mark.parametrize("bits", [4, 8])
def test_no_weight_moves_by_more_than_half_a_step(bits, rng):
    scale = np.array([[1e-3], [1.0], [9.0]] * 2)
    weight = (rng.normal(size=(6, 3 * GROUP)) * scale).astype(np.float32)
    arrays = quantised("dense.weight", weight, bits)
    assert arrays[f"dense.weight.q{bits}"].size == weight.size * bits // 8
    back = dequantised({**arrays, "bias": np.ones(2)})
    assert set(back) == {"dense.weight", "bias"}
    groups = weight.reshape(6, -1, GROUP)
    step = (groups.max(-1) - groups.min(-1)) / (2**bits - 1)
    moved = np.abs(back["dense.weight"] - weight).reshape(groups.shape).max(-1)
    assert (moved <= 0.52 * step + 1e-3 * np.abs(groups).max(-1)).all()


def test_a_constant_matrix_survives():
    weight = np.full((2, GROUP), 0.25, np.float32)
    assert np.array_equal(dequantised(quantised("w", weight, 4))["w"], weight)


@pytest.mark.parametrize(("shape", "bits"), [((2, GROUP + 1), 4), ((GROUP,), 8), ((2, GROUP), 3)])
def test_what_cannot_be_cut_into_groups_is_refused(shape, bits):
    with pytest.raises(ValueError, match=r"expected a matrix|bits must"):
        quantised("w", np.zeros(shape), bits)


def test_a_weight_file_is_read_unpacked(tmp_path, rng):
    weight = rng.normal(size=(5, 2 * GROUP)).astype(np.float32)
    arrays = {**quantised("weight", weight, 8), "bias": np.ones(5, np.float16)}
    write_weights(tmp_path / "w.safetensors", arrays, {"name": "test"})
    found = read_weights(tmp_path / "w.safetensors")
    assert found.card["name"] == "test"
    assert np.allclose(found.arrays["weight"], weight, atol=0.02)
    assert {a.dtype for a in found.arrays.values()} == {np.dtype(np.float32)}


def test_codes_multiply_as_the_matrix_does(rng):
    weight, x = rng.normal(size=(6, 3 * GROUP)), rng.normal(size=3 * GROUP).astype(np.float32)
    arrays = quantised("w", weight, 4)
    codes, whole = multipliable(arrays), dequantised(arrays)["w"]
    packed = codes["w.q4"].astype(int)
    code = np.stack([packed & 15, packed >> 4], axis=-1).reshape(6, 3, GROUP)
    groups = x.reshape(3, GROUP)
    product = ((code - CENTRE) * groups).sum(-1) * codes["w.step"].reshape(6, 3)
    product += codes["w.middle"] * groups.sum(-1)
    assert np.allclose(product.sum(-1), whole @ x, atol=1e-4)
    assert multipliable(quantised("w", weight, 8)) == {}
