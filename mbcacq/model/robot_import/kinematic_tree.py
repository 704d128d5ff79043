"""Links and joints of a description, whatever its format, and which of them are the one arm in it: without gripper, head and wheels."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError

TURNING = ("revolute", "continuous")
FLANGES = ("flange", "tool0", "tool_flange", "ee_link", "link_ee", "attachment_site", "link_eef")  # usual names, the best first
# Names that people give to the joints of grippers; 'gripper_roll' and its like are the wrist that turns one.
_GRIPPER = re.compile(r"grip|pincer|f1x|robotiq|schunk", re.IGNORECASE)
_FINGER = re.compile(r"finger|fngr|jaw|knuckle|thumb|claw", re.IGNORECASE)
_WRIST = re.compile(r"roll|rot|yaw|pitch|wrist|twist|tilt", re.IGNORECASE)
_NUMBER = re.compile(r"^(.*?)(\d+)(\D*)$")
MOST_JOINTS = 2000  # of a description; robots have a hundred
ARM_BEFORE_FINGERS = 3  # axes: what branches behind fewer of them may be a torso with arms
LONGEST_FINGER, LONGEST_HAND_FINGER = 3, 8  # joints of a finger of a gripper; of a hand on an arm, coupled ones among them
ARM_BEFORE_HAND = 5  # axes before a hand, and before a single slide that is a gripper
ARM_BEHIND_A_TURN = (
    7  # axes behind a slide of which the first may be a vehicle's turn: more than any arm has, or as many and without limits
)
TURNS_OF_A_VEHICLE, ARM_ON_A_VEHICLE = 1, 5  # axes of a vehicle that slides and turns; of the arm on it, which has more behind its slides
SHORTEST_ARM = 4  # axes of an arm that is told from legs, wheels and heads of at most half as many
LIKE_A_JAW = 2.2, 0.2  # rad: the range of a last joint that opens from nearly zero to one side only, as jaws do


@dataclass(frozen=True)
class TreeJoint:
    """A joint of a kinematic tree.

    Attributes
    ----------
    kind : str
        'revolute', 'continuous', 'prismatic', 'fixed' or what the format calls another.
    lower, upper : float
        rad, mm of a prismatic joint, nan where unknown.
    follows : str
        Name of the joint whose motion this one copies, '' for a free one.
    ratio : float
        Its motion over that of the other, in rad and mm.
    bare : bool
        Whether its child is a frame without any shape.
    """

    name: str
    kind: str
    parent: str
    child: str
    lower: float = np.nan
    upper: float = np.nan
    follows: str = ""
    ratio: float = 1.0
    bare: bool = False

    @property
    def is_axis(self) -> bool:
        """Whether it turns, or slides between two ends; a slide without ends is a vehicle's."""
        return self.kind in TURNING or (self.kind == "prismatic" and self.lower < self.upper)


@dataclass(frozen=True)
class Arm:
    """joints: from base to flange, fixed ones among them. remarks: what was decided without being asked."""

    joints: tuple[TreeJoint, ...]
    base: str
    flange: str
    remarks: tuple[str, ...]

    @property
    def axes(self) -> list[TreeJoint]:
        """Those that turn or slide."""
        return [j for j in self.joints if j.is_axis]

    @property
    def sliding(self) -> tuple[int, ...]:
        """Numbers of the axes that slide."""
        return tuple(i for i, j in enumerate(self.axes) if j.kind not in TURNING)

    @property
    def follows(self) -> tuple[tuple[int, int, float], ...]:
        """Number, leader and ratio of the axes that others move."""
        names = [j.name for j in self.axes]
        return tuple((i, names.index(j.follows), j.ratio) for i, j in enumerate(self.axes) if j.follows)


class KinematicTree:
    """All joints of a description. Raises ConfigError, naming the file, where they are no tree."""

    def __init__(self, joints: Iterable[TreeJoint], links: Iterable[str], path: Path) -> None:
        self.path, self.links = path, list(dict.fromkeys(links))
        self.above: dict[str, TreeJoint] = {}
        self.below: dict[str, list[TreeJoint]] = {}
        names = set[str]()
        for joint in joints:
            if joint.child in self.above:
                twice = f"'{self.above[joint.child].name}' and '{joint.name}'"
                raise ConfigError(f"{path}: link '{joint.child}' hangs on two joints, {twice}; open the closed chain, remove one")
            if joint.name and joint.name in names:
                raise ConfigError(f"{path}: two joints are called '{joint.name}'; rename one")
            names.add(joint.name)
            self.above[joint.child] = joint
            self.below.setdefault(joint.parent, []).append(joint)
        if len(self.above) > MOST_JOINTS:
            raise ConfigError(f"{path}: has {len(self.above)} joints, more than {MOST_JOINTS}; this is no robot")
        for link in self.above:
            self.chain(link)
        self._height = self._heights()

    @property
    def roots(self) -> list[str]:
        return [link for link in self.links if link not in self.above]

    def chain(self, link: str) -> list[TreeJoint]:
        """All joints from the root to a link."""
        out: list[TreeJoint] = []
        while link in self.above:
            out.append(self.above[link])
            link = self.above[link].parent
            if len(out) > len(self.above):
                raise ConfigError(f"{self.path}: its joints run in a circle; correct the file")
        return out[::-1]

    def arm(self, base: str | None, flange: str | None) -> Arm:
        """The arm between two links; the one that is there where they are not named.

        Raises ConfigError where there is none, where several could be meant, and where a joint of it neither turns nor slides.
        """
        for link, role in ((base, "base"), (flange, "flange")):
            if link is not None and link not in self.links:
                raise ConfigError(f"{self.path}: has no link '{link}' for the {role}; its links are {_list(self.links)}")
        remarks: list[str] = []
        tip = flange or self._guessed_flange(base, remarks)
        joints = self.chain(tip)
        if base is not None:
            below = [i for i, joint in enumerate(joints) if joint.parent == base]
            if not below:
                raise ConfigError(f"{self.path}: no joints lead from link '{base}' to link '{tip}'; name others with --base and --flange")
            joints = joints[below[0] :]
        else:
            joints = self._without_what_carries_it(joints, remarks)
        self._check(joints, tip)
        return Arm(tuple(joints), joints[0].parent, tip, tuple(remarks))

    def _check(self, joints: Sequence[TreeJoint], tip: str) -> None:
        for joint in joints:
            if not joint.is_axis and joint.kind != "fixed":
                without = " without limits" if joint.kind == "prismatic" else ""
                raise ConfigError(
                    f"{self.path}: joint '{joint.name}' is {joint.kind}{without}; an arm of joints that turn, or slide between limits, is "
                    "needed, name its --base and --flange"
                )
            if joint.follows and joint.is_axis and not any(j.name == joint.follows and not j.follows for j in joints if j.is_axis):
                raise ConfigError(
                    f"{self.path}: joint '{joint.name}' follows '{joint.follows}', which is no axis between base and flange; name a --base "
                    "and --flange between which all joints are free, or follow one of them"
                )
        if sum(joint.is_axis for joint in joints) < 2:
            raise ConfigError(f"{self.path}: fewer than two moving joints lead to link '{tip}'; name the arm's last link with --flange")

    def _without_what_carries_it(self, joints: list[TreeJoint], remarks: list[str]) -> list[TreeJoint]:
        """Without the joints that hold the arm in the world, and without a vehicle below it."""
        first = next((i for i, joint in enumerate(joints) if joint.is_axis), len(joints))
        carrying = [i for i, joint in enumerate(joints) if not joint.is_axis and joint.kind != "fixed"]
        last = max((i for i in carrying), default=-1)
        axes = sum(joint.is_axis for joint in joints[last + 1 :])
        before = [j for j in joints[: last + 1] if j.is_axis and not _wheel(j)]
        is_vehicle = len(before) <= TURNS_OF_A_VEHICLE and axes >= ARM_ON_A_VEHICLE
        if carrying and ((not before and axes >= ARM_BEFORE_FINGERS) or is_vehicle):
            named = [j.name for i, j in enumerate(joints[: last + 1]) if i in carrying or j in before]
            what = (
                "carries the arm and is none of its axes; it stands"
                if len(named) == 1
                else "carry the arm and are none of its axes; they stand"
            )
            remarks.append(f"{_list(named)} {what} as at zero")
            first = next(i for i in range(last + 1, len(joints)) if joints[i].is_axis)
            turn = joints[first]
            if axes > ARM_BEHIND_A_TURN or (axes == ARM_BEHIND_A_TURN and turn.kind == "continuous"):
                out = f"leave it out with --base {turn.child}"
                remarks.append(f"'{turn.name}' behind what carries the arm counts as axis 1; if a vehicle turns by it, {out}")
        elif carrying and carrying[0] < first:
            first = carrying[0]
        return joints[first:]

    def _guessed_flange(self, base: str | None, remarks: list[str]) -> str:
        grippers = self._grippers()
        end = self._end(base, grippers, remarks)
        left_out = [j.name for j in self._moving_behind(end) if j.name in grippers]
        tip = self._frame_behind(end)
        if left_out:
            remarks.append(f"{_list(left_out)} behind it taken for a gripper's and left out; another last link is named with --flange")
        else:
            remarks += self._jaw(end)
        return tip

    def _jaw(self, end: str) -> list[str]:
        """A sentence about a last joint that may well be a gripper whose names do not say so."""
        turning = [j for j in self.chain(end) if j.kind in TURNING]
        if len(turning) <= ARM_BEFORE_FINGERS or not _opens_as_jaws(last := turning[-1]):
            return []
        return [f"the last joint '{last.name}' opens to one side only, as jaws of a gripper do; if it is one, say --flange {last.parent}"]

    def _end(self, base: str | None, grippers: set[str], remarks: list[str]) -> str:
        """The link behind the last joint of the only arm, or of the one with the usual name of a flange behind it."""
        side = {j.name for j in self.above.values() if j.follows and not self._free_behind(j, grippers)}
        moving = [j for j in self.above.values() if j.kind != "fixed" and j.name not in grippers | side]
        passed = {a.name for j in moving for a in self.chain(j.parent)}
        ends = [j.child for j in moving if j.name not in passed]
        if base is not None:
            ends = [end for end in ends if any(j.parent == base for j in self.chain(end))] or ends
        axes = {end: sum(j.kind in TURNING and not _wheel(j) for j in self.chain(end)) for end in ends}
        if len(ends) == 1:
            return ends[0]
        if len(named := self._named_ends(ends)) == 1 and axes[named[0]] >= 2:
            return named[0]
        order = sorted(ends, key=lambda end: -axes[end])
        most, next_most = [*(axes[end] for end in order[:2]), 0, 0][:2]
        if most >= max(SHORTEST_ARM, 2 * next_most) or (most >= 2 and not next_most):
            remarks.append(
                f"of {len(ends)} chains of joints the longest, of {most} axes, is taken for the arm; others end in "
                f"{_list(order[1:])}, and are named with --flange"
            )
            return order[0]
        if not ends:
            raise ConfigError(f"{self.path}: has no moving joints, so that it is no arm; give the description of an arm")
        raise ConfigError(f"{self.path}: {len(ends)} chains of joints end in {_list(ends)}; name the arm's flange with --flange")

    def _named_ends(self, ends: Sequence[str]) -> list[str]:
        for name in FLANGES:
            if found := [end for end in ends if any(_called(link, name) for link in self._fixed_behind(end))]:
                return found
        return []

    def _frame_behind(self, end: str) -> str:
        """The flange that is fixed to the last link: by its usual name, as the next number, or as the only bare frame."""
        behind = self._fixed_behind(end)
        for name in FLANGES:
            if len(found := [link for link in behind if _called(link, name)]) == 1:
                return found[0]
        children = [j for j in self.below.get(end, ()) if j.kind == "fixed"]
        if (number := _NUMBER.match(end)) is not None:
            following = f"{number[1]}{int(number[2]) + 1}{number[3]}"
            if any(j.child == following for j in children):
                return following
        return children[0].child if len(children) == 1 and children[0].bare else end

    def _fixed_behind(self, link: str) -> list[str]:
        out, stack = [], [link]
        while stack:
            here = stack.pop()
            out.append(here)
            stack += [j.child for j in self.below.get(here, ()) if j.kind == "fixed"]
        return out

    def _moving_behind(self, link: str) -> list[TreeJoint]:
        """The next moving joints behind a link."""
        return [j for here in self._fixed_behind(link) for j in self.below.get(here, ()) if j.kind != "fixed"]

    def _all_behind(self, joint: TreeJoint) -> list[TreeJoint]:
        out, stack = [], [joint]
        while stack:
            out.append(here := stack.pop())
            stack += self._moving_behind(here.child)
        return out

    def _free_behind(self, joint: TreeJoint, grippers: set[str]) -> bool:
        return any(not j.follows and j.name not in grippers for j in self._all_behind(joint))

    def _grippers(self) -> set[str]:
        """Names of the joints of grippers and of all behind them; none where nothing else moves."""
        moving = [j for j in self.above.values() if j.kind != "fixed"]
        named = {j.name for j in moving if _like_a_gripper(j)}
        named |= {j.name for j in moving if self._jaw_of_gripper(j)}
        first = [j for j in moving if j.name in named or j.name in self._fingers(j) or self._beside_one(j, named)]
        found = {behind.name for joint in first for behind in self._all_behind(joint)}
        return found if sum(j.kind in TURNING and j.name not in found for j in moving) >= 2 else set()

    def _jaw_of_gripper(self, joint: TreeJoint) -> bool:
        """Whether the last joint of an arm opens as jaws do, and what it moves is called a gripper."""
        before = sum(j.kind in TURNING for j in self.chain(joint.parent))
        if before < ARM_BEFORE_FINGERS or self._height[joint.child] or not _opens_as_jaws(joint):
            return False
        return any(_GRIPPER.search(link) for link in self._fixed_behind(joint.child))

    def _beside_one(self, joint: TreeJoint, grippers: set[str]) -> bool:
        """Whether a joint branches off where the joints of a gripper do, as the thumb of a hand."""
        before = [j for j in self.chain(joint.parent) if j.kind != "fixed"]
        axes = sum(j.kind in TURNING for j in before)
        return axes >= 2 and any(j.name in grippers for j in self._moving_behind(before[-1].child))

    def _fingers(self, joint: TreeJoint) -> set[str]:
        """The joint and those beside it, where they are fingers by their number and length or a slide at the end of an arm."""
        before = [j for j in self.chain(joint.parent) if j.kind != "fixed"]
        axes = sum(j.kind in TURNING for j in before)
        beside = self._moving_behind(before[-1].child) if before else []
        lengths = [1 + self._height[j.child] for j in beside]
        if axes >= ARM_BEFORE_FINGERS and len(beside) >= 2 and max(lengths) <= LONGEST_FINGER:
            return {j.name for j in beside}
        if axes >= ARM_BEFORE_HAND and len(beside) >= 3 and max(lengths) <= LONGEST_HAND_FINGER:
            return {j.name for j in beside}
        if axes >= ARM_BEFORE_HAND and joint.kind == "prismatic" and not any(j.kind in TURNING for j in self._all_behind(joint)):
            return {joint.name}
        return set()

    def _heights(self) -> dict[str, int]:
        """Per link the largest number of moving joints that follow one another behind it."""
        out: dict[str, int] = {}
        for link in sorted(self.above, key=lambda link: -len(self.chain(link))):
            joint = self.above[link]
            own = out.setdefault(link, 0)
            out[joint.parent] = max(out.get(joint.parent, 0), own + (joint.kind != "fixed"))
        return out


def _like_a_gripper(joint: TreeJoint) -> bool:
    if _FINGER.search(joint.name) or _FINGER.search(joint.child):
        return True
    return _GRIPPER.search(joint.name) is not None and _WRIST.search(joint.name) is None


def _opens_as_jaws(joint: TreeJoint) -> bool:
    """Whether a joint turns from nearly zero to one side only."""
    span, rest = joint.upper - joint.lower, min(abs(joint.upper), abs(joint.lower))
    return joint.kind == "revolute" and bool(0 < span < LIKE_A_JAW[0] and rest < LIKE_A_JAW[1])


def _called(link: str, name: str) -> bool:
    plain = link.lower()
    return plain == name or plain.endswith(("_" + name, "-" + name, "/" + name, ":" + name))


def _wheel(joint: TreeJoint) -> bool:
    return "wheel" in (joint.name + joint.child).lower()


def _list(names: Sequence[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
