"""Take the pictures of the pages in docs/images, with Debian's Chromium.

    python docs/screenshots.py [FOLDER]

FOLDER holds a flown survey; without it the demo is flown. The example's campaign is mapped. A
laptop's window is 1366 × 768, a phone's 390 × 844, paper is A4.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

IMAGES = Path(__file__).parent / "images"
DATA = Path(__file__).parents[1] / "examples" / "data"
FLY = ("survey", "--city", "sample:9")
MAP = (
    *("map", str(DATA / "campaign.csv"), "--by", "pci", "--city", str(DATA / "buildings.geojson")),
    *("--threshold", "-105", "--next", "5"),
)
WINDOWS = {
    "report_laptop": ((1366, 768), ""),
    "report_phone": ((390, 844), "#step=100&view=std"),
    "report_error": ((1366, 1480), "#step=50&view=error"),
}
"""picture → window and state of the page"""


def chromium(*options: str) -> None:
    """Run the browser without a window."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        sys.exit("no Chromium; install it with: apt-get install chromium")
    with tempfile.TemporaryDirectory() as profile:
        common = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        common += [f"--user-data-dir={profile}", "--virtual-time-budget=4000"]
        subprocess.run(
            [program, *common, *options], check=True, stderr=subprocess.DEVNULL, timeout=120
        )


def window(page: Path, size: tuple[int, int], state: str) -> Image.Image:
    """The page as a window of ``size`` shows it; a browser's own window cannot be as narrow as a
    phone, so it stands in a frame."""
    width, height = size
    with tempfile.TemporaryDirectory() as folder:
        frame, picture = Path(folder) / "frame.html", Path(folder) / "picture.png"
        frame.write_text(
            f'<body style="margin:0"><iframe src="{page.resolve().as_uri()}{state}" width={width} '
            f'height={height} style="border:0">',
            encoding="utf-8",
        )
        chromium(
            f"--window-size={max(width, 800)},{height}", f"--screenshot={picture}", frame.as_uri()
        )
        with Image.open(picture) as taken:
            return taken.convert("RGB").crop((0, 0, width, height))


def paper(page: Path) -> Image.Image:
    """The first sheet as it is printed."""
    with tempfile.TemporaryDirectory() as folder:
        printed = Path(folder) / "page.pdf"
        uri = page.resolve().as_uri()
        chromium("--no-pdf-header-footer", f"--print-to-pdf={printed}", uri)
        sheet = ["pdftoppm", "-r", "80", "-l", "1", "-png", str(printed)]
        done = subprocess.run(sheet, check=True, capture_output=True)
        with Image.open(io.BytesIO(done.stdout)) as taken:
            return taken.convert("RGB")


def made(words: tuple[str, ...], out: Path) -> Path:
    """The folder that a command leaves."""
    subprocess.run([sys.executable, "-m", "skygain", *words, "--out", str(out)], check=True)
    return out


def main() -> None:
    """Write all pictures."""
    with tempfile.TemporaryDirectory() as folder:
        flown = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder) / "demo"
        if len(sys.argv) < 2:
            made(FLY, flown)
        page = flown / "report.html"
        taken = {name: window(page, *how) for name, how in WINDOWS.items()}
        taken["report_a4"] = paper(page)
        mapped = made(MAP, Path(folder) / "map") / "report.html"
        taken["map_laptop"] = window(mapped, (1366, 768), "")
        taken["map_phone"] = window(mapped, (390, 844), "")
    for name, picture in taken.items():
        picture.save(IMAGES / f"{name}.png", optimize=True)
        print(f"{name}.png: {(IMAGES / f'{name}.png').stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()
