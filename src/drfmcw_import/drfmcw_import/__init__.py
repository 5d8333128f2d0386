"""Files of other radars into recordings, recordings into files, and looking at recordings."""
