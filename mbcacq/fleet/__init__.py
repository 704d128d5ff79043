"""Many recordings of many arms: calibrated, diagnosed and verified on a cluster, compared over time, and learnt from."""
