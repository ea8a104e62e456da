"""Checkpoints keep what they were given."""

import torch

from skygain.training.checkpoints import load_checkpoint, save_checkpoint


def test_a_checkpoint_keeps_tensors_and_meta(tmp_path):
    save_checkpoint(tmp_path / "c.safetensors", {"a": torch.arange(3)}, {"step": 2, "name": "x"})
    tensors, meta = load_checkpoint(tmp_path / "c.safetensors")
    assert tensors["a"].tolist() == [0, 1, 2]
    assert meta == {"step": 2, "name": "x"}
