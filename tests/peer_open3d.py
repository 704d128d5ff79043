"""Open3D, whose readers and writers of clouds are held against ours; the program itself does without it."""

from __future__ import annotations

from types import ModuleType


def open3d() -> ModuleType:
    """Open3D, also on a machine without a system libusb: its shared library is preloaded from the libusb-package wheel."""
    try:
        import open3d
    except ImportError:
        import ctypes

        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
        import open3d
    return open3d
