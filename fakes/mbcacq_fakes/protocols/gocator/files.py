"""The sensor's files: the live configuration, merged on writing, and the jobs it can be loaded from."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from importlib.resources import files
from xml.etree import ElementTree

from defusedxml import ElementTree as SafeTree

from mbcacq.devices import parse_xml
from mbcacq_fakes.protocols.gocator.replies import BAD_PARAMETER, EXISTS, FORMAT, NOT_FOUND, CommandRefused

CAPACITY = 256 * 2**20
EXPOSURE = "Setup/Devices/Device[@role='0']/Exposure"  # us
LIVE_CFG, LIVE_TFM, LIVE_JOB, LIVE_LOG = "_live.cfg", "_live.tfm", "_live.job", "_live.log"


class Files:
    """Thread-safe. A job is the configuration saved under a name."""

    def __init__(self, jobs: tuple[str, ...], settings: Mapping[str, float]) -> None:
        """settings: values by path that the served configuration and all jobs start with."""
        self._lock = threading.RLock()
        jobs = tuple(dict.fromkeys(name if name.endswith(".job") else name + ".job" for name in jobs))
        package = files("mbcacq_fakes.protocols.gocator")
        self._tree = SafeTree.fromstring(package.joinpath("live.cfg").read_bytes())
        for path, value in settings.items():
            _assign(self._node(path), f"{value:g}")
        first = _serialise(self._tree)
        self._stored = {
            LIVE_CFG: first,
            LIVE_TFM: package.joinpath("live.tfm").read_bytes().strip(),
            LIVE_LOG: b"fake sensor started\r\n",
            **dict.fromkeys(jobs, first),
        }
        self.loaded_job, self.default_job, self.modified = (jobs[0], jobs[0], False) if jobs else ("", "", False)

    def names(self, extension: str = "") -> list[str]:
        with self._lock:
            stored = sorted(name for name in self._stored if not name.startswith("_live"))
        return [name for name in stored if not extension or name.endswith("." + extension.lstrip("."))]

    def read(self, name: str) -> bytes:
        with self._lock:
            found = self._stored.get(LIVE_CFG if name == LIVE_JOB else name)
        if found is None:
            raise CommandRefused(NOT_FOUND)
        return found

    def write(self, name: str, data: bytes) -> None:
        if not name or sum(map(len, self._stored.values())) + len(data) > CAPACITY:
            raise CommandRefused(BAD_PARAMETER)
        with self._lock:
            if name == LIVE_CFG:
                self._merge(data)
            else:
                self._stored[name] = data

    def copy(self, source: str, target: str) -> None:
        """Loads a job if the target is the live one, else copies (saves)."""
        if not target:
            raise CommandRefused(BAD_PARAMETER)
        with self._lock:
            data = self.read(source)
            if target == LIVE_JOB:
                self._load(data)
                self.loaded_job = source
            else:
                self._stored[target] = data
                if source == LIVE_JOB:
                    self.loaded_job = target
            self.modified = False

    def delete(self, name: str) -> None:
        with self._lock:
            if name.startswith("_live"):
                raise CommandRefused(EXISTS)
            if self._stored.pop(name, None) is None:
                raise CommandRefused(NOT_FOUND)

    def used(self) -> int:
        with self._lock:
            return sum(map(len, self._stored.values()))

    def set_default(self, name: str) -> None:
        if name and name not in self._stored:
            raise CommandRefused(NOT_FOUND)
        self.default_job = name

    def number(self, path: str) -> float:
        """A setting of the live configuration, such as 'Setup/Devices/Device/Exposure'."""
        with self._lock:
            return float(self._tree.findtext(path, "0") or 0)

    def set_number(self, path: str, value: float) -> None:
        with self._lock:
            _assign(self._node(path), f"{value:g}")
            self._stored[LIVE_CFG] = _serialise(self._tree)

    def set_transform(self, terms: Mapping[str, float]) -> None:
        """Terms of the main sensor's transformation (X, Y, Z mm, XAngle.. deg); those not named become 0."""
        with self._lock:
            tree = SafeTree.fromstring(self._stored[LIVE_TFM])
            for node in tree.iterfind("Devices/Device/*"):
                node.text = f"{terms.get(node.tag, 0):g}"
            self._stored[LIVE_TFM] = _serialise(tree)

    def _node(self, path: str) -> ElementTree.Element:
        node = self._tree.find(path)
        if node is None:
            raise KeyError(path)
        return node

    def _load(self, data: bytes) -> None:
        self._tree = _parse(data)
        self._stored[LIVE_CFG] = data

    def _merge(self, data: bytes) -> None:
        """Clients upload values only, without limits, options and effective values; those of the sensor's own file stay."""
        _merge(self._tree, _parse(data))
        self._stored[LIVE_CFG] = _serialise(self._tree)
        self.modified = True


def _parse(data: bytes) -> ElementTree.Element:
    try:
        return parse_xml(data, "Configuration")
    except ValueError:
        raise CommandRefused(FORMAT) from None


def _serialise(tree: ElementTree.Element) -> bytes:
    return ElementTree.tostring(tree, encoding="UTF-8", xml_declaration=True)


def _merge(own: ElementTree.Element, sent: ElementTree.Element) -> None:
    """Leaves found in both take the sent text. Same-named brothers are matched by role, index or id, else by order."""
    if not len(own):
        if not len(sent) and sent.text is not None:
            _assign(own, sent.text.strip())
        return
    used: set[int] = set()
    for child in sent:
        match = next((o for i, o in enumerate(own) if i not in used and o.tag == child.tag and _same(o, child)), None)
        if match is not None:
            used.add(list(own).index(match))
            _merge(match, child)


def _same(own: ElementTree.Element, sent: ElementTree.Element) -> bool:
    return all(sent.get(key) in (None, own.get(key)) for key in ("role", "index", "id"))


def _assign(node: ElementTree.Element, text: str) -> None:
    node.text = text
    if "value" in node.attrib:
        node.set("value", text)
