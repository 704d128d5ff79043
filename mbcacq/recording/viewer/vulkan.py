"""Whether this computer can draw without a screen, as pictures of the viewer need it."""

from __future__ import annotations

import ctypes.util
import sys
from pathlib import Path

ICD = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")
PACKAGE = "apt-get install mesa-vulkan-drivers"
WITHOUT_VULKAN = f"it needs a Vulkan driver, a software one will do: {PACKAGE}"


def vulkan_drivers() -> list[str]:
    """Names of the installed drivers, on Linux."""
    return sorted(path.name for folder in ICD if Path(folder).is_dir() for path in Path(folder).glob("*.json"))


def has_vulkan() -> bool:
    """False where Linux has no loader or no driver; other systems have their own."""
    return sys.platform != "linux" or bool(ctypes.util.find_library("vulkan") and vulkan_drivers())
