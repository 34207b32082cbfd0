"""The drawings of physics.md: `python docs/drawings.py` writes contact.svg, bearing.svg and gap.svg beside itself."""

from math import cos, pi, sin
from pathlib import Path

BLUE, RED, GREY, INK, SLIP = "#bcd7ee", "#f4cbb8", "#dddddd", "#222222", "#c1121f"


class Drawing:
    """An SVG in the making; y points down, angles go anticlockwise as in a book."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
            f'height="{height}" font-family="Helvetica, Arial, sans-serif" font-size="14" fill="{INK}">',
            f"<title>{title}</title>",
            '<defs><marker id="tip" viewBox="0 0 10 10" refX="7" refY="5" markerWidth="7" markerHeight="7" '
            'orient="auto-start-reverse"><path d="M0 0 L10 5 L0 10 z" fill="context-stroke"/></marker></defs>',
            f'<rect width="{width}" height="{height}" rx="6" fill="white"/>',
        ]

    def line(
        self, *points: tuple[float, float], colour: str = INK, width: float = 2, tip: bool = False, more: str = ""
    ):
        path = " L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        end = ' marker-end="url(#tip)"' if tip else ""
        self.parts.append(f'<path d="M{path}" stroke="{colour}" stroke-width="{width}" fill="none"{end} {more}/>')

    def text(self, x: float, y: float, words: str, anchor: str = "middle", more: str = "") -> None:
        self.parts.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{words}</text>')

    def disc(self, x: float, y: float, radius: float, spin: float, colour: str) -> None:
        """With an arrow in the sense of its spin, its length in proportion; a dot for a disc at rest."""
        self.parts.append(f'<circle cx="{x}" cy="{y}" r="{radius}" fill="{colour}" stroke="{INK}" stroke-width="1.2"/>')
        if not spin:
            self.parts.append(f'<circle cx="{x}" cy="{y}" r="2.5" fill="{INK}"/>')
            return
        start, turn, arm = pi / 2 - 1.1 * abs(spin), 2.2 * abs(spin), 0.62 * radius
        angles = [start + turn * n / 24 for n in range(25)]
        points = [(x + arm * cos(angle), y - arm * sin(angle)) for angle in (angles if spin > 0 else angles[::-1])]
        self.line(*points, width=1.8 if radius > 40 else 1.2, tip=True)

    def write(self, name: str) -> None:
        Path(__file__).with_name(name).write_text("\n".join([*self.parts, "</svg>\n"]), encoding="utf-8")


def contact() -> None:
    """Opposite spins roll on each other, equal ones slip."""
    drawing = Drawing(720, 270, "Two discs that roll on each other, and two that slip")
    for middle, spins, title in ((180, (1, -1), "opposite spins: they roll"), (540, (1, 1), "equal spins: they slip")):
        drawing.text(middle, 28, title, more='font-weight="bold"')
        for side, spin in zip((-1, 1), spins, strict=True):
            drawing.disc(middle + 75 * side, 130, 75, spin, BLUE if spin > 0 else RED)
            drawing.text(middle + 75 * side, 136, f"ω{'₁' if side < 0 else '₂'}")
            speed = 42 * spin * -side  # of the surface at the contact, upwards
            x = middle + 9 * side
            drawing.line(
                (x, 130 + speed / 2), (x, 130 - speed / 2), colour=SLIP if spins[0] == spins[1] else INK, tip=True
            )
    drawing.text(180, 234, "both surfaces move alike at the contact")
    drawing.text(180, 254, "slip 0: no friction is paid")
    drawing.text(540, 234, "the surfaces slide past each other")
    drawing.text(540, 254, "slip v = R |ω₁ + ω₂|: dissipates μ Fₙ v")
    drawing.write("contact.svg")


CUT = (3, 3, 2, 2, 3, 3)  # discs of each column that turn with the bottom
RADIUS, LEFT, FLOOR = 27, 60, 392


def bearing() -> None:
    """Spins alternate, staggered spins do not: two bearing states, the jump and a cut between them."""
    drawing = Drawing(760, 450, "Spins, staggered spins, jump and cut of a frustrated bearing")
    drawing.text(LEFT + 5 * RADIUS, 28, "spins ω", more='font-weight="bold"')
    for column, below in enumerate(CUT):
        for row in range(6):
            x, y = LEFT + 2 * RADIUS * column, FLOOR - 2 * RADIUS * row
            spin = 0 if row < below else (-1) ** (column + row)
            drawing.disc(x, y, RADIUS, spin, GREY if row < below else BLUE if spin > 0 else RED)
    cut = [(LEFT - RADIUS, FLOOR - RADIUS * (2 * CUT[0] - 1))]
    for column, below in enumerate(CUT):
        height = FLOOR - RADIUS * (2 * below - 1)
        cut += [(LEFT + RADIUS * (2 * column - 1), height), (LEFT + RADIUS * (2 * column + 1), height)]
    drawing.line(*cut, colour=SLIP, width=4)
    right = LEFT + 11 * RADIUS + 8
    for y, words in ((FLOOR - 10 * RADIUS, "driven"), (FLOOR, "driven")):
        drawing.text(right, y + 5, words, anchor="start", more='font-style="italic"')
    drawing.text(right, FLOOR - 5 * RADIUS + 5, "cut: here", anchor="start", more=f'fill="{SLIP}"')
    drawing.text(right, FLOOR - 5 * RADIUS + 23, "contacts slip", anchor="start", more=f'fill="{SLIP}"')
    drawing.text(LEFT + 5 * RADIUS, 440, "within each part contacts are slipless: a bearing state")
    profile(drawing, 510)
    drawing.write("bearing.svg")


def profile(drawing: Drawing, left: float) -> None:
    """Staggered spin against height: a step for friction, a slope for viscous contacts."""
    top, right = FLOOR - 10 * RADIUS, left + 150
    drawing.text(left + 75, 28, "staggered spins Ω = ±ω", more='font-weight="bold"')
    drawing.line((left, FLOOR + 16), (left, top - 30), tip=True, width=1.4)
    drawing.line((left, FLOOR + 16), (right + 45, FLOOR + 16), tip=True, width=1.4)
    drawing.text(left, top - 38, "height", more='font-size="13"')
    drawing.text(right + 52, FLOOR + 21, "Ω", anchor="start")
    step = FLOOR - 5 * RADIUS
    drawing.line((left, FLOOR), (left, step), (right, step), (right, top), colour=INK, width=3)
    drawing.line((left, FLOOR), (right, top), colour="#3a7d44", width=3, more='stroke-dasharray="7 5"')
    drawing.text(right + 10, step - 44, "friction", anchor="start")
    drawing.text(left + 60, step + 62, "viscous", anchor="start", more='fill="#3a7d44"')
    drawing.line((left + 4, top - 14), (right - 2, top - 14), colour=SLIP, tip=True, more='marker-start="url(#tip)"')
    drawing.text(left + 75, top - 22, "jump", more=f'fill="{SLIP}"')
    drawing.text(left, FLOOR + 34, "Ω_B")
    drawing.text(right, FLOOR + 34, "Ω_T")


def gap() -> None:
    """The least power lies between two numbers that are known."""
    drawing = Drawing(720, 170, "The proven lower bound, the least power and the power of the answer")
    drawing.line((40, 90), (680, 90), tip=True, width=1.4)
    drawing.text(676, 112, "power")
    for x, above, below, colour in (
        (190, "lower bound", "proven: nothing is below", INK),
        (330, "least power P_min", "not known", "#888888"),
        (500, "power of the answer", "its spins exist", INK),
    ):
        drawing.line((x, 78), (x, 102), width=3, colour=colour)
        drawing.text(x, 66, above, more=f'fill="{colour}"')
        drawing.text(x, 122, below, more=f'font-size="12" fill="{colour}"')
    drawing.line((194, 34), (496, 34), colour=SLIP, tip=True, more='marker-start="url(#tip)"')
    drawing.text(345, 26, "gap", more=f'fill="{SLIP}"')
    drawing.text(345, 152, "gap = (power − lower bound) / power, so the answer is at most this far from the minimum")
    drawing.write("gap.svg")


if __name__ == "__main__":
    contact()
    bearing()
    gap()
