"""Pictures of a run of several populations: scores era by era, and the champions of all eras against each other.

The second is the CIAO plot (current individual against ancestral opponents) of D. Cliff and G. F. Miller, "Tracking the
Red Queen" (1995), as a heat map: a run that only goes round in circles shows as stripes along the diagonal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from nmes.evolution.champions import Champion
from nmes.evolution.history import Origin
from nmes.objective.means import mean, quartiles
from nmes.view.chart import LEFT, SERIES, TOP, WIDTH, Chart, Picture, between, number, short, text

__all__ = ["ancestors_map", "era_curves"]

_LEGEND = 190  # pixels
_LINE = 18  # of a legend, pixels
_KEY = 96  # pixels, for the scale of colours
_SIDE = 56  # of a field, pixels, at most
_LOW, _MIDDLE, _HIGH = (194, 84, 80), (232, 234, 237), (48, 112, 179)  # of colours, from the lowest score on
_FEWEST = 2  # scores of an era, so that it has quartiles


def era_curves(rows: Sequence[Origin], halls: Mapping[str, Sequence[Champion]], era: int, what: str) -> Picture:
    """Returns the scores of each population era by era: median, quartiles, and the champion.

    Args:
        rows: The candidates, some of which have a score.
        halls: The champions of each population.
        era: How many candidates of each population an era has.
        what: What a score is, for its axis.
    """
    length = era * len(halls)
    scores: dict[tuple[str, int], list[float]] = {}
    for row in rows:
        if row.score is not None:
            scores.setdefault((row.group, row.index // length), []).append(row.score)
    bands = {role: _bands(role, scores) for role in halls}
    best = {role: [(each.era, each.record.score or 0.0) for each in hall] for role, hall in halls.items()}
    values = [value for points in best.values() for _, value in points]
    values += [value for band in bands.values() for _, *quartiles in band for value in quartiles]
    last = max(1, (len(rows) - 1) // length)
    chart = Chart((0, last), (min(values), max(values)), right=_LEGEND)
    parts = list(chart.axes("era", what))
    for color, role in enumerate(halls):
        parts += _curve(chart, color % len(SERIES), bands[role], best[role])
    parts += _legend([role for role in halls])
    told = "; ".join(
        f"the champions of {role} go from {number(points[0][1])} to {number(points[-1][1])}"
        for role, points in best.items()
        if points
    )
    told += ". Scores are of matches against the opponents of an era: those of different eras cannot be compared."
    return Picture("eras", "Scores by era", told[0].upper() + told[1:], chart.width, chart.height, "\n".join(parts))


def _bands(role: str, scores: Mapping[tuple[str, int], Sequence[float]]) -> list[tuple[int, float, float, float]]:
    """Returns the quartiles of a population's scores, by era."""
    bands = []
    for (name, era), known in sorted(scores.items(), key=lambda item: item[0][1]):
        if name == role and len(known) >= _FEWEST:
            bands.append((era, *quartiles(known)))
    return bands


def _curve(
    chart: Chart, color: int, bands: Sequence[tuple[int, float, float, float]], best: Sequence[tuple[int, float]]
) -> Iterator[str]:
    if bands:
        outline = [(era, low) for era, low, _, _ in bands] + [(era, high) for era, _, _, high in bands[::-1]]
        yield f'<polygon class="f{color}" opacity="0.18" points="{chart.path(outline)}"/>'
        middle = [(era, value) for era, _, value, _ in bands]
        yield f'<polyline class="s{color}" stroke-width="2" points="{chart.path(middle)}"/>'
    for era, score in best:
        yield f'<circle class="f{color}" cx="{chart.x(era):.1f}" cy="{chart.y(score):.1f}" r="3.5"/>'


def _legend(roles: Sequence[str]) -> Iterator[str]:
    left = WIDTH - _LEGEND + 20
    for place, role in enumerate(roles):
        y = 26 + _LINE * place
        yield f'<rect class="f{place % len(SERIES)}" x="{left}" y="{y - 10}" width="12" height="12"/>'
        yield f'<text class="ink" x="{left + 18}" y="{y}">{text(short(role, 22))}</text>'
    for place, words in enumerate(("line: median", "band: half of all", "dots: champions")):
        yield f'<text class="soft" x="{left}" y="{26 + _LINE * (len(roles) + place) + 8}">{words}</text>'


def ancestors_map(
    name: str,
    columns: tuple[str, Sequence[Champion]],
    rows: tuple[str, Sequence[Champion]],
    scores: Mapping[tuple[int, int], float | None],
) -> Picture:
    """Returns the scores of the champions of a population against those of another, or of its own, as a heat map.

    Args:
        name: The picture's.
        columns: The population whose scores are shown: its role, and some of its champions, in order.
        rows: The other's.
        scores: By the indices of the two candidates; None where a match was lost by rule.
    """
    (own, across), (other, upward) = columns, rows
    side = min(_SIDE, (WIDTH - LEFT - _KEY) // max(1, len(across)))
    known = [score for score in scores.values() if score is not None]
    low, high = min(known, default=0.0), max(known, default=0.0)
    parts, tall = [], side * len(upward)
    for place, champion in enumerate(across):
        parts.append(_era(champion.era, LEFT + side * (place + 0.5), TOP + tall + 16, "middle"))
        for level, opponent in enumerate(upward):
            y = TOP + side * (len(upward) - 1 - level)
            score = scores[champion.record.index, opponent.record.index]
            parts.append(_field(LEFT + side * place, y, side, champion, opponent, score, (low, high)))
    for level, opponent in enumerate(upward):
        parts.append(_era(opponent.era, LEFT - 8, TOP + side * (len(upward) - level - 0.5) + 4, "end"))
    whom = f"champion of {own}, of era" if own != other else "champion of era"
    middle = f'x="{LEFT + side * len(across) / 2}" y="{TOP + tall + 36}" text-anchor="middle"'
    parts.append(f'<text class="ink" {middle}>{text(short(whom, 60))}</text>')
    turn = f'transform="translate(16 {TOP + tall / 2}) rotate(-90)" text-anchor="middle"'
    against = f"against {other}, of era" if own != other else "against that of era"
    parts.append(f'<text class="ink" {turn}>{text(short(against, 60))}</text>')
    parts += _key(LEFT + side * len(across) + 24, max(tall, 80), low, high)
    title = f"Champions of {own} against those of {other}" if own != other else "Champions against each other"
    return Picture(name, title, _story(own, across, upward, scores), WIDTH, TOP + max(tall, 100) + 48, "\n".join(parts))


def _story(
    own: str, across: Sequence[Champion], upward: Sequence[Champion], scores: Mapping[tuple[int, int], float | None]
) -> str:
    """Returns how the first and the last champion fare against all that are shown, in words."""

    def fares(champion: Champion) -> float | None:
        values = [scores[champion.record.index, other.record.index] for other in upward]
        known = [value for value in values if value is not None]
        return mean(known) if known else None

    first, last = across[0], across[-1]
    return (
        f"Each field is a match, and its colour the score of {own}. Against all that are shown, the champion of era "
        f"{first.era} has {number(fares(first))} in the mean, and that of era {last.era} {number(fares(last))}."
    )


def _era(era: int, x: float, y: float, anchor: str) -> str:
    return f'<text class="soft" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{era}</text>'


def _field(
    x: float,
    y: float,
    side: float,
    champion: Champion,
    opponent: Champion,
    score: float | None,
    span: tuple[float, float],
) -> str:
    """Draws the field of one match; where it was lost by rule, an empty one."""
    told = f"candidate {champion.record.index} of era {champion.era} against candidate {opponent.record.index} "
    told += f"of era {opponent.era}: {'lost by rule' if score is None else number(score)}"
    fill = 'class="edge"' if score is None else f'fill="{_color(score, *span)}"'
    place = f'x="{x + 0.5}" y="{y + 0.5}" width="{side - 1}" height="{side - 1}"'
    return f"<rect {place} {fill}><title>{text(told)}</title></rect>"


def _color(score: float, low: float, high: float) -> str:
    """Returns the colour of a score between two others."""
    part = 2.0 * between(score, low, high) if high > low else 1.0
    begin, end = (_LOW, _MIDDLE) if part < 1.0 else (_MIDDLE, _HIGH)
    mix = [a + (b - a) * (part if part < 1.0 else part - 1.0) for a, b in zip(begin, end, strict=True)]
    return "#" + "".join(f"{round(value):02x}" for value in mix)


def _key(x: float, tall: float, low: float, high: float, steps: int = 40) -> Iterator[str]:
    """Yields what the colours mean."""
    tall = min(tall - 16.0, 200.0)
    for step in range(steps):
        y = TOP + 16 + tall * (1 - (step + 1) / steps)
        part = step / (steps - 1)
        color = _color(low * (1.0 - part) + high * part, low, high)
        yield f'<rect x="{x}" y="{y:.1f}" width="14" height="{tall / steps + 0.5:.1f}" fill="{color}"/>'
    for value, y in ((high, TOP + 26), (low, TOP + 16 + tall)):
        yield f'<text class="soft" x="{x + 20}" y="{y:.1f}">{number(value)}</text>'
    yield f'<text class="ink" x="{x}" y="{TOP + 6}">score</text>'
