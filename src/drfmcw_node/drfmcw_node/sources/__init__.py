"""Where a station's sweeps come from besides its topic, and their compression. One source per file.

In: bytes of a digitiser, compressed sweeps or a recording. Out: `Frame`, `Sweep` and their settings.
"""
