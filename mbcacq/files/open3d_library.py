"""Open3D, imported by what needs it when it is needed: the import takes half a second."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


@cache
def open3d() -> Any:
    """The package, silent but for errors.

    It links libusb. A bare Debian or Ubuntu lacks that library, so the one of the package libusb-package is loaded first.
    """
    try:
        import open3d as library
    except ImportError:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
        import open3d as library
    library.utility.set_verbosity_level(library.utility.VerbosityLevel.Error)
    return library
