"""The short guide that goes with the files for the controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbcacq_kuka.eki.options import EkiOptions as EkiOptions
    from mbcacq_kuka.rsi.options import RsiOptions as RsiOptions

_HEAD = """Files for the controller: {what}
plan: {plan}
robot: {robot}

NONE OF THESE FILES HAS EVER RUN ON A REAL CONTROLLER. They follow KUKA's published
templates and public documentation. Read them. First try: T1, a low `robot: speed` in
the plan (0.05), nothing in reach of the arm, a hand on the stop. Write them
again after every change of the plan's robot section; copy them as an expert user;
they are ASCII and must stay so.
"""

_TOOL = """
TOOL
  tool_data.txt holds the plan's tool and load as lines of $config.dat. Enter them
  under Start-up > Calibrate > Tool (or merge the lines by hand) as tool {tool}.
"""


def eki_guide(options: EkiOptions, facts: Mapping[str, Any], warnings: Sequence[str] = ()) -> str:
    first = options.first_flag
    return (
        _head("EthernetKRL, driver kuka-eki", facts, warnings)
        + f"""
WHERE EACH FILE GOES
  KRC4, KRC5 with KSS 8.x and EthernetKRL 2 or 3: folder kss
    EthernetKRL/mbcacq_eki.xml       C:\\KRC\\ROBOTER\\Config\\User\\Common\\EthernetKRL
    Program/mbcacq_eki.src, .dat     KRC:\\R1\\Program
    Program/mbcacq_link.src          KRC:\\R1\\Program
    System/mbcacq_link_sub.sub       KRC:\\R1\\System, only with a second submit interpreter
  iiQKA.OS2 with EthernetKRL 6: folder iiqka
    EthernetKRL/mbcacq_eki.xml       Config/EthernetKRL/Ethernet configuration
    Program/*                        Program

SUBMIT INTERPRETER
  Add to SPS.SUB: in USER INIT the line   mbcacq_link_init()
                  in USER PLC the line    mbcacq_link_step()
  or select mbcacq_link_sub in a submit interpreter of its own. Never both.

RESERVED
  $FLAG[{first}] to $FLAG[{first + 4}], $TIMER[19] and [20], interrupt 21, channel mbcacq_eki.
  If your programs use one of these flags, set the plan's option first_flag.

NETWORK
  The controller listens: TCP {options.address} port {options.port} (KLI). Open the port in the
  controller's network configuration (NAT), not to the outside of the cell. One
  client at a time; a second one is refused.
{_TOOL.format(tool=options.tool)}
ORDER OF STARTING
  1. Controller up, submit interpreter running (S on the smartPAD is green).
  2. Bring the arm to a free place. Select mbcacq_eki, mode {" or ".join(options.mode)}, override {options.override or "any"} %.
  3. Drives on, press start: block coincidence (BCO), then "waiting" in mb_serve.
     In T1 keep the enabling switch and the start key pressed during all moves.
  4. mbcacq run PLAN. It compares robot model, tool {options.tool}, base {options.base}, mode, override and the
     flange position with the plan, and refuses a cell that differs.

WHAT THE SMARTPAD SHOWS
  mb_serve, WAIT FOR $FLAG[{first + 2}]   ready, no move waits
  mb_move, PTP                    a move is driven
  program stopped, red R          a message tells why; acknowledge, start again
  EKI00023                        channel was loaded already: harmless after a restart
  EKI00009, EKI00512              the computer has hung up; the channel is made new

WHAT STOPS THE ARM
  Ctrl-C, an error and the end of mbcacq: BRAKE on the path. The computer silent for
  {options.controller_silence_ms} ms or the connection lost: the same, by the controller itself.
  Targets outside the plan's joint limits and speeds beyond the plan's are refused.
"""
        + _outputs(options.digital_outputs, "It goes off with whatever stops the arm, an emergency stop too: the link program sees to it.")
    )


def rsi_guide(options: RsiOptions, facts: Mapping[str, Any], reach: Sequence[float], warnings: Sequence[str] = ()) -> str:
    far = ", ".join(f"{v:g}" for v in reach)
    return (
        _head("RobotSensorInterface, driver kuka-rsi", facts, warnings)
        + f"""
WHERE EACH FILE GOES
  The version of RSI decides, not that of KSS (smartPAD: Help > Info > Options):
  up to 4.0 it reads .rsi contexts, from 4.1 on .rsix. KSS 8.5.5 with RSI 4.0.6,
  say, takes kss_older; RSI_CREATE "file not found" means the other folder.
  RSI 4.1 or newer, 5.x (KSS 8.5 and newer as a rule): folder kss85
    SensorInterface/*                C:\\KRC\\ROBOTER\\Config\\User\\Common\\SensorInterface
    Program/*                        KRC:\\R1\\Program
  RSI 3.x and 4.0 (KSS older than 8.5 as a rule): folder kss_older
    SensorInterface/* (four files, inseparable) and Program/* as above
  iiQKA.OS2 with RSI 6: folder iiqka
    Context/*                        Config/RobotSensorInterface/Context
    Ethernet configuration/*         Config/RobotSensorInterface/Ethernet configuration
    Program/*                        Program/RSI

NETWORK
  The controller sends UDP to {options.bind} port {options.port}: this computer. Nothing has to be
  opened on the controller. Its RSI interface needs a subnet of its own (address type
  "mixed IP", not 192.168.0.x) and a cold restart after every change. A cable of its
  own, no switch shared with other traffic. KUKA's TestServer must not run.
{_TOOL.format(tool=1)}
SPEED
  The override does not scale RSI corrections: a low override makes nothing slower,
  and only 100 % is what the tool is tested with. The speed is the plan's
  `robot: speed`; take 0.05 for a first run. T1 stops a tool faster than 250 mm/s.

RANGE
  RSI 4.1 and later: the program opens the correction up to the software limits or
  the plan's, whichever are narrower. Earlier RSI: fixed at +-({far}) deg;
  the plan's option correction_limit_deg must say the same. iiQKA.OS2: AXISCORRMON
  cannot be set by a program, so its context holds 1000 deg; AXISCORR is the limit.

ORDER OF STARTING
  1. Bring the arm to a free place, override 100 %. Select mbcacq_rsi.
  2. Press start: block coincidence (BCO), then the program stands at HALT.
  3. mbcacq run PLAN. When it waits for the robot, press start again.
     In T1 acknowledge "Sensor correction goes active!" and keep start pressed.

AFTER AN EMERGENCY STOP
  With the plan's option recover_s (seconds to wait): release, acknowledge, reset and
  start mbcacq_rsi again, leave the arm where it is. Past the HALT mbcacq goes on from
  there to the pose it was driving to. Without the option the run ends; --resume.

WHAT THE SMARTPAD SHOWS
  HALT before RSI_ON               start mbcacq now
  RSI_MOVECORR                     mbcacq has the arm
  KSS29002 ... RSIBad, RSITimeout  answers were missing: network or computer
  KSS29000 overall correction      beyond AXISCORRMON
  Command velocity A1              a step too large: report it
  RSI_CREATE ... file not found    name or folder of the context is wrong
  Invalid index - signal output    context and Ethernet file do not fit together
"""
        + _outputs(
            options.digital_outputs,
            "It goes off with a missing answer, and before and after RSI. An emergency stop while\n  it is on leaves it on until "
            "mbcacq_rsi is started again. Copy all files of a folder\n  together: context, Ethernet file and program.",
        )
    )


def _outputs(numbers: Sequence[int], off: str) -> str:
    if not numbers:
        return ""
    named = ", ".join(f"$OUT[{number}]" for number in numbers)
    return f"""
OUTPUTS
  mbcacq switches {named}, and no other. No other program may set it,
  and it must not be write-protected.
  {off}
"""


def _head(what: str, facts: Mapping[str, Any], warnings: Sequence[str]) -> str:
    clean = {key: str(facts.get(key, "-")).encode("ascii", "replace").decode() for key in ("plan", "robot")}
    section = "".join(f"  {text}\n" for text in warnings)
    return _HEAD.format(what=what, **clean) + (f"\nWARNINGS\n{section}" if warnings else "")
