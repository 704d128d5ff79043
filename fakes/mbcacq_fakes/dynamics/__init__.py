"""An arm in motion behind the fake controller: rigid bodies by MuJoCo, drives, elastic gears and clocks, with faults to inject."""
