"""Effects, one small file an effect: in the poses of an arm at rest, in its motion, or in both."""
