"""Parts of ``motion.py``: runs with the motion between their poses, and models of MuJoCo."""
