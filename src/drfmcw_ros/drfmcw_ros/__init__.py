"""Plumbing that every drfmcw node shares: parameters, QoS, diagnostics, shutdown, message boundary, bags."""
