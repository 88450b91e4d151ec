"""The learning curve of a run as a picture."""

from pathlib import Path

from spikedeploy.trainers.atomic import replacing
from spikedeploy.trainers.metrics import read

CURVES = {"episode_return": "training", "eval_return": "validation"}


def draw_curve(metrics: Path, picture: Path, title: str) -> bool:
    """Draw the returns of a metrics file as PNG; return whether there was anything to draw."""
    rows = read(metrics)
    steps = next(iter(rows[0]), None) if rows else None
    if steps is None or not any(name in row for row in rows for name in CURVES):
        return False
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for name, label in CURVES.items():
        points = [(row[steps], row[name]) for row in rows if name in row]
        if points:
            axes.plot(
                *zip(*points, strict=True), label=label, marker="." if len(points) < 80 else ""
            )
    axes.set(xlabel=steps.replace("_", " "), ylabel="return", title=title)
    axes.grid(alpha=0.3)
    axes.legend()
    with replacing(picture) as temporary:
        FigureCanvasAgg(figure)
        figure.savefig(temporary, format="png", dpi=120)
    return True
