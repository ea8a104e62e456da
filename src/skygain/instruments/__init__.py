"""Receivers: perfect, noisy, replayed."""

from __future__ import annotations

__all__ = [
    "GriddedRecording",
    "Instrument",
    "NoiseConfig",
    "NoisyInstrument",
    "PerfectInstrument",
    "Recording",
    "ReplayInstrument",
    "grid_for",
    "read_recording",
    "replay_scenario",
    "replay_truth",
]

from skygain.instruments.base import Instrument
from skygain.instruments.gridded import GriddedRecording, grid_for
from skygain.instruments.recording import Recording, read_recording
from skygain.instruments.replay import ReplayInstrument, replay_scenario, replay_truth
from skygain.instruments.simulated import NoiseConfig, NoisyInstrument, PerfectInstrument
