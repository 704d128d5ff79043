"""Effects that show in the poses of an arm at rest, one small file an effect."""
