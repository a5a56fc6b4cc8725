"""One self-contained HTML page of experiments: text, tables, and pictures as data URIs."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Table:
    """A caption, heads, and rows of texts; `bands` are heads above the heads, each (text, columns under it)."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    bands: Sequence[tuple[str, int]] = ()


@dataclass(frozen=True)
class Figure:
    """A PNG file in the folder of the page, and what it shows."""

    name: str
    caption: str


@dataclass(frozen=True)
class Section:
    """One experiment: what the page says of it, and `record`, what a program reads of it."""

    title: str
    text: Sequence[str]
    tables: Sequence[Table]
    figures: Sequence[Figure]
    record: dict[str, Any] = field(repr=False)


def write_page(path: Path, title: str, opening: Sequence[str], sections: Sequence[Section], closing: str) -> None:
    """Write `path`; pictures are read from its folder."""
    parts = [f"<h1>{escape(title)}</h1>", *(f"<p>{escape(text)}</p>" for text in opening)]
    parts += ["<nav>", *(f'<a href="#s{i}">{escape(s.title)}</a>' for i, s in enumerate(sections, start=1)), "</nav>"]
    for number, section in enumerate(sections, start=1):
        parts.append(f'<section id="s{number}"><h2>{number}. {escape(section.title)}</h2>')
        parts += [f"<p>{escape(text)}</p>" for text in section.text]
        parts += [_table(table) for table in section.tables]
        parts += [_figure(path.parent, figure) for figure in section.figures]
        parts.append("</section>")
    parts.append(f"<footer>{escape(closing)}</footer>")
    path.write_text(PAGE.format(title=escape(title), style=STYLE, body="\n".join(parts)), encoding="utf-8")


def _table(table: Table) -> str:
    lines = [f'<div class="wide"><table><caption>{escape(table.caption)}</caption><thead>']
    if table.bands:
        cells = (f'<th colspan="{columns}">{escape(text)}</th>' for text, columns in table.bands)
        lines.append(f'<tr class="bands">{"".join(cells)}</tr>')
    lines.append(f"<tr>{''.join(f'<th>{escape(head)}</th>' for head in table.heads)}</tr></thead><tbody>")
    lines += [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows]
    return "\n".join([*lines, "</tbody></table></div>"])


def _figure(folder: Path, figure: Figure) -> str:
    data = base64.b64encode((folder / figure.name).read_bytes()).decode("ascii")
    caption = escape(figure.caption)
    image = f'<img src="data:image/png;base64,{data}" alt="{caption}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
{body}
</body>
</html>
"""
STYLE = """
body { margin: 0 auto; max-width: 66rem; padding: 2.5rem 1.25rem 4rem; background: #f7f5f2; color: #33312e;
  font: 1.02rem/1.6 Georgia, "DejaVu Serif", serif; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 1rem; }
h2 { font-size: 1.4rem; margin: 3.2rem 0 .6rem; padding-top: .8rem; border-top: 1px solid #d8d3ca; }
p { max-width: 46rem; margin: .6rem 0; }
nav { display: flex; flex-wrap: wrap; gap: .3rem 1.4rem; margin: 1.4rem 0 0; }
a { color: #2f5d86; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: 1.3rem 0; font: .86rem/1.45 "DejaVu Sans", Helvetica, Arial, sans-serif;
  font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: bold; padding-bottom: .5rem; }
th, td { padding: .25rem .55rem; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
thead th { font-weight: normal; color: #6b665e; border-bottom: 1px solid #b9b4ab; vertical-align: bottom; }
.bands th { color: #33312e; text-align: center; border-bottom: none; padding-bottom: 0; }
tbody tr + tr td { border-top: 1px solid #e6e1d9; }
tbody tr td:first-child:empty { border-top-color: transparent; }
figure { margin: 1.6rem 0; }
img { max-width: 100%; height: auto; display: block; }
figcaption { max-width: 46rem; margin-top: .5rem; font-size: .92rem; color: #6b665e; }
footer { margin-top: 3.5rem; font-size: .9rem; color: #6b665e; }
"""
