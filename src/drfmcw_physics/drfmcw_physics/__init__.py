"""Physics of the cooperative dual-ramp FMCW radar, free of ROS: arrays and dataclasses in and out, SI units."""
