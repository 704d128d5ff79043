"""The server of the pages: on this computer's loopback address, and nowhere else."""

from __future__ import annotations

import gc
import socket
import threading
from collections.abc import Callable
from pathlib import Path

from mbcacq.errors import ConfigError, SystemRefused

MISSING = "the page needs the libraries Flask and Waitress: pip install 'mbcacq[serve]'"
LOOPBACK, PORT = "127.0.0.1", 8765
THREADS = 8
BUFFER = 1 << 20  # bytes of an answer that wait in memory


def refuse_other_address(host: str) -> None:
    """Raises ConfigError for any address but 127.0.0.1: who reaches the page can stop a run, and read every result."""
    if host not in (LOOPBACK, "localhost"):
        raise ConfigError(
            f"the page is served at {LOOPBACK} only, not at {host}; from another computer reach it through a tunnel: "
            f"ssh -L {PORT}:{LOOPBACK}:{PORT} THIS-COMPUTER, then open http://{LOOPBACK}:{PORT}/ there"
        )


def serve(root: Path, port: int = PORT, began: Callable[[str], None] = lambda address: None) -> None:
    """Serve the runs below a folder until the caller's thread is interrupted.

    Parameters
    ----------
    root
        The folder of the runs.
    port
        0 takes a free one.
    began
        Gets the address once it can be opened.

    Raises
    ------
    ConfigError
        If Flask or Waitress is not installed, or the folder cannot be read.
    SystemRefused
        If the port is taken or refused.
    """
    try:
        import flask  # noqa: F401  (asked for before a port is opened)
        from waitress.server import create_server
    except ImportError as error:
        raise ConfigError(f"{MISSING} ({error})") from None
    from mbcacq.serve.application import create_application
    from mbcacq.serve.run_list import find_runs

    find_runs(root)  # a wrong folder is said before a port that is taken

    with _listening(port) as listener:
        port = listener.getsockname()[1]
        server = create_server(
            create_application(root, port),
            sockets=[listener],
            threads=THREADS,
            ident="",
            max_request_body_size=1 << 16,
            outbuf_overflow=BUFFER,
        )
        worker = threading.Thread(target=server.run, name="mbcacq serve", daemon=True)
        worker.start()
        gc.freeze()  # else collections walk the libraries too, 0.1 s of a page each
        began(f"http://{LOOPBACK}:{port}/")
        try:
            while worker.is_alive():
                worker.join(0.5)
        finally:
            server.close()


def _listening(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((LOOPBACK, port))
        listener.listen(64)
    except OSError as error:
        listener.close()
        raise SystemRefused(
            f"port {port} of {LOOPBACK} cannot be opened: {error.strerror}; give another by --port, or 0 for any"
        ) from error
    return listener
