"""Receivers: perfect, noisy, replayed."""
