import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import imageio.v3 as imageio
import pytest
from matplotlib.figure import Figure

from irl_dal.figures.comparison_page import comparison_page
from irl_dal.figures.style import drawing, to_svg
from tests.irl_dal.conftest import Compared

CHROMIUM = shutil.which("chromium")

PROBE = """
<script>
addEventListener("load", async () => {
  const film = document.querySelector("video");
  if (film && !film.error && film.readyState < 2)
    await new Promise(done => { film.onloadeddata = done; film.onerror = done; });
  const drawn = box => box.width > 0 && box.height >= 0;
  const figures = [...document.querySelectorAll("figure")].map(figure => {
    const svg = figure.querySelector("svg");
    if (!svg) return [figure.id, film.readyState >= 2 ? film.videoWidth : 0];
    const marks = [...svg.querySelectorAll("path, use, text")];
    return [figure.id, marks.filter(mark => drawn(mark.getBoundingClientRect())).length];
  });
  document.body.dataset.figures = JSON.stringify(figures);
});
</script>
"""


def opened(page: str, folder: Path) -> tuple[dict[str, int], list[str]]:
    """What a headless browser drew of each figure, and what it wrote to its console."""
    assert CHROMIUM is not None
    path = folder / "page.html"
    path.write_text(page.replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    arguments = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu"]
    arguments += ["--enable-logging=stderr", "--v=0", f"--user-data-dir={folder / 'profile'}"]
    arguments += ["--virtual-time-budget=30000", "--dump-dom", path.as_uri()]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    found = re.search(r'data-figures="([^"]*)"', done.stdout)
    figures = dict(json.loads(unescape(found[1]))) if found else {}
    return figures, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.skipif(CHROMIUM is None, reason="apt-get install chromium")
def test_a_browser_draws_every_figure_without_an_error(compared: Compared, tmp_path: Path) -> None:
    """Film decoded, every drawing with its marks, nothing on the console."""
    page = compared.job.page.read_text(encoding="utf-8")
    figures, console = opened(page, tmp_path)
    assert console == []
    names = {"film", "denoising", "paths", "commands"}
    for activation in ("trigger", "alone"):
        names |= {f"numbers_{activation}", f"differences_{activation}"}
    assert set(figures) == names
    assert figures.pop("film") == 1280
    assert min(figures.values()) > 40, figures


@pytest.mark.skipif(CHROMIUM is None, reason="apt-get install chromium")
def test_the_browser_test_can_fail(compared: Compared, tmp_path: Path) -> None:
    """A broken film, an empty drawing and a script's mistake are noticed."""
    page = compared.job.page.read_text(encoding="utf-8")
    page = re.sub(r"base64,[^\"]+", "base64,AAAA", page)
    page = re.sub(r'(<figure id="paths">).*?(</figure>)', r"\1<svg></svg>\2", page, flags=re.S)
    figures, console = opened(page.replace("</main>", "<script>missing()</script>"), tmp_path)
    assert figures["film"] == 0 and figures["paths"] == 0 and figures["denoising"] > 40
    assert any("missing is not defined" in line for line in console)


def test_the_page_needs_nothing_else(compared: Compared) -> None:
    """No link to another file or host; the film is inside; numbers and settings are there."""
    page = compared.job.page.read_text(encoding="utf-8")
    links = re.findall(r"""(?:src|href)\s*=\s*["']([^"']{1,40})""", page)
    assert links and all(link.startswith(("data:", "#")) for link in links)
    assert "url(http" not in page and "@import" not in page
    assert "data:video/webm;base64," in page
    for words in ("planner on its trigger", "planner alone", "none + shield", "x0, unguided"):
        assert words in page
    assert compared.results["config_hash"] in page


def test_the_film_shows_both_drives(compared: Compared) -> None:
    """Four frames of two halves that differ once the settings do."""
    frames = imageio.imread(compared.job.film, index=None)
    assert frames.shape == (4, 640, 1280, 3)
    assert frames[0, 60:400].std() > 5.0


def test_pictures_lie_beside_the_page(compared: Compared) -> None:
    """Every figure is written for other documents too."""
    folder = compared.job.out / "figures"
    assert {path.stem for path in folder.glob("*.png")} >= {"denoising", "commands", "paths"}
    assert all(path.stat().st_size > 5_000 for path in folder.glob("*.png"))


def test_what_a_run_is_called_cannot_inject(compared: Compared) -> None:
    """Words of the report are escaped."""
    results = {**compared.results, "variant": "<script>alert(1)</script>"}
    assert "<script>alert(1)" not in comparison_page(results, [], None)


def test_identifiers_of_two_drawings_differ() -> None:
    """Two figures in one page do not share clip paths."""

    def figure() -> Figure:
        with drawing(2.0, 2.0) as drawn:
            drawn.subplots().plot([0, 1], [0, 1])
        return drawn

    first, second = (
        set(re.findall(r'clipPath id="([^"]+)"', to_svg(figure(), name))) for name in ("a", "b")
    )
    assert first and second and not first & second
