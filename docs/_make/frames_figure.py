"""Draws docs/explanation/frames.svg: the frames of a cell and the transforms between them.

``python docs/_make/frames_figure.py`` from the root of the checkout.
"""

from __future__ import annotations

from pathlib import Path

TARGET = Path(__file__).resolve().parents[1] / "explanation" / "frames.svg"
X, Y, Z = "#D55E00", "#009E73", "#0072B2"  # told apart by colour-blind eyes
GREY, INK = "#9aa0a6", "#333333"


def axes(x: float, y: float, name: str, down: bool = False, label: tuple[float, float] = (-14, 24)) -> str:
    """A frame at (x, y): x to the right, y into the page's depth, z up or down."""
    s = -1 if down else 1
    tips = ((44, 0, X, "x"), (24, -20 * s, Y, "y"), (0, -46 * s, Z, "z"))
    out = [
        f'<line x1="{x}" y1="{y}" x2="{x + u}" y2="{y + v}" stroke="{c}" stroke-width="3" marker-end="url(#{t})"/>'
        f'<text x="{x + 1.22 * u - 3}" y="{y + 1.22 * v + 5}" fill="{c}" font-size="13">{t}</text>'
        for u, v, c, t in tips
    ]
    return "".join(out) + f'<text x="{x + label[0]}" y="{y + label[1]}" font-weight="bold" font-size="15" fill="{INK}">{name}</text>'


def arrow(a: tuple[float, float], b: tuple[float, float], bend: tuple[float, float], text: str, at: tuple[float, float]) -> str:
    """A transform: a bent, dashed arrow with its name."""
    return (
        f'<path d="M{a[0]},{a[1]} Q{bend[0]},{bend[1]} {b[0]},{b[1]}" fill="none" stroke="{INK}" stroke-width="1.6" '
        f'stroke-dasharray="6 4" marker-end="url(#ink)"/><text x="{at[0]}" y="{at[1]}" font-size="15" fill="{INK}">{text}</text>'
    )


def arm(points: list[tuple[float, float]]) -> str:
    line = " ".join(f"{x},{y}" for x, y in points)
    joints = "".join(f'<circle cx="{x}" cy="{y}" r="11" fill="white" stroke="{GREY}" stroke-width="5"/>' for x, y in points[1:-1])
    style = f'fill="none" stroke="{GREY}" stroke-width="16" stroke-linejoin="round" stroke-linecap="round"'
    return f'<polyline points="{line}" {style}/>{joints}'


def marker(name: str, colour: str) -> str:
    return (
        f'<marker id="{name}" viewBox="0 0 8 8" refX="6" refY="4" markerWidth="5" markerHeight="5" orient="auto">'
        f'<path d="M0,0 L8,4 L0,8 z" fill="{colour}"/></marker>'
    )


def drawing() -> str:
    balls = "".join(
        f'<circle cx="{x}" cy="{y}" r="8" fill="#cfd3d7" stroke="{INK}"/>'
        for x, y in ((548, 402), (580, 388), (612, 404), (640, 392), (566, 420), (628, 420))
    )
    return (
        "\n".join(
            [
                '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 80 840 430" font-family="sans-serif" role="img" '
                'aria-label="Frames of the cell: base, flange, scanner, station, and the transforms between them">',
                '<rect y="80" width="840" height="430" fill="white"/>',
                "<defs>" + "".join(marker(*m) for m in (("x", X), ("y", Y), ("z", Z), ("ink", INK))) + "</defs>",
                f'<rect x="60" y="452" width="120" height="22" fill="{GREY}"/>',
                arm([(120, 452), (120, 360), (190, 190), (390, 130), (520, 130), (580, 150)]),
                f'<rect x="548" y="156" width="72" height="42" rx="5" fill="#5f6368"/>'
                f'<text x="490" y="190" font-size="13" fill="{INK}">housing</text>',
                f'<path d="M584,198 L520,368 L650,368 Z" fill="{Z}" fill-opacity="0.08" stroke="{Z}" stroke-opacity="0.35"/>',
                f'<path d="M594,430 L594,474 M560,474 L628,474" stroke="{GREY}" stroke-width="6"/>',
                balls,
                f'<text x="652" y="426" font-size="13" fill="{INK}">artefact</text>',
                axes(120, 452, "base", label=(-48, 40)),
                axes(580, 150, "flange", down=True, label=(14, -12)),
                axes(584, 330, "scanner", label=(-84, -14)),
                axes(594, 412, "station", label=(-80, 48)),
                arrow((132, 440), (568, 140), (310, 300), "T_base_flange(q)", (196, 270)),
                arrow((626, 152), (612, 316), (720, 236), "T_flange_scanner", (674, 240)),
                arrow((150, 462), (578, 424), (370, 500), "T_base_station", (310, 500)),
                "</svg>",
            ]
        )
        + "\n"
    )


if __name__ == "__main__":
    TARGET.write_text(drawing(), encoding="utf-8")
    print(TARGET)
