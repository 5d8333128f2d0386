"""From unpacked stations to a commissioned crane: calibration of each station indoors, of the pair on site."""
