"""Answers of the Overpass API, brought into OpenStreetMap's own XML, which GDAL assembles.

Both kinds are understood: with the nodes among the elements (``out body; >;``) and with the
coordinates inside the ways (``out geom``).
"""

from __future__ import annotations

__all__ = ["is_overpass", "osm_xml"]

import json
import re
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from skygain.ground.errors import InputError


def is_overpass(head: bytes) -> bool:
    """Whether a file that begins like this is an answer in JSON."""
    return (
        re.search(rb'"(osm3s|elements)"\s*:', head) is not None
        and re.search(rb'"(FeatureCollection|CityJSON)', head) is None
    )


def osm_xml(path: Path) -> bytes:
    """The document as OpenStreetMap XML, nodes before ways before relations, each by number.

    Raises:
        InputError: the file is damaged.
    """
    try:
        elements = json.loads(path.read_text(encoding="utf-8"))["elements"]
        return _written(_Elements(elements))
    except InputError:
        raise
    except (
        AttributeError,
        IndexError,
        KeyError,
        OSError,
        OverflowError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise InputError(
            f"not readable as an answer of the Overpass API ({type(error).__name__}: "
            f"{' '.join(str(error).split())[:80]}); ask again with 'out geom'"
        ) from error


class _Elements:
    """Nodes, ways and relations by number, with what ``out geom`` put inside them taken out."""

    def __init__(self, elements: list[dict[str, Any]]) -> None:
        self.nodes: dict[int, tuple[float, float]] = {}
        self.ways: dict[int, tuple[list[int], dict[str, Any]]] = {}
        self.relations: dict[int, tuple[list[dict[str, Any]], dict[str, Any]]] = {}
        self._at: dict[tuple[float, float], int] = {}
        self._next = 1 + max((int(e.get("id", 0)) for e in elements), default=0) + 10**12
        for e in elements:
            if e["type"] == "node":
                self.nodes[int(e["id"])] = (float(e["lat"]), float(e["lon"]))
        for e in elements:
            if e["type"] == "way":
                refs = [int(n) for n in e.get("nodes", [])]
                if e.get("geometry") and not all(n in self.nodes for n in refs or [-1]):
                    refs = [self._placed(p) for p in e["geometry"] if p]
                self.ways[int(e["id"])] = refs, e.get("tags", {})
        for e in elements:
            if e["type"] == "relation":
                members = e.get("members", [])
                for member in members:
                    if member["type"] == "way" and member.get("geometry"):
                        refs = [self._placed(p) for p in member["geometry"] if p]
                        self.ways.setdefault(int(member["ref"]), (refs, {}))
                self.relations[int(e["id"])] = members, e.get("tags", {})
        if self.ways and not any(refs for refs, _ in self.ways.values()):
            raise InputError("the ways have no coordinates; ask the Overpass API for 'out geom'")

    def _placed(self, point: dict[str, Any]) -> int:
        """The number of the node at a point; a new one where there is none yet."""
        place = (float(point["lat"]), float(point["lon"]))
        if place not in self._at:
            self._at[place] = self._next
            self.nodes[self._next] = place
            self._next += 1
        return self._at[place]


def _written(found: _Elements) -> bytes:
    lines = ['<osm version="0.6">']
    for number, (lat, lon) in sorted(found.nodes.items()):
        lines.append(f'<node id="{number}" lat="{lat!r}" lon="{lon!r}" version="1"/>')
    for number, (refs, tags) in sorted(found.ways.items()):
        lines.append(f'<way id="{number}" version="1">')
        lines += [f'<nd ref="{ref}"/>' for ref in refs]
        lines += [*_tags(tags), "</way>"]
    for number, (members, tags) in sorted(found.relations.items()):
        lines.append(f'<relation id="{number}" version="1">')
        lines += [
            f'<member type={quoteattr(str(m["type"]))} ref="{int(m["ref"])}" '
            f"role={quoteattr(str(m.get('role', '')))}/>"
            for m in members
        ]
        lines += [*_tags(tags), "</relation>"]
    return "\n".join([*lines, "</osm>"]).encode("utf-8", errors="replace")


def _tags(tags: dict[str, Any]) -> list[str]:
    return [f"<tag k={quoteattr(str(k))} v={quoteattr(str(v))}/>" for k, v in tags.items()]
