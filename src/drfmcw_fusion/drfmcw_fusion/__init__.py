"""From the beat frequencies of two stations to their distance."""
