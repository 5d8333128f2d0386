"""Simulator of the cooperative FMCW radar: signal model, effects, scenario, node."""
