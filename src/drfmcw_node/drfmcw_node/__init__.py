"""One sensor-node of the radar: from IF samples to beat frequencies."""
