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
    "on_grid",
    "joined",
    "read_recording",
    "read_series",
    "replay_scenario",
    "replay_truth",
]

from skygain.instruments.base import Instrument
from skygain.instruments.gridded import GriddedRecording, grid_for, on_grid
from skygain.instruments.reading import read_recording, read_series
from skygain.instruments.recording import Recording, joined
from skygain.instruments.replay import ReplayInstrument, replay_scenario, replay_truth
from skygain.instruments.simulated import NoiseConfig, NoisyInstrument, PerfectInstrument
