"""The whole chain offline, from simulated IF samples to ranges: Monte Carlo and the figures of the paper."""
