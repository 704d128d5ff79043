"""The pages: which address shows what. Everything but the stop only reads."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from flask import Flask, Response, abort, jsonify, redirect, render_template, request, send_file, stream_template, url_for
from jinja2 import StrictUndefined
from markupsafe import Markup
from werkzeug.exceptions import HTTPException

from mbcacq.errors import MbcacqError
from mbcacq.recording.run_folder.register import RunKind
from mbcacq.recording.run_folder.stop import stop_run
from mbcacq.report.charts.spacing_svg import spacing_picture
from mbcacq.report.content import Content
from mbcacq.report.page import SCENE_SCRIPT, stages_of
from mbcacq.serve.guard import REPORT, Guard
from mbcacq.serve.history_svg import history_picture
from mbcacq.serve.live import log_of, progress_of
from mbcacq.serve.overview import Overviews
from mbcacq.serve.plan_scene import PlanScenes
from mbcacq.serve.run_choice import RunChoice, chosen
from mbcacq.serve.run_list import FLEET_PAGE, ListedFolder, RunList, find_runs
from mbcacq.serve.run_row import RunRow
from mbcacq.serve.side_by_side import MOST_RUNS, changes, figures_of

REPORT_PAGE = "report.html"
DOWNLOADS = ("report.pdf", "result.json", "diagnosis.json", "plan.yaml")
MOST_BYTES = 256 << 20  # of a file that is handed out


@dataclass
class Pages:
    """Answers of the application. root: the folder that is served."""

    root: Path
    guard: Guard
    overviews: Overviews = field(default_factory=Overviews)
    scenes: PlanScenes = field(default_factory=PlanScenes)

    def listed(self) -> Response:
        """The list begins to arrive before the runs of its page are read."""
        found = find_runs(self.root)
        choice = RunChoice.asked(request.args.get)
        runs = chosen(list(found.runs.values()), choice)
        running = [row for row in map(self.row, runs.locked) if row.progress.state in ("running", "uncertain")]
        rest = [run for run in runs.shown if all(run.key != row.found.key for row in running)]
        body = stream_template(
            "list.html.j2",
            running=running,
            rows=map(self.row, rest),
            choice=choice,
            runs=runs,
            kinds=[kind.value for kind in RunKind],
            today=f"{datetime.now():%Y-%m-%d}",
            history=lambda: Markup(history_picture([self.row(run) for run in reversed(runs.shown)])) if choice.cell else "",
            fleets=list(found.fleets.values()),
            left_out=found.left_out,
            token=self.guard.token,
            most=MOST_RUNS,
        )
        return Response(body, mimetype="text/html")

    def run(self, key: str) -> str:
        row = self.row(_one(find_runs(self.root), key))
        picture = _picture(row.overview.content)
        return render_template(
            "run.html.j2", row=row, log=log_of(row.found.folder), picture=picture, token=self.guard.token, asked="asked" in request.args
        )

    def compare(self) -> str:
        runs = find_runs(self.root)
        keys = list(dict.fromkeys(request.args.getlist("run")))
        if not 2 <= len(keys) <= MOST_RUNS:
            abort(400, f"Choose two to {MOST_RUNS} runs of the list, then 'Side by side'.")
        rows = sorted((self.row(_one(runs, key)) for key in keys), key=lambda row: row.overview.started)
        return render_template("compare.html.j2", rows=rows, figures=figures_of(rows), changes=changes(rows))

    def fleet(self, key: str) -> str:
        found = _one(find_runs(self.root), key, fleet=True)
        return render_template("fleet.html.j2", found=found, drawn=_is_plain_file(found.folder / FLEET_PAGE))

    def live(self, key: str) -> Response:
        folder = _one(find_runs(self.root), key).folder
        return jsonify(progress_of(folder).to_dict() | {"log": log_of(folder)})

    def scene(self, key: str) -> Response:
        folder = _one(find_runs(self.root), key).folder
        try:
            return Response(self.scenes.of(folder), mimetype="application/json")
        except MbcacqError as error:
            return jsonify({"error": str(error)})

    def stop(self, key: str) -> Any:
        self.guard.refuse_without_token()
        stop_run(_one(find_runs(self.root), key).folder)
        return redirect(url_for("run", key=key, asked=1), code=303)

    def report(self, key: str) -> Response:
        return _foreign_page(_one(find_runs(self.root), key).folder / REPORT_PAGE)

    def fleet_page(self, key: str) -> Response:
        return _foreign_page(_one(find_runs(self.root), key, fleet=True).folder / FLEET_PAGE)

    def download(self, key: str, name: str) -> Response:
        folder = _one(find_runs(self.root), key).folder
        if name not in DOWNLOADS:
            abort(404, "There is no such file.")
        return send_file(_plain_file(folder / name), as_attachment=True, download_name=name)

    def row(self, found: ListedFolder) -> RunRow:
        files = tuple(name for name in (REPORT_PAGE, *DOWNLOADS) if _is_plain_file(found.folder / name))
        return RunRow(found, self.overviews.of(found.folder), progress_of(found.folder), files)


def create_application(root: Path, port: int) -> Flask:
    """The application that shows the runs below a folder at 127.0.0.1:port."""
    app = Flask(__name__)
    app.jinja_options = {"autoescape": True, "undefined": StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
    app.jinja_env.globals["root"] = str(root.absolute()).encode("utf-8", "replace").decode()
    app.jinja_env.filters["minutes"] = minutes
    guard = Guard(port)
    guard.install(app)
    pages = Pages(root, guard)
    for rule, answer, methods in (
        ("/", pages.listed, ["GET"]),
        ("/run/<key>", pages.run, ["GET"]),
        ("/compare", pages.compare, ["GET"]),
        ("/fleet/<key>", pages.fleet, ["GET"]),
        ("/live/<key>", pages.live, ["GET"]),
        ("/scene/<key>", pages.scene, ["GET"]),
        ("/stop/<key>", pages.stop, ["POST"]),
        ("/report/<key>", pages.report, ["GET"]),
        ("/fleet-page/<key>", pages.fleet_page, ["GET"]),
        ("/download/<key>/<name>", pages.download, ["GET"]),
    ):
        app.add_url_rule(rule, answer.__name__, answer, methods=methods)
    app.add_url_rule("/scene.js", "scene_script", lambda: send_file(SCENE_SCRIPT, mimetype="text/javascript"))
    app.register_error_handler(HTTPException, refused)
    app.register_error_handler(MbcacqError, lambda error: (render_template("error.html.j2", what=str(error)), 409))
    return app


def refused(error: HTTPException) -> tuple[str, int]:
    """A page with the sentence of what was refused or not found."""
    return render_template("error.html.j2", what=error.description or error.name), error.code or 500


def minutes(seconds: float) -> str:
    """A time to go in words."""
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _one(found: RunList, key: str, fleet: bool = False) -> ListedFolder:
    one = (found.fleets if fleet else found.runs).get(key)
    if one is None:
        abort(404, "There is no such run or fleet in the folder that is served; it may have been moved or removed.")
    return one


def _picture(content: Content | None) -> str:
    """The bar before and after calibration, and after effects where the run has them."""
    if content is None or content.spacing is None:
        return ""
    if content.earlier is not None:
        return Markup(stages_of(content.earlier, content.spacing))
    return Markup(spacing_picture(content.spacing))


def _is_plain_file(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def _plain_file(path: Path) -> Path:
    """The path of a file that can be handed out: no link to elsewhere, and not without bounds."""
    if not _is_plain_file(path):
        abort(404, f"There is no {path.name} yet.")
    if path.stat().st_size > MOST_BYTES:
        abort(404, f"{path.name} is larger than {MOST_BYTES >> 20} MB.")
    return path.absolute()


def _foreign_page(path: Path) -> Response:
    """A report with its inline scripts, in an origin of its own."""
    answer = send_file(_plain_file(path), mimetype="text/html")
    answer.headers["Content-Security-Policy"] = REPORT
    return answer
