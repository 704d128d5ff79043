"""Two small pictures as SVG: bars of a ladder of models, and amplitudes by order for each joint."""

from __future__ import annotations

from html import escape

COLOURS = ("#1f6fb2", "#e08a1e")


def bars(rows: list[dict], series: list[str], title: str) -> str:
    """Horizontal bars, one group a row; rows: {"model": text, SERIES: number}."""
    left, width, bar = 300, 420, 11
    group = bar * len(series) + 8
    top = max(row[s] for row in rows for s in series)
    out = [text(10, 20, title, 14)]
    for j, name in enumerate(series):
        out += [rect(left + 130 * j, 30, 10, 10, COLOURS[j]), text(left + 14 + 130 * j, 39, f"left out by {name}")]
    y = 52
    for row in rows:
        out.append(text(left - 6, y + group / 2, row["model"], anchor="end"))
        for j, name in enumerate(series):
            size = width * row[name] / top
            out += [rect(left, y + bar * j, size, bar - 1, COLOURS[j]), text(left + size + 4, y + bar * j + 9, f"{row[name]:.3f}", 10)]
        y += group
    return page(left + width + 60, y + 10, out)


def spectrum(lines: dict[str, list[list[float]]], title: str) -> str:
    """One strip a joint: amplitude (arc seconds) over order; grey where below three standard deviations."""
    left, width, strip = 60, 640, 78
    highest = max(line[0] for joint in lines.values() for line in joint)
    out, y = [text(10, 20, title, 14)], 34
    for joint, values in lines.items():
        clear = [v for v in values if v[1] > 3 * v[2]]
        top = max((v[1] for v in clear), default=1.0)
        floor = y + strip - 14
        out += [text(10, y + strip / 2, joint, 13), text(left - 4, y + 10, f'{top:.0f}"', 10, "end")]
        out.append(rect(left, floor, width, 1, "#888888"))
        for order, amplitude, std in values:
            size = (strip - 20) * min(amplitude / top, 1.0)
            colour = COLOURS[0] if amplitude > 3 * std else "#cccccc"
            out.append(rect(left + width * order / (highest + 1), floor - size, max(width / highest * 0.7, 1.5), size, colour))
        y += strip
    step = 20 if highest > 60 else 4
    out += [text(left + width * k / (highest + 1), y + 2, str(k), 10, "middle") for k in range(step, highest + 1, step)]
    out.append(text(left + width / 2, y + 18, "periods per turn", 11, "middle"))
    return page(left + width + 20, y + 26, out)


def page(width: float, height: float, parts: list[str]) -> str:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" font-family="sans-serif">'
    return "\n".join([head, rect(0, 0, width, height, "#ffffff"), *parts, "</svg>", ""])


def rect(x: float, y: float, width: float, height: float, fill: str) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{fill}"/>'


def text(x: float, y: float, words: str, size: int = 11, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" text-anchor="{anchor}" fill="#222222">{escape(words)}</text>'
