"""How long a computer may stand still that plays the arm, its controller and the driver alike.

In lock-step the robot's clock stands with it: what is late there is late by the computer, not by the device. Paging, a full disk queue or
other work hold single processes for a second and more.
"""

STALL_S = 3.0
HANGING_S = 30.0  # a process that is silent for longer hangs: one of low priority on a busy computer may get no turn for many seconds
