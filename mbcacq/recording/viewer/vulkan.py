"""Whether this computer can draw without a screen, as pictures of the viewer need it."""

from __future__ import annotations

import ctypes.util
import os
import sys
from pathlib import Path

ICD = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")
PACKAGE = "apt-get install mesa-vulkan-drivers"
WITHOUT_VULKAN = f"it needs a Vulkan driver, a software one will do: {PACKAGE}; VK_ICD_FILENAMES, where set, must name its file"


def vulkan_drivers() -> list[str]:
    """Names of the drivers that the Vulkan loader would take on Linux: those that its variable names, if set, else the installed ones."""
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    if named:
        return sorted(Path(one).name for one in named.split(os.pathsep) if Path(one).exists())
    return sorted(path.name for folder in ICD for path in Path(folder).glob("*.json"))


def has_vulkan() -> bool:
    """False where Linux has no loader or no driver; other systems have their own."""
    return sys.platform != "linux" or bool(ctypes.util.find_library("vulkan") and vulkan_drivers())
