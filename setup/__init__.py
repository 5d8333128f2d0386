"""Makes the environment that `./drfmcw` runs in."""
