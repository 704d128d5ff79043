"""An arm fitted by pybotics, in the environment that has it (it needs an older numpy): FILE.npz in, one JSON object out.

    python -m venv peer && peer/bin/pip install pybotics
    peer/bin/python benchmarks/pybotics_fit.py FILE.npz

FILE.npz, written by ``benchmarks/solve.py``: q (P, n) rad and xyz (P, 3) mm of a reflector; links (n, 4) alpha, a, theta, d of the modified
DH convention; free (n, 4) bool; tool (6,) and world (6,), first guesses: x, y, z mm and the angles of pybotics. Fitted are the free
parameters of the links, the position of the tool and the whole place of the base.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from pybotics.geometry import vector_2_matrix
from pybotics.kinematic_chain import MDHKinematicChain
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool
from scipy.optimize import least_squares

MOST_EVALUATIONS = 20


def main() -> None:
    given = np.load(sys.argv[1])
    robot = Robot(MDHKinematicChain.from_parameters(given["links"].ravel()), Tool(vector_2_matrix(given["tool"])))
    robot.world_frame = vector_2_matrix(given["world"])
    handler = OptimizationHandler(
        robot, kinematic_chain_mask=given["free"].ravel().tolist(), tool_mask=[True] * 3 + [False] * 3, world_mask=[True] * 6
    )
    begin = time.process_time()
    data = handler, given["q"], given["xyz"]
    start = handler.generate_optimization_vector()
    found = least_squares(optimize_accuracy, start, args=data, x_scale="jac", max_nfev=MOST_EVALUATIONS)
    seconds = time.process_time() - begin
    print(json.dumps({"seconds": seconds, "rms_mm": float(np.sqrt(2 * found.cost / len(given["q"]))), "evaluations": int(found.nfev)}))


if __name__ == "__main__":
    main()
