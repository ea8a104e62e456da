"""Text logs: columns split by commas, semicolons, tabs or bars, below whatever a logger writes
first.

A preamble, comment lines, a ``sep=`` line and a row of units are passed over. The bulk is read by
the C parser of pandas; what it cannot read is read again by the csv module, which can say why.
"""

from __future__ import annotations

__all__ = ["open_delimited"]

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.instruments.columns import headings
from skygain.instruments.tables import Columns, Table, quoted_list
from skygain.instruments.values import number

_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_DELIMITERS = ",;\t|"
_SPACES = re.compile(r"(?<=\S)[ \t]+(?=\S)")
_HEAD_LINES = 60
"""the line of column names is among the first so many"""
_UNIT = re.compile(
    r"[\[(]?(deg|degrees?|°|dbm|db|m|metres?|meters?|s|sec|ms|hz|mhz|ghz|km/?h|m/s|%|-)?[\])]?",
    re.IGNORECASE,
)


def open_delimited(path: Path, head: bytes) -> Table:
    """The table in a text file.

    Args:
        path: the file.
        head: its first bytes.

    Raises:
        InputError: it is no text, or its columns have no names.
    """
    _need_text(path.name, head)
    layout = _Layout(path, head)
    return Table(path.name, tuple(layout.header), layout.load, notes=tuple(layout.notes))


def _is_utf8(head: bytes) -> bool:
    """Whether the first bytes of a file are UTF-8, but for a character that they may cut."""
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        return error.start > len(head) - 4 and len(head) >= 65536
    return True


def _need_text(name: str, head: bytes) -> None:
    if not head.strip():
        raise InputError(
            f"{name} is empty; expected a line of column names and one line per reading"
        )
    if b"\0" in head and not head.startswith(_UTF16_MARKS):
        raise InputError(
            f"{name} is not text (a spreadsheet or an archive?); export the sheet as CSV in UTF-8"
        )


class _Layout:
    """Where the header stands, how fields are split, and where the readings begin."""

    def __init__(self, path: Path, head: bytes) -> None:
        self.path, self.notes = path, []  # type: ignore[var-annotated]
        self.encoding, self.spaced = "utf-8-sig", False
        if head.startswith(_UTF16_MARKS):
            self.encoding = "utf-16"
            self.notes.append("the text is UTF-16")
        elif not _is_utf8(head):
            self.encoding = "cp1252"
            self.notes.append("the text is no UTF-8 and is read as Windows-1252")
        lines = self._first_lines()
        self.spaced = not any(d in line for line in lines for d in _DELIMITERS) and any(
            headings(line.split()) for line in lines
        )
        if self.spaced:
            lines = [_SPACES.sub("\t", line) for line in lines]
        self.header_line, self.delimiter = self._header_of(lines)
        self.header = [t.strip() for t in self._split(lines[self.header_line])]
        if len(self.header) < 2:
            raise InputError(
                f"the first line of {path.name} has {len(self.header)} column(s), "
                f"{quoted_list(self.header)}; expected the names of at least three (two for the "
                "position, one for the level), split by commas, semicolons or tabs"
            )
        if all(np.isfinite(number(text)) for text in self.header):
            raise InputError(
                f"the first line of {path.name} holds numbers; put a line of column names, such as "
                "latitude,longitude,rsrp, above it"
            )
        if self.header_line and any(line.strip() for line in lines[: self.header_line]):
            self.notes.append(f"lines before the column names in line {self.header_line + 1} "
                              "passed over")  # fmt: skip
        self.skip_after = self._units_below(lines)

    def _text(self) -> Any:
        file = self.path.open(encoding=self.encoding, newline=None)
        if not self.spaced:
            return file
        with file:
            return io.StringIO("".join(_SPACES.sub("\t", line) for line in file))

    def _first_lines(self) -> list[str]:
        try:
            with self._text() as file:
                lines = [line.rstrip("\n") for _, line in zip(range(_HEAD_LINES), file)]  # noqa: B905
        except UnicodeDecodeError as error:
            raise self._not_utf8(error) from error
        if not any(line.strip() for line in lines):
            raise InputError(
                f"{self.path.name} is empty; expected a line of column names and one line per "
                "reading"
            )
        return lines

    def _not_utf8(self, error: UnicodeDecodeError) -> InputError:
        return InputError(
            f"{self.path.name} is not UTF-8 text (byte 0x{error.object[error.start]:02x}); save it "
            "as CSV in UTF-8"
        )

    def _split(self, line: str, delimiter: str | None = None) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=delimiter or self.delimiter), [])
        except csv.Error as error:
            raise InputError(
                f"{self.path.name} is no readable CSV ({error}); check for a quotation mark that "
                "is never closed"
            ) from error

    def _header_of(self, lines: list[str]) -> tuple[int, str]:
        """Index of the line of column names, and the delimiter.

        It is the first line that names a position and more beside it; failing that, the first
        that is no comment.
        """
        candidates = []
        for i, line in enumerate(lines):
            plain = line.strip()
            named = re.fullmatch(r"sep=(.)", plain, re.IGNORECASE)
            if not plain or named or plain.startswith(("#", "//", "%", "!")):
                continue
            candidates.append(i)
        if not candidates:
            candidates = [next(i for i, line in enumerate(lines) if line.strip())]
        best = candidates[0]
        for i in candidates:
            if headings(self._split(lines[i], self._delimiter(lines[i]))):
                best = i
                break
        return best, self._delimiter(lines[best])

    def _delimiter(self, line: str) -> str:
        return max(_DELIMITERS, key=lambda d: len(self._split(line, d)))

    def _units_below(self, lines: list[str]) -> int:
        """1 when the line below the names holds units, else 0."""
        below = lines[self.header_line + 1 : self.header_line + 2]
        fields = [t.strip() for t in self._split(below[0])] if below and below[0].strip() else []
        said = [text for text in fields if text not in ("", "-")]
        if said and all(_UNIT.fullmatch(text) for text in fields):
            self.notes.append(f"row of units in line {self.header_line + 2} passed over")
            return 1
        return 0

    def load(self, wanted: Sequence[int]) -> Columns:
        """The columns with these indices and the lines they stand in."""
        first = self.header_line + 1 + self.skip_after
        try:
            found = self._parsed(wanted, first)
            return found if found is not None else self._row_by_row(wanted, first)
        except UnicodeDecodeError as error:
            raise self._not_utf8(error) from error
        except csv.Error as error:
            raise InputError(
                f"{self.path.name} is no readable CSV ({error}); check for a quotation mark that "
                "is never closed"
            ) from error

    def _parsed(self, wanted: Sequence[int], first: int) -> Columns | None:
        """The columns by the C parser; ``None`` when it cannot, or cannot tell the lines."""
        import pandas as pd

        width = len(self.header)
        names = self.delimiter.join(f"c{i}" for i in range(width + 1)) + "\n"
        picked = sorted({*wanted, width})
        with self._text() as file:
            for _ in range(first):
                file.readline()
            stream = _Headed(names, file)
            try:
                frame = pd.read_csv(
                    stream,
                    sep=self.delimiter,
                    header=0,
                    usecols=picked,
                    index_col=False,
                    na_filter=False,
                    skip_blank_lines=False,
                    low_memory=False,
                    decimal="," if self._decimal_commas(first) else ".",
                )
            except (pd.errors.ParserError, pd.errors.EmptyDataError, OverflowError):
                return None
            if stream.lines != len(frame):  # a line break inside quotation marks
                return None
        by_index = {i: _plain(frame[f"c{i}"]) for i in picked}
        extra = by_index[width]
        line = np.arange(first + 1, first + 1 + len(frame), dtype=np.int64)
        columns = [by_index[i] for i in wanted]
        if extra.dtype != object or (extra != "").any():
            return None  # a line with too many fields is named by the slow way
        return columns, line

    def _decimal_commas(self, first: int) -> bool:
        if self.delimiter == ",":
            return False
        with self._text() as file:
            lines = [line for _, line in zip(range(first + 40), file)][first:]  # noqa: B905
        return any(re.search(r"\d,\d", line) for line in lines)

    def _row_by_row(self, wanted: Sequence[int], first: int) -> Columns:
        """The same by the csv module; a line with too many fields has `None` in every column."""
        width = len(self.header)
        rows: list[list[str | None]] = []
        lines: list[int] = []
        with self._text() as file:
            for _ in range(first):
                file.readline()
            reader = csv.reader(file, delimiter=self.delimiter)
            for row in reader:
                if not any(text.strip() for text in row):
                    continue
                too_many = any(text.strip() for text in row[width:])
                row += [""] * (width - len(row))
                rows.append([None if too_many else row[i] for i in wanted])
                lines.append(first + reader.line_num)
        columns = [np.array(c, dtype=object) for c in zip(*rows, strict=True)]
        columns = columns or [np.empty(0, dtype=object) for _ in wanted]
        return columns, np.array(lines, dtype=np.int64)


class _Headed(io.TextIOBase):
    """A text file with a line put before it, that counts the lines read from it."""

    def __init__(self, header: str, file: Any) -> None:
        self._pending, self._file = header, file
        self.lines, self._last = 0, "\n"

    def readable(self) -> bool:
        return True

    def read(self, size: int | None = -1) -> str:
        if self._pending:
            text, self._pending = self._pending, ""
            return text
        text = self._file.read(size)
        if text:
            self.lines += text.count("\n")
            self._last = text[-1]
        elif self._last != "\n":  # the last line has no end
            self.lines, self._last = self.lines + 1, "\n"
        return text

    def __iter__(self) -> Any:
        return iter(self.read, "")


def _plain(series: Any) -> NDArray:
    """A column as numbers, or as an array of text."""
    if series.dtype == bool:
        return np.array(series.astype(str), dtype=object)
    if series.dtype.kind in "iuf":
        return series.to_numpy()
    return series.to_numpy(dtype=object)
