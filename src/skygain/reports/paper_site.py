"""The paper's figures as pages: figures, claims, tables, settings, and every survey one click away.

The folder needs no network and no server. Everything on a page comes from the rollouts of this run.
"""

from __future__ import annotations

__all__ = ["write_site"]

import html
import platform
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path

import numpy as np

import skygain
from skygain.evaluation.comparison import Comparison
from skygain.evaluation.paper.claims import LEAST_CITIES, VERDICTS, Claim
from skygain.evaluation.paper.flying import Reproduction
from skygain.evaluation.paper.gain import gain_curves
from skygain.evaluation.paper.settings import FIGURES
from skygain.evaluation.statistics import bootstrap_mean
from skygain.ground.files import atomic_write
from skygain.reports.rollout_pictures import SCALES, RolloutPictures

_LIBRARIES = ("numpy", "scipy", "numba", "onnxruntime", "torch", "zarr", "matplotlib")


def write_site(
    found: Reproduction,
    claims: Mapping[str, Sequence[Claim]],
    pictures: Mapping[str, Path],
    command: str,
) -> Path:
    """Write ``index.html`` and the pages of the surveys; returns the former.

    Args:
        found: what was flown.
        claims: of each figure.
        pictures: of each figure.
        command: what makes this folder again.
    """
    out = found.request.out
    for setting, comparison in found.comparisons.items():
        _surveys(found, setting, comparison)
    body = [
        *_summary(claims),
        "<main>",
        *(_figure(found, name, claims[name], pictures[name]) for name in found.figures),
        _settings(found, command),
        "</main>",
    ]
    n, n_cities = _extent(found)
    request = found.request
    lede = (
        f"{n} surveys in {n_cities} {'city' if n_cities == 1 else 'cities'} of split "
        f"{request.split} of {Path(request.data).name}, {request.steps} steps"
        f"{', a quick look at a tenth of the surveys' if request.quick else ''}. A claim holds, or "
        "does not, if its whole 95 % interval over cities says so; fewer than "
        f"{LEAST_CITIES} cities decide nothing."
    )
    path = out / "index.html"
    _write(path, "The paper's figures", lede, body)
    return path


def _extent(found: Reproduction) -> tuple[int, int]:
    """Surveys and cities of the largest setting."""
    sizes = [(len(c.cities), len(np.unique(c.cities))) for c in found.comparisons.values()]
    return max(sizes)


def _summary(claims: Mapping[str, Sequence[Claim]]) -> Iterator[str]:
    count = Counter(claim.verdict for of_figure in claims.values() for claim in of_figure)
    tiles = "".join(
        f"<div><dt>{verdict}</dt><dd>{count[verdict]}</dd></div>" for verdict in VERDICTS
    )
    links = "".join(f'<li><a href="#{n}">{html.escape(FIGURES[n].title)}</a></li>' for n in claims)
    yield f'<header><dl class="tiles">{tiles}</dl><nav><ul>{links}'
    yield '<li><a href="#settings">Settings, versions, hashes</a></li></ul></nav></header>'


def _figure(found: Reproduction, name: str, claims: Sequence[Claim], picture: Path) -> str:
    out, flown = found.request.out, found.figures[name]
    source = html.escape(picture.relative_to(out).as_posix())
    title = html.escape(FIGURES[name].title)
    parts = [
        f'<section id="{name}"><h2>{title}</h2>',
        f'<a href="{source}"><img src="{source}" alt="{title}"></a>' if picture.exists() else "",
        "<h3>What the paper says, and what is found here</h3>",
        _claims(claims),
    ]
    if name == "delay":
        parts.append(
            '<p class="note">Processes that run beside each other slow each other down: quote '
            "delays from <code>--workers 1</code> on a quiet machine.</p>"
        )
    for setting, roles in flown.roles.items():
        comparison, words = flown.comparisons[setting], found.settings[setting].title
        parts.append(f"<h3>{html.escape(words)}, {len(comparison.cities)} surveys</h3>")
        if name == "gain-bins":
            parts.append(_gain_table(comparison, list(roles.values())))
        else:
            parts.append(_table(comparison, list(dict.fromkeys(roles.values()))))
        parts.append(
            f'<p><a href="surveys/{setting}/index.html">Every survey of this setting</a></p>'
        )
    return "\n".join([*parts, "</section>"])


def _claims(claims: Sequence[Claim]) -> str:
    """A row each; of a sentence that has several, the sentence stands once."""
    rows, before = [], ""
    for claim in claims:
        text = "" if claim.text == before else claim.text
        before = claim.text
        badge = claim.verdict.replace(" ", "-")
        rows.append(
            [
                html.escape(text),
                html.escape(claim.measured),
                claim.found,
                f'<span class="verdict {badge}">{claim.verdict}</span>',
            ]
        )
    return _rows(["the paper", "here", "found, 95 % interval", ""], rows, "claims")


def _table(comparison: Comparison, labels: Iterable[str]) -> str:
    steps, cities = comparison.steps, comparison.cities
    wanted = (steps[-1] / 4, steps[-1] / 2, steps[-1])
    shown = sorted({int(np.argmin([abs(s - at) for s in steps])) for at in wanted})
    head = ["predictor / planner", *(f"RMSE T={steps[k]}, dB" for k in shown)]
    head += ["goodness of fit", "90 % cover", "ms per decision"]
    rows = []
    for label in labels:
        scores = comparison.scores[label]
        rmse = [str(bootstrap_mean(scores["rmse_db"][:, k], cities)) for k in shown]
        with np.errstate(divide="ignore"):
            fit = float(np.log(np.nanmean(scores["error_ratio"][:, -1])))
        cover = float(np.nanmean(scores["coverage90"][:, -1]))
        delay = float(np.nanmean(comparison.delays[label]["decision_ms_median"]))
        rows.append([html.escape(label), *rmse, f"{fit:+.2f}", f"{cover:.1%}", f"{delay:.3g}"])
    return _rows(head, rows)


def _gain_table(comparison: Comparison, labels: Sequence[str]) -> str:
    curves = {label: gain_curves(comparison.by_gain[label], comparison.cities) for label in labels}
    first = next(iter(curves.values()))
    head = ["true gain, dB", "share of the cells"]
    head += [f"{html.escape(label.partition(' / ')[0])}: RMSE dB / fit" for label in labels]
    rows = []
    for k, middle in enumerate(first.gain_db):
        cells = [f"{c.rmse_db[0, k]:.1f} / {c.gof[0, k]:+.2f}" for c in curves.values()]
        rows.append([f"{middle - 5:g} to {middle + 5:g}", f"{first.share[k]:.1%}", *cells])
    return _rows(head, rows)


def _settings(found: Reproduction, command: str) -> str:
    request = found.request
    versions = {"skygain": skygain.__version__, "Python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            versions[library] = version(library)
        except PackageNotFoundError:
            continue
    told = {key: _shown(value) for key, value in request.stored().items()}
    parts = [
        '<section id="settings"><h2>Settings, versions, hashes</h2>',
        f"<p>This folder again: <code>{html.escape(command)}</code></p>",
    ]
    if found.left_out:
        lines = "".join(f"<li>{html.escape(line)}</li>" for line in found.left_out)
        parts.append(f"<h3>Left out or replaced</h3><ul>{lines}</ul>")
    hashes = {f"{Path(request.data).name} (data)": found.data_digest, **found.files}
    machine = f"{platform.system()} {platform.machine()}"
    for title, values in (
        ("Settings", told),
        (f"Versions, on {machine}", versions),
        ("Hashes (first 16 digits of SHA-256)", hashes),
    ):
        rows = [[html.escape(k), f"<code>{html.escape(v)}</code>"] for k, v in values.items()]
        parts += [f"<h3>{html.escape(title)}</h3>", _rows(["name", "value"], rows)]
    parts.append(
        "<p>Numbers of everything here: <a href='results.json'>results.json</a>. Every rollout: "
        + ", ".join(
            f"<a href='rollouts/{s}/rollouts.jsonl'>{html.escape(found.settings[s].title)}</a>"
            for s in found.comparisons
        )
        + ".</p></section>"
    )
    return "\n".join(parts)


def _surveys(found: Reproduction, setting: str, comparison: Comparison) -> None:
    """The list of a setting's surveys, and a page for each."""
    folder = found.request.out / "surveys" / setting
    words = found.settings[setting].title
    labels = list(comparison.scores)
    rows = []
    for k, link in enumerate(comparison.links.tolist()):
        city = int(comparison.cities[k])
        errors = [f"{comparison.scores[label]['rmse_db'][k, -1]:.2f}" for label in labels]
        rows.append([f'<a href="{link}.html">link {link}, city {city}</a>', *errors])
        _survey(found, setting, comparison, k)
    head = ["survey", *map(html.escape, labels)]
    back = '<p><a href="../../index.html">All figures</a></p>'
    lede = f"RMSE in dB over unvisited cells after {comparison.steps[-1]} steps."
    body = ["<main><section>", back, _rows(head, rows), "</section></main>"]
    _write(folder / "index.html", f"Surveys: {words}", lede, body)


def _survey(found: Reproduction, setting: str, comparison: Comparison, k: int) -> None:
    folder = found.request.out / "surveys" / setting
    link = int(comparison.links[k])
    draw = RolloutPictures(folder, comparison.steps[-1])
    panels = "".join(
        f"<span>{name}, {low:g} to {high:g} dB</span>" for name, (_, low, high) in SCALES.items()
    )
    body = ["<main>", '<p><a href="index.html">All surveys of this setting</a></p>']
    for label, scores in comparison.scores.items():
        curve = ", ".join(
            f"{value:.2f} at T={step}"
            for step, value in zip(comparison.steps, scores["rmse_db"][k], strict=True)
        )
        picture = draw.path(link, label)
        drawn = f'<img class="rollout" src="{picture.name}" alt="maps of {html.escape(label)}">'
        body += [
            f"<section><h2>{html.escape(label)}</h2>",
            f'<div class="panels">{panels}</div>{drawn}' if picture.exists() else "",
            f"<p>RMSE over unvisited cells, dB: {curve}.</p>",
            f"<p>Goodness of fit {scores['gof'][k, -1]:+.2f}, 90 % cover "
            f"{scores['coverage90'][k, -1]:.1%}, RMSE over all cells "
            f"{scores['rmse_all_db'][k, -1]:.2f} dB.</p></section>",
        ]
    title = f"Link {link}, city {int(comparison.cities[k])}"
    _write(folder / f"{link}.html", title, found.settings[setting].title, [*body, "</main>"])


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "") -> str:
    """A table of cells that are HTML already."""
    lines = [f'<div class="scroll"><table class="{kind}"><thead><tr>']
    lines += [f"<th>{cell}</th>" for cell in head]
    lines.append("</tr></thead><tbody>")
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>")
    return "".join([*lines, "</tbody></table></div>"])


def _shown(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _write(path: Path, title: str, lede: str, body: Iterable[str]) -> None:
    style = (files("skygain.reports") / "page" / "paper.css").read_text(encoding="utf-8")
    text = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title>\n<style>\n{style}</style></head><body>\n"
        f'<header><p class="eyebrow">Skygain</p><h1>{html.escape(title)}</h1>'
        f'<p class="lede">{html.escape(lede)}</p></header>\n'
        + "\n".join(body)
        + f"\n<footer>Skygain {html.escape(skygain.__version__)}</footer></body></html>\n"
    )
    with atomic_write(path) as tmp:
        tmp.write_text(text, encoding="utf-8", errors="replace")
