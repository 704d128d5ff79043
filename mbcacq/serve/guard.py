"""What keeps the page on this computer: who may ask, what a page may load, and who may stop a run."""

from __future__ import annotations

import hmac
import secrets

from flask import Flask, Response, abort, request

HOSTS = ("127.0.0.1", "localhost")
MOST_BYTES = 4096  # of a request's body: a form with a token

# Our own pages: their files come from here and nothing else; no inline script or style, so that no name can become one.
OWN = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; frame-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
# Reports carry inline scripts and styles. They get an origin of their own, without network: they cannot ask this server for anything.
REPORT = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # without any, a browser would not say where the form of the stop comes from
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Guard:
    """Checks every request to an application, and sets the headers of every answer.

    Parameters
    ----------
    port
        Where the server listens: requests must name it as their host.

    Attributes
    ----------
    token
        Drawn anew at each start; only the pages of this server hold it, and whoever stops a run must send it.
    """

    def __init__(self, port: int) -> None:
        self.token = secrets.token_urlsafe(32)
        self._hosts = {f"{host}:{port}" for host in HOSTS} | (set(HOSTS) if port == 80 else set())

    def install(self, app: Flask) -> None:
        app.config["MAX_CONTENT_LENGTH"] = MOST_BYTES
        app.before_request(self.refuse_foreign)
        app.after_request(self.headers)

    def refuse_foreign(self) -> None:
        """A page of another site whose name was made to lead here asks with its own name as host. A form of another site states where it
        comes from."""
        if request.headers.get("Host", "").lower() not in self._hosts:
            abort(403, "This page is for a browser on this computer, at 127.0.0.1 or localhost.")
        origin = request.headers.get("Origin")
        if request.method == "POST" and origin is not None and origin not in {f"http://{host}" for host in self._hosts}:
            abort(403, "This request comes from another page.")

    def refuse_without_token(self) -> None:
        given = request.form.get("token", "")
        if not hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode()):
            abort(403, "The page is not from this start of mbcacq serve: load it again, then stop the run.")

    @staticmethod
    def headers(answer: Response) -> Response:
        answer.headers.setdefault("Content-Security-Policy", OWN)
        for name, value in HEADERS.items():
            answer.headers.setdefault(name, value)
        return answer
